"""A whole shore turned by any angle: what is measured of it stays."""

import geopandas as gpd
import numpy as np
import pytest
import shapely
from rasterio.crs import CRS
from shapely import affinity

from workbench.rasters import Grid, new_raster
from workbench.reed import measure_reed

CRS_ = CRS.from_epsg(32633)
CENTRE = np.array([400000.0, 5300000.0])
AMPLITUDE, WAVE, WIDTH, SPARSE = 2.0, 20.0, 14.0, 4.0
ISLETS, HOLES = ((-32.0, 21.0), (8.0, 22.0), (28.0, 21.5)), ((-15.0, 5.0), (15.0, 5.5))
RING = (-5.0, 5.0)  # Water around a patch of reed, 1.2 to 2.5 m from here.


def front(u):
    """Distance of the front from the shore, m: straight in the west, a sine in the east."""
    return WIDTH + np.where(u > 0, AMPLITUDE * np.sin(2 * np.pi * u / WAVE), 0.0)


def shore(angle, resolution=0.136):
    """Surface, lake, areas and transects of a belt whose shore is turned by an angle (degrees)."""
    size = int(130 / resolution)
    grid = Grid(CRS_, *(CENTRE + (-65, 65)), resolution, size, size)
    x, y = np.meshgrid(grid.x - CENTRE[0], grid.y - CENTRE[1])
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    u, v = c * x + s * y, -s * x + c * y  # Along the shore, and from it into the lake.
    reed = (v > -3) & (v < front(u)) & (np.abs(u) < 45)
    reed &= ~np.any([np.hypot(u - a, v - b) < 1.2 for a, b in HOLES], axis=0)
    away = np.hypot(u - RING[0], v - RING[1])
    reed &= ~((away > 1.2) & (away < 2.5))
    reed |= np.any([np.hypot(u - a, v - b) < 1.5 for a, b in ISLETS], axis=0)
    rough = 1.8 + 1.1 * np.sign(np.sin(2 * np.pi * u / 0.8) * np.sin(2 * np.pi * v / 0.8))
    height = np.where(v < SPARSE, rough, 3.0)
    dsm = new_raster(
        np.where(reed, height, 0.0).astype(np.float32), grid, name="dsm", units="m", vertical_datum="gauge"
    )

    def turned(shape):
        return affinity.translate(affinity.rotate(shape, angle, origin=(0, 0)), *CENTRE)

    lake = gpd.GeoSeries([turned(shapely.box(-300, 0, 300, 300))], crs=CRS_)
    lines = [turned(shapely.LineString([(u, 26), (u, 0)])) for u in range(-40, 41, 10)]
    table = {"aoi": "A", "transect": range(1, len(lines) + 1)}
    return dsm, lake, gpd.GeoDataFrame(table, geometry=lines, crs=CRS_)


def expected_sinuosity():
    """Of the eight sections, from the curve itself."""
    values = []
    for first in range(-40, 40, 10):
        u = np.linspace(first, first + 10, 5001)
        line = np.hypot(np.diff(u), np.diff(front(u))).sum()
        values.append(line / np.hypot(10, front(u[-1]) - front(u[0])))
    return np.array(values)


@pytest.fixture(scope="module")
def slanted():
    """At 13 degrees, where no line of the scene runs along the density cells."""
    return _measure(13)


def _measure(angle):
    dsm, lake, transects = shore(angle)
    return measure_reed(dsm, 0.0, lake, transects=transects)


@pytest.mark.parametrize("angle", [0, 13, 30, 45, 60, 90, 137, 222, 301])
def test_sections_are_those_of_the_curve_at_any_angle(angle):
    metrics = _measure(angle)
    sections = metrics.sections.sort_values("section")
    assert sections.sinuosity.to_numpy() == pytest.approx(expected_sinuosity(), abs=0.02)
    assert sections.front_m.to_numpy() == pytest.approx(
        expected_sinuosity() * sections.straight_m.to_numpy(), rel=0.02
    )
    assert sections.islets.tolist() == [1, 0, 0, 1, 1, 0, 1, 0]
    assert sections.holes.tolist() == [0, 0, 1, 1, 0, 1, 0, 0]
    assert set(sections.status) == {"healthy"}


@pytest.mark.parametrize("angle", [60, 137, 222, 301])
def test_areas_and_index_stay_at_any_angle(angle, slanted):
    metrics = _measure(angle)
    turned, other = metrics.totals(), slanted.totals()
    for name in ("islets", "holes", "sections", "healthy", "stressed", "excluded"):
        assert turned[name] == other[name]
    assert turned["extent_m2"] == pytest.approx(other["extent_m2"], rel=2e-3)
    assert turned["front_m"] == pytest.approx(other["front_m"], rel=0.01)
    # Density cells point north whatever the shore does: those on a border fall in other places.
    assert turned["sparse_m2"] == pytest.approx(other["sparse_m2"], rel=0.05)
    assert metrics.sections.arsi.to_numpy() == pytest.approx(slanted.sections.arsi.to_numpy(), abs=0.15)


def test_without_transects_sections_stay_too():
    for angle in (0, 30, 77):
        dsm, lake, _ = shore(angle)
        totals = measure_reed(dsm, 0.0, lake).totals()
        # Five metres at both ends of the belt, and shore without reed, are no whole sections.
        assert totals["islets"] == 4
        assert totals["holes"] == 3
        assert totals["healthy"] in (8, 9, 10)
