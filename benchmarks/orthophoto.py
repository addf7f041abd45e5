"""Orthophoto: speed of the rectification, and places against a virtual scene seen straight from above.

    python benchmarks/orthophoto.py speed
    workbench simulate park && workbench run --site park
    python benchmarks/orthophoto.py places --site park [--pictures DIR]

``places`` asks of the orthophoto, made on the measured surface and on the true one, with and without the test
of visibility, where what it shows really is:
- by geometry: the pixel that gives a cell is followed through the true camera to the true surface. Marked
  points (50, on the ground and on roofs, where the measured surface is right within 0.1 m), cells within half
  a metre of the outlines of roofs, crowns, and everything.
- by pictures: against the scene rendered from a height of 50 km, an orthographic picture in calm air
  (normalised correlation): the strongest corners 3 m apart, and profiles across the outlines of the roofs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import xarray as xr
from rasterio.features import geometry_mask

from workbench.cameras import Camera, Pose
from workbench.cameras.view import view_table
from workbench.mosaic import make_orthophoto
from workbench.mosaic.colours import heights_at
from workbench.mosaic.rectify import rectify
from workbench.orientation import Block, OrientedPhotograph, read_block
from workbench.params import MosaicParameters
from workbench.rasters import Grid, match_grid, new_raster, read_raster
from workbench.site import Site, load_site
from workbench.site.tables import read_table
from workbench.stages import FOLDERS, read_json
from workbench.studies.registration import window_shifts
from workbench.surface.filling import fill_heights
from workbench.vectors import read_vector
from workbench.virtual.flight_cameras import flight_camera
from workbench.virtual.optics import tone
from workbench.virtual.render import render
from workbench.virtual.scene import build_scene, load_scene
from workbench.virtual.wind import Wind
from workbench.virtual.world import Cover

_FAR = 50_000.0
_CANDIDATES, _POINTS, _APART, _HALF, _SEARCH = 120, 50, 3.0, 0.6, 0.6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("speed", "places"))
    parser.add_argument("--site", default="park")
    parser.add_argument("--root", type=Path, default=Path())
    parser.add_argument("--pictures", type=Path, help="folder for pictures of a house")
    options = parser.parse_args()
    if options.what == "speed":
        print(speed().to_string(index=False))
    else:
        places(load_site(options.site, options.root), options.pictures)


def speed(size: int = 2048, rounds: int = 5) -> pd.DataFrame:
    """Best of several rounds, megapixels of orthophoto a second of one core (CPU time)."""
    grid = Grid.from_bounds("EPSG:32633", (500_000, 5_000_000, 500_000 + size * 0.02, 5_000_041), 0.02)
    random = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    heights = (3 * np.sin(x / 70) * np.cos(y / 50)).astype(np.float32)
    middle = np.array([(grid.west + grid.bounds[2]) / 2, grid.north - size * 0.01, 45.0])
    rows = []
    for bands, kind in ((3, np.uint8), (4, np.uint16)):
        camera = Camera(
            "c", 4000, 3000, 2300.0, 2300.0, 2000.0, 1500.0, (-0.02, 0.01, 1e-4, 1e-4, 0, 0, 0, 0)
        )
        pose = Pose.from_roll_pitch_heading(middle, 3.0, -2.0, 30.0)
        photograph = OrientedPhotograph("p", Path("p"), camera, pose, 0, 0)
        image = random.integers(1, 255, (3000, 4000, bands)).astype(kind)
        view = view_table([photograph], grid)[0]
        seconds, shown = np.inf, 0
        for _ in range(rounds + 1):
            started = time.process_time()
            colours = rectify(image, view, heights, resolution=grid.resolution)
            seconds = min(seconds, time.process_time() - started)
            shown = int(np.isfinite(colours[..., 0]).sum())
        rows.append(
            {"bands": bands, "type": np.dtype(kind).name, "Mpx/s/core": round(shown / seconds / 1e6, 1)}
        )
    return pd.DataFrame(rows)


def places(site: Site, pictures: Path | None) -> None:
    """Print where points and edges of the orthophotos stand against the picture from above."""
    if site.truth is None:
        raise SystemExit(f"{site.name} is a real site: the truth of a virtual one is needed.")
    block = read_block(site.products / FOLDERS["orient"], site)
    cell = read_json(site.products / FOLDERS["mosaic"] / "metrics.json")["resolution_m"]
    measured = read_raster(site.products / FOLDERS["surface"] / "dsm.tif")
    true_surface = read_raster(site.truth / "dsm_mean.tif")
    truth = from_above(site, Grid.from_bounds(block.crs, Grid.of(true_surface).bounds, cell))
    points = marked_points(truth, site)
    rows: list[dict] = []
    geometry: list[pd.DataFrame] = []
    wrong = np.abs(match_grid(measured, Grid.of(true_surface)) - true_surface)
    for name, surface in (("measured", measured), ("true", true_surface)):
        for visible in (True, False):
            ortho, source, hidden = orthophoto(block, surface, Grid.of(truth), visible)
            shown = shown_places(site, block, surface, source, true_surface)
            geometry.append(
                summary(shown, wrong, site, points, cell).assign(surface=name, visibility=visible)
            )
            label = {"surface": name, "visibility": visible}
            right = surface_is_right(surface, true_surface, points)
            for place, table in (
                ("points", point_shifts(truth, ortho, points)),
                ("roof edges", edge_shifts(truth, ortho, site)),
            ):
                if place == "points":  # the strongest of those where the surface is right
                    table = table[right].head(_POINTS)
                known = table[table.score >= 0.7]
                shift = known.shift_m.to_numpy() / cell
                rows.append(
                    label
                    | {"places": place, "number": len(table), "found": len(known)}
                    | {"median_gsd": np.median(shift), "p95_gsd": np.percentile(shift, 95)}
                    | {"within_1_gsd": float((shift <= 1).mean()), "hidden_share": hidden}
                )
            if pictures is not None:
                draw(ortho, site, pictures / f"{site.name}_{name}_{'true' if visible else 'double'}.jpg")
    if pictures is not None:
        draw(truth, site, pictures / f"{site.name}_from_above.jpg")
    print(f"cell {cell} m\n\nby geometry")
    print(pd.concat(geometry).to_string(index=False, float_format=lambda value: f"{value:.3f}"))
    print("\nby pictures")
    print(pd.DataFrame(rows).to_string(index=False, float_format=lambda value: f"{value:.3f}"))


def from_above(site: Site, grid: Grid) -> xr.DataArray:
    """The scene straight from above, in the light of the middle of the flight."""
    scene = build_scene(load_scene(site.name))
    west, south, east, north = grid.bounds
    centre = np.array([(west + east) / 2, (south + north) / 2, _FAR])
    focal = (_FAR - scene.spec.terrain.base) / grid.resolution
    camera = Camera("far", grid.width, grid.height, focal, focal, grid.width / 2, grid.height / 2)
    taken = [p.time for p in site.photographs if p.time is not None]
    when = taken[len(taken) // 2] if taken else scene.spec.flight.time
    view = render(
        scene,
        camera,
        Pose.from_omega_phi_kappa(centre, 0, 0, 0),
        time=when if isinstance(when, datetime) else scene.spec.flight.time,
        wind=Wind.calm(),
        bands=("red", "green", "blue"),
    )
    return new_raster(tone(view.radiance.values * 1.6), grid, name="from_above", units="1", nodata=0)


def orthophoto(
    block: Block, surface: xr.DataArray, grid: Grid, visible: bool
) -> tuple[xr.DataArray, xr.DataArray, float]:
    """An orthophoto on the cells of a grid, its sources, and the share of cells that are hidden from all."""
    parameters = MosaicParameters(resolution=grid.resolution, visibility=visible, balance=False)
    with tempfile.TemporaryDirectory() as folder:
        made = make_orthophoto(block, surface, folder, parameters)
        ortho = match_grid(read_raster(Path(folder) / "ortho.tif"), grid, resampling="bilinear").load()
        return ortho, read_raster(Path(folder) / "source.tif").load(), made.share(3)


def shown_places(
    site: Site, block: Block, surface: xr.DataArray, source: xr.DataArray, true_surface: xr.DataArray
) -> xr.DataArray:
    """How far (metres, horizontally) what each cell shows is from the cell; NaN where it shows nothing."""
    spec = load_scene(site.name).flight
    camera = flight_camera(spec.camera, reduction=spec.reduction, frame=spec.frame).camera
    poses = true_poses(site)
    grid = Grid.of(source)
    heights = fill_heights(surface)
    z, _ = heights_at(heights, grid, slice(0, grid.height), slice(0, grid.width))
    x, y = np.meshgrid(grid.x, grid.y)
    away = np.full(grid.shape, np.nan, np.float32)
    for index, photograph in enumerate(block):
        given = source.values == index + 1
        if not given.any():
            continue
        places = np.c_[x[given], y[given], z[given]]
        pose = poses[Path(photograph.name).stem]
        rays = pose.to_world(camera.rays(photograph.project(places)))
        met = first_hit(pose.centre, rays, true_surface)
        away[given] = np.hypot(*(met - places)[:, :2].T)
    return source.copy(data=away)


def true_poses(site: Site) -> dict[str, Pose]:
    names = ["photo", "x", "y", "z", "omega", "phi", "kappa"]
    found = {}
    for _, row in read_table((site.truth or site.folder) / "poses.csv", names):
        x, y, z, omega, phi, kappa = (float(row[name]) for name in names[1:])
        found[Path(row["photo"]).stem] = Pose.from_omega_phi_kappa(np.array([x, y, z]), omega, phi, kappa)
    return found


def first_hit(start: np.ndarray, rays: np.ndarray, surface: xr.DataArray) -> np.ndarray:
    """Where rays (n, 3) from a station first meet a surface, to a quarter of a cell; NaN if never."""
    grid = Grid.of(surface)
    heights = surface.values
    steep = rays / -rays[:, 2:]
    fall = 0.25 * grid.resolution / max(float(np.hypot(*steep[:, :2].T).max()), 0.25)
    met = np.full(rays.shape, np.nan)
    flying = np.arange(len(rays))
    for level in np.arange(np.nanmax(heights), np.nanmin(heights) - fall, -fall):
        places = start + steep[flying] * (start[2] - level)
        rows = np.floor((grid.north - places[:, 1]) / grid.resolution).astype(int)
        columns = np.floor((places[:, 0] - grid.west) / grid.resolution).astype(int)
        inside = (rows >= 0) & (rows < grid.height) & (columns >= 0) & (columns < grid.width)
        down = np.zeros(len(places), bool)
        down[inside] = heights[rows[inside], columns[inside]] >= level
        met[flying[down]] = places[down]
        flying = flying[~down]
        if not len(flying):
            break
    return met


def summary(
    shown: xr.DataArray, wrong: xr.DataArray, site: Site, points: np.ndarray, cell: float
) -> pd.DataFrame:
    """Distances of the marked points, of cells along roofs, of crowns and of all cells, in cells."""
    truth = site.truth or site.folder
    grid = Grid.of(shown)
    error = match_grid(wrong, grid).values
    cover = match_grid(read_raster(truth / "cover.tif"), grid, resampling="nearest").values
    outlines = read_vector(truth / "buildings.gpkg").boundary.buffer(0.5)
    edges = geometry_mask(list(outlines), grid.shape, grid.transform, invert=True)
    crowns = np.isin(cover, [Cover.BROADLEAF, Cover.CONIFER])
    rows = ((grid.north - points[:, 1]) / grid.resolution).astype(int)
    columns = ((points[:, 0] - grid.west) / grid.resolution).astype(int)
    right = error[rows, columns] <= 0.1
    marked = shown.values[rows[right][:_POINTS], columns[right][:_POINTS]]
    kinds = {
        "marked points": marked,
        "roof edges": shown.values[edges],
        "roof edges, surface right": shown.values[edges & (error <= 0.1)],
        "crowns": shown.values[crowns],
        "crowns, surface right": shown.values[crowns & (error <= 0.1)],
        "all": shown.values[cover > 0],
    }
    table = []
    for kind, away in kinds.items():
        known = away[np.isfinite(away)] / cell
        table.append(
            {"places": kind, "number": len(away), "shown": len(known)}
            | {"median_gsd": np.median(known), "p95_gsd": np.percentile(known, 95)}
            | {"within_1_gsd": float((known <= 1).mean())}
        )
    return pd.DataFrame(table)


def marked_points(truth: xr.DataArray, site: Site) -> np.ndarray:
    """(n, 2) world coordinates of the strongest corners of what does not move in the wind."""
    grid = Grid.of(truth)
    cover = match_grid(read_raster((site.truth or site.folder) / "cover.tif"), grid, resampling="nearest")
    # Neither leaves, which sway, nor the edge of a roof, which is judged by itself.
    leaves = np.isin(cover.values, [Cover.BROADLEAF, Cover.CONIFER, Cover.DEAD_TREE])
    roofs = read_vector((site.truth or site.folder) / "buildings.gpkg")
    edges = geometry_mask(list(roofs.boundary.buffer(0.5)), grid.shape, grid.transform, invert=True)
    leaves |= edges
    border = int((_HALF + _SEARCH) / grid.resolution) + 8
    mask = cv2.erode((~leaves).astype(np.uint8), np.ones((2 * border // 3 + 1,) * 2, np.uint8))
    mask[:border] = mask[-border:] = mask[:, :border] = mask[:, -border:] = 0
    grey = truth.values.mean(axis=0).astype(np.float32)
    found = cv2.goodFeaturesToTrack(grey, _CANDIDATES, 0.001, _APART / grid.resolution, mask=mask)
    columns, rows = found[:, 0].T
    return np.c_[grid.west + (columns + 0.5) * grid.resolution, grid.north - (rows + 0.5) * grid.resolution]


def surface_is_right(surface: xr.DataArray, truth: xr.DataArray, points: np.ndarray) -> np.ndarray:
    """Where the surface around a point is within 0.1 m of the true one (median)."""
    grid = Grid.of(truth)
    difference = np.abs(match_grid(surface, grid).values - truth.values)
    rows = ((grid.north - points[:, 1]) / grid.resolution).astype(int)
    columns = ((points[:, 0] - grid.west) / grid.resolution).astype(int)
    windows = [difference[r - 2 : r + 3, c - 2 : c + 3] for r, c in zip(rows, columns, strict=True)]
    return np.array([np.nanmedian(w) <= 0.1 if np.isfinite(w).any() else False for w in windows])


def point_shifts(truth: xr.DataArray, ortho: xr.DataArray, points: np.ndarray) -> pd.DataFrame:
    windows = [(x - _HALF, y - _HALF, x + _HALF, y + _HALF) for x, y in points]
    table = window_shifts(truth, ortho, windows, search=_SEARCH)
    return table.assign(shift_m=np.hypot(table.east_m, table.north_m))


def edge_shifts(truth: xr.DataArray, ortho: xr.DataArray, site: Site) -> pd.DataFrame:
    """Across each metre of the outline of the roofs: where the profile of the truth is found again."""
    roofs = read_vector((site.truth or site.folder) / "buildings.gpkg")
    offsets = np.arange(-1.2, 1.2001, 0.02)
    rows = []
    for ring in roofs.geometry.exterior:
        for at in np.arange(0.5, ring.length - 0.5, 1.0):
            a, b = (np.array(ring.interpolate(at + step).coords[0]) for step in (-0.25, 0.25))
            along = (b - a) / max(np.linalg.norm(b - a), 1e-9)
            across = np.array([-along[1], along[0]])
            lines = [(a + b) / 2 + along * t for t in np.arange(-0.24, 0.25, 0.06)]
            places = np.array([line + across * o for line in lines for o in offsets])
            profiles = [
                sample(mosaic, places).reshape(len(lines), -1).mean(axis=0) for mosaic in (truth, ortho)
            ]
            rows.append(_best_offset(profiles[0], profiles[1], offsets[1] - offsets[0]))
    return pd.DataFrame(rows, columns=["shift_m", "score"])


def _best_offset(profile: np.ndarray, other: np.ndarray, step: float) -> tuple[float, float]:
    reach = round(_SEARCH / step)
    core = profile[reach:-reach]
    if not (np.isfinite(profile).all() and np.isfinite(other).all()) or np.ptp(core) < 12:
        return np.nan, np.nan
    scores = [
        np.corrcoef(core, other[reach + k : len(other) - reach + k])[0, 1] for k in range(-reach, reach + 1)
    ]
    best = int(np.nanargmax(scores))
    return abs(best - reach) * step, float(scores[best])


def sample(mosaic: xr.DataArray, places: np.ndarray) -> np.ndarray:
    """Bilinear brightness, NaN where the mosaic is empty."""
    grid = Grid.of(mosaic)
    values = mosaic.values.astype(np.float32)
    grey = np.where((values == 0).all(axis=0), np.nan, values.mean(axis=0)).astype(np.float32)
    x = ((places[:, 0] - grid.west) / grid.resolution - 0.5).astype(np.float32)
    y = ((grid.north - places[:, 1]) / grid.resolution - 0.5).astype(np.float32)
    return cv2.remap(grey, x[None], y[None], cv2.INTER_LINEAR, borderValue=np.nan)[0]


def draw(ortho: xr.DataArray, site: Site, path: Path) -> None:
    """The surroundings of the first house."""
    roofs = read_vector((site.truth or site.folder) / "buildings.gpkg")
    west, south, east, north = roofs.geometry.iloc[0].buffer(7).bounds
    part = ortho.sel(x=slice(west, east), y=slice(north, south))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.moveaxis(part.values, 0, -1)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
