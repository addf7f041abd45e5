import geopandas as gpd
import numpy as np
import pytest
import shapely

from workbench.mosaic import crop_area
from workbench.mosaic.seams import Preview, find_seams

SHAPE = 80, 120
STATIONS = 30, 90  # columns; the border of the best view lies halfway, at column 60
HEIGHT = 170.0
BASE_RATIO = (STATIONS[1] - STATIONS[0]) / HEIGHT
CROWN = np.s_[30:45, 55:66]  # crosses the border, and leans in each photograph to its own side


def previews(noise, seed=0, crown=True):
    random = np.random.default_rng(seed)
    ground = np.random.default_rng(1).normal(120, 25, (*SHAPE, 3))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    found = []
    for index, station in enumerate(STATIONS):
        colours = ground + random.normal(0, noise, ground.shape)
        if crown:
            colours[CROWN] = 40 if index else 200
        tangent = np.hypot(rows - SHAPE[0] / 2, columns + 0.5 - station) / HEIGHT
        found.append(
            Preview(
                index,
                slice(0, SHAPE[0]),
                slice(0, SHAPE[1]),
                colours.astype(np.float32),
                tangent.astype(np.float32),
            )
        )
    return found


def borders(labels):
    """Column at which each row goes over to the second photograph."""
    assert set(np.unique(labels)) == {1, 2}
    return (labels == 1).sum(axis=1)


def test_best_view_changes_halfway():
    labels = find_seams(previews(3), SHAPE, base_ratio=BASE_RATIO, method="best-view")
    np.testing.assert_array_equal(borders(labels), 60)


def test_a_seam_goes_around_what_looks_different():
    labels = find_seams(previews(3), SHAPE, base_ratio=BASE_RATIO)
    assert len(np.unique(labels[CROWN])) == 1


def test_a_seam_stays_within_the_band():
    band = 0.1
    labels = find_seams(previews(3), SHAPE, base_ratio=BASE_RATIO, band=band)
    # Tangents differ by 2 / height for each column away from the border.
    reach = band * BASE_RATIO * HEIGHT / 2
    assert np.abs(borders(labels) - 60).max() <= reach + 1


@pytest.mark.parametrize("noise", [3.0, 12.0])
def test_where_nothing_stands_in_the_way_noise_does_not_move_a_seam(noise):
    """What reproducibility rests on: another computation of the same photographs has the same seams."""
    runs = [find_seams(previews(noise, seed, crown=False), SHAPE, base_ratio=BASE_RATIO) for seed in range(4)]
    for labels in runs:
        assert np.abs(borders(labels) - 60).max() <= 0.1 * BASE_RATIO * HEIGHT
    assert np.mean(runs[0] != runs[1]) < 0.02


def test_a_single_photograph_gives_everything():
    labels = find_seams(previews(3)[:1], SHAPE, base_ratio=1.0)
    assert (labels == 1).all()


@pytest.mark.parametrize("bay", [0.0, 1.4])
def test_of_two_strips_nothing_is_inside_whatever_the_outline(bay):
    """A polygon that the hull misses by a metre is outermost like its neighbours."""
    polygons = [
        shapely.box(12 * k, 20 * strip, 12 * (k + 1), 20 * (strip + 1) - (bay if (strip, k) == (1, 2) else 0))
        for strip in range(2)
        for k in range(5)
    ]
    polygons[6] = polygons[6].union(shapely.box(24, 40 - bay, 36, 40))
    area = crop_area(gpd.GeoDataFrame({"source": range(10)}, geometry=polygons, crs="EPSG:32633"))
    assert not area.cropped[0]
    assert area.photographs[0] == 10


def test_of_three_strips_the_middle_one_is_inside():
    polygons = [
        shapely.box(12 * k, 20 * strip, 12 * (k + 1), 20 * (strip + 1))
        for strip in range(3)
        for k in range(5)
    ]
    area = crop_area(gpd.GeoDataFrame({"source": range(15)}, geometry=polygons, crs="EPSG:32633"))
    assert area.photographs[0] == 3
