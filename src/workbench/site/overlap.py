"""Overlap before any work is done: footprints on level ground from recorded positions and angles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import shapely
import xarray as xr

from workbench.cameras import Camera, Pose
from workbench.errors import SiteError
from workbench.rasters import Grid, new_raster, read_overview, write_raster
from workbench.site.model import Photograph, Site
from workbench.vectors import write_layers

_EDGE_POINTS = 6
_STEEPEST = np.radians(75)  # Rays flatter than 15 degrees reach the ground too far away to be of use.
_CELLS = 160
_ISOLATED = 0.1


@dataclass(frozen=True, eq=False)
class Overlap:
    """How the photographs of a site cover level ground."""

    count: xr.DataArray
    """Photographs that see each cell, uint16."""
    footprints: gpd.GeoDataFrame
    """One polygon a photograph: photo, strip, order."""
    ground: float
    """Height of the ground that was assumed, metres."""
    ground_from: str
    """Where that height comes from."""
    forward: float
    """Median share of a footprint that the next photograph of the strip sees too; NaN without strips."""
    across: float
    """Median share that the best photograph of another strip of that camera sees; NaN with one strip."""
    isolated: tuple[str, ...]
    """Photographs that share less than a tenth of their footprint with any other one."""

    def area(self, photographs: int) -> float:
        """Area that at least so many photographs see, square metres."""
        return float((self.count >= photographs).sum()) * Grid.of(self.count).resolution ** 2

    def __str__(self) -> str:
        text = f"overlap on ground at {self.ground:.1f} m ({self.ground_from}): "
        shares = [("forward", self.forward), ("across", self.across)]
        text += ", ".join(
            f"{100 * share:.0f} % {name}" if np.isfinite(share) else f"no {name} overlap"
            for name, share in shares
        )
        areas = ", ".join(f"{self.area(n) / 1e4:.2f} ha by {n} or more" for n in (1, 2, 3, 5))
        return f"{text}; seen: {areas}"

    def _repr_html_(self) -> str:
        return f"<p>{self}</p>{self.count._repr_html_()}"


def overlap_map(site: Site, *, ground: float | None = None) -> Overlap:
    """Footprints on a level plane and the number of photographs that see each place.

    Above the plane, at tree tops, overlap is less. Photographs without recorded angles are taken as
    vertical, with the top of the frame in the direction of their strip.

    Parameters
    ----------
    ground
        Height of the plane in the site's vertical datum, metres; found by :func:`ground_height` if not
        given.

    Raises
    ------
    SiteError
        If no photograph has both a position and a camera, or all lie below the ground.
    """
    height, source = (ground, "stated") if ground is not None else ground_height(site)
    usable = [p for p in site.photographs if p.position is not None and p.camera in site.cameras]
    if not usable or site.crs is None:
        raise SiteError(
            f"Site {site.name}: no photograph has a position and a camera; there is no overlap map."
        )
    headings = _headings(usable)
    poses = [_pose(p, heading) for p, heading in zip(usable, headings, strict=True)]
    polygons = [
        _footprint(site.cameras[p.camera], pose, height) for p, pose in zip(usable, poses, strict=True)
    ]
    if all(polygon.is_empty for polygon in polygons):
        raise SiteError(
            f"Site {site.name}: all photographs lie below the ground at {height:.1f} m ({source}): "
            "positions and ground refer to different vertical datums."
        )
    frame = gpd.GeoDataFrame(
        {
            "photo": [p.name for p in usable],
            "strip": [p.strip for p in usable],
            "order": [p.order for p in usable],
        },
        geometry=polygons,
        crs=site.crs.to_wkt(),
    )
    forward, across, isolated = _shares(usable, polygons)
    return Overlap(_count(site, polygons), frame, height, source, forward, across, isolated)


def write_overlap(overlap: Overlap, folder: Path) -> Path:
    """Write ``overlap.tif`` (photographs that see each cell) and ``footprints.gpkg``.

    Returns
    -------
    Path
        The raster.

    Raises
    ------
    RasterError, VectorError
        If the folder cannot be written.
    """
    write_layers({"footprints": overlap.footprints}, folder / "footprints.gpkg")
    return write_raster(overlap.count, folder / "overlap.tif")


def ground_height(site: Site) -> tuple[float, str]:
    """Height of the ground in the site's datum, metres, and where it comes from.

    Surveyed points go first, then the terrain raster, then the recorded height above take-off.

    Raises
    ------
    SiteError
        If the site has none of them.
    """
    if site.control:
        return float(np.median([point.z for point in site.control])), "surveyed points"
    if site.dtm is not None:
        return float(np.nanmedian(read_overview(site.dtm, longest=400).values)), "terrain raster"
    heights = [
        p.position[2] - p.height_above_ground
        for p in site.photographs
        if p.position is not None and p.height_above_ground is not None
    ]
    if heights:
        return float(np.median(heights)), "recorded height above take-off"
    raise SiteError(
        f"Site {site.name}: the height of the ground is unknown: give control points or a terrain raster."
    )


def has_ground_height(site: Site) -> bool:
    """Whether :func:`ground_height` knows the height of the ground."""
    recorded = any(p.position is not None and p.height_above_ground is not None for p in site.photographs)
    return bool(site.control) or site.dtm is not None or recorded


def _headings(photographs: list[Photograph]) -> list[float]:
    """Direction of flight at each photograph, degrees from grid north, from its neighbours in the strip."""
    place = {(p.strip, p.order): np.array(p.position[:2]) for p in photographs if p.position is not None}
    headings = []
    for p in photographs:
        before = place.get((p.strip, p.order - 1), place[p.strip, p.order])
        after = place.get((p.strip, p.order + 1), place[p.strip, p.order])
        east, north = after - before
        headings.append(float(np.degrees(np.arctan2(east, north))))
    return headings


def _pose(photograph: Photograph, heading: float) -> Pose:
    centre = np.array(photograph.position)
    if photograph.attitude is not None:
        return Pose.from_omega_phi_kappa(centre, *photograph.attitude)
    return Pose.from_roll_pitch_heading(centre, 0, 0, heading)


def _footprint(camera: Camera, pose: Pose, ground: float) -> shapely.Polygon:
    """Border of the frame on the plane; empty if the camera is below it or looks away."""
    t = np.linspace(0, 1, _EDGE_POINTS, endpoint=False)
    sides = [(t, 0 * t), (1 + 0 * t, t), (1 - t, 1 + 0 * t), (0 * t, 1 - t)]
    border = np.concatenate([np.stack(side, axis=-1) for side in sides]) * (camera.width, camera.height)
    rays = pose.to_world(camera.rays(border))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    above = pose.centre[2] - ground
    if above <= 0 or pose.view_direction[2] >= 0:
        return shapely.Polygon()
    # Rays towards the horizon end where the steepest useful ray of their direction does.
    down = np.maximum(-rays[:, 2], np.cos(_STEEPEST))
    flat = rays[:, :2] / np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-12)[:, None]
    reach = above * np.sqrt(1 - down**2) / down
    return shapely.Polygon(pose.centre[:2] + flat * reach[:, None]).buffer(0)


def _shares(
    photographs: list[Photograph], polygons: list[shapely.Polygon]
) -> tuple[float, float, tuple[str, ...]]:
    tree = shapely.STRtree(polygons)
    forward, across, isolated = [], [], []
    for i, (p, polygon) in enumerate(zip(photographs, polygons, strict=True)):
        best_across, best, area = 0.0, 0.0, max(polygon.area, 1e-9)
        for j in tree.query(polygon):
            if j == i:
                continue
            other, share = photographs[j], polygon.intersection(polygons[j]).area / area
            best = max(best, share)
            if other.strip == p.strip and other.order == p.order + 1:
                forward.append(share)
            if other.strip != p.strip and other.camera == p.camera:
                best_across = max(best_across, share)
        across.append(best_across)
        if best < _ISOLATED:
            isolated.append(p.name)
    # A next photograph that shares nothing is not among the tree's answers, yet it is no overlap of NaN.
    nexts = {(p.strip, p.order) for p in photographs}
    expected = sum((p.strip, p.order + 1) in nexts for p in photographs)
    forward += [0.0] * (expected - len(forward))
    by_camera: dict[str, set[int]] = {}
    for p in photographs:
        by_camera.setdefault(p.camera, set()).add(p.strip)
    several = any(len(strips) > 1 for strips in by_camera.values())
    return (
        float(np.median(forward)) if forward else float("nan"),
        float(np.median(across)) if several else float("nan"),
        tuple(isolated),
    )


def _count(site: Site, polygons: list[shapely.Polygon]) -> xr.DataArray:
    bounds = shapely.total_bounds(polygons)
    resolution = max(bounds[2] - bounds[0], bounds[3] - bounds[1]) / _CELLS
    grid = Grid.from_bounds(site.crs, tuple(bounds), float(f"{resolution:.1g}") or resolution)
    x, y = np.meshgrid(grid.x, grid.y)
    count = np.zeros(grid.shape, dtype=np.uint16)
    for polygon in polygons:
        count += shapely.contains_xy(polygon, x, y).astype(np.uint16)
    return new_raster(count, grid, name="overlap", units="1", long_name="photographs that see the ground")
