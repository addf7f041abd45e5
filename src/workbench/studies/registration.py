"""How far two mosaics are shifted against each other, place by place, from their colours."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
import xarray as xr
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from workbench.errors import StudyError
from workbench.rasters import Grid, require_same_grid

_LEAST_SCORE = 0.5


def window_shifts(
    reference: xr.DataArray,
    other: xr.DataArray,
    windows: Sequence[tuple[float, float, float, float]],
    *,
    search: float,
) -> pd.DataFrame:
    """Where the pictures of windows of one mosaic are found in another.

    The window moves over the other mosaic, and the place of the largest normalised correlation is
    refined by a parabola through its neighbours.

    Parameters
    ----------
    reference, other
        Mosaics (band, y, x) or (y, x) on one grid; 0 is no data.
    windows
        West, south, east, north, metres.
    search
        Largest shift along each axis, metres.

    Returns
    -------
    DataFrame
        A row a window: ``east_m``, ``north_m`` (of the picture in ``other`` against ``reference``) and
        ``score`` (-1..1). NaN where the window leaves the mosaic, holds no data, shows nothing, or its
        best place lies at the border of the search.

    Raises
    ------
    RasterError
        If the mosaics lie on different grids.
    """
    require_same_grid(reference, other)
    grid = Grid.of(reference)
    reach = int(np.ceil(search / grid.resolution))
    grey = [_grey(mosaic) for mosaic in (reference, other)]
    rows = [_find(grey[0], grey[1], _cells(window, grid), reach) for window in windows]
    table = pd.DataFrame(rows, columns=["columns", "rows", "score"], dtype=float)
    table["east_m"], table["north_m"] = table["columns"] * grid.resolution, -table["rows"] * grid.resolution
    return table[["east_m", "north_m", "score"]]


def coregistration(
    reference: xr.DataArray,
    other: xr.DataArray,
    stable: gpd.GeoDataFrame,
    *,
    patch: float,
    search: float,
    least_score: float = _LEAST_SCORE,
) -> gpd.GeoDataFrame:
    """Shifts of two dates on stable ground: what is left there is no change of the land.

    Parameters
    ----------
    reference, other
        Mosaics of two dates on one grid.
    stable
        Areas that do not move: roads, bare ground, short grass.
    patch
        Edge of a patch, metres; patches stand side by side within the areas.
    search, least_score
        Of :func:`window_shifts`; patches found with a smaller correlation are left out.

    Returns
    -------
    GeoDataFrame
        A row a patch: ``east_m``, ``north_m``, ``shift_m``, ``score``; points.

    Raises
    ------
    StudyError
        If no patch fits into the areas, or none is found again.
    """
    area = stable.to_crs(Grid.of(reference).crs).union_all()
    windows = _patches(area, patch)
    if not windows:
        raise StudyError(f"No patch of {patch:g} m fits into the stable areas: give larger areas.")
    shifts = window_shifts(reference, other, windows, search=search)
    shifts["shift_m"] = np.hypot(shifts.east_m, shifts.north_m)
    centres = gpd.points_from_xy(
        [(west + east) / 2 for west, _, east, _ in windows],
        [(south + north) / 2 for _, south, _, north in windows],
    )
    found = gpd.GeoDataFrame(shifts, geometry=centres, crs=Grid.of(reference).crs)
    found = found[found.score >= least_score].reset_index(drop=True)
    if found.empty:
        raise StudyError(
            f"None of {len(windows)} patches is found in the other mosaic within {search:g} m: are both "
            "of the same place?"
        )
    return found


def follow_objects(
    objects: gpd.GeoDataFrame,
    reference: xr.DataArray,
    other: xr.DataArray,
    *,
    search: float,
    least_score: float = _LEAST_SCORE,
) -> gpd.GeoDataFrame:
    """Objects digitised in one mosaic, moved to where another shows them.

    Digitises the further dates of a series from the first one, by the picture within each bounding box;
    objects that are not found again are left out.

    Raises
    ------
    StudyError
        If none is found.
    """
    frame = objects.to_crs(Grid.of(reference).crs)
    windows = [tuple(bounds) for bounds in frame.bounds.to_numpy()]
    shifts = window_shifts(reference, other, windows, search=search)
    seen = shifts.score.to_numpy() >= least_score
    found = frame[seen].assign(score=shifts.score[seen].to_numpy())
    steps = shifts.loc[seen, ["east_m", "north_m"]].to_numpy()
    moved = [affinity.translate(shape, *step) for shape, step in zip(found.geometry, steps, strict=True)]
    found = found.set_geometry(moved, crs=frame.crs)
    if found.empty:
        raise StudyError(f"None of {len(objects)} objects is found in the other mosaic within {search:g} m.")
    return found


def _grey(mosaic: xr.DataArray) -> np.ndarray:
    """Mean of the bands (rows, columns) float32, NaN without data."""
    values = np.atleast_3d(mosaic.values.T).T.astype(np.float32)
    return np.where((values == 0).all(axis=0), np.float32(np.nan), values.mean(axis=0))


def _cells(window: tuple[float, float, float, float], grid: Grid) -> tuple[slice, slice]:
    west, south, east, north = window
    rows = slice(
        int(np.floor((grid.north - north) / grid.resolution)),
        int(np.ceil((grid.north - south) / grid.resolution)),
    )
    columns = slice(
        int(np.floor((west - grid.west) / grid.resolution)),
        int(np.ceil((east - grid.west) / grid.resolution)),
    )
    return rows, columns


def _find(
    reference: np.ndarray, other: np.ndarray, window: tuple[slice, slice], reach: int
) -> tuple[float, float, float]:
    """Columns, rows and score of the best place; NaN where there is none."""
    nothing = (np.nan, np.nan, np.nan)
    rows, columns = window
    around = (
        slice(rows.start - reach, rows.stop + reach),
        slice(columns.start - reach, columns.stop + reach),
    )
    if around[0].start < 0 or around[1].start < 0:
        return nothing
    picture, scene = reference[window], other[around]
    complete = scene.shape == tuple(part.stop - part.start for part in around)
    if not complete or min(picture.shape) < 3 or np.isnan(picture).any() or np.isnan(scene).any():
        return nothing
    if np.ptp(picture) == 0:
        return nothing
    scores = cv2.matchTemplate(scene, picture, cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if not (0 < row < scores.shape[0] - 1 and 0 < column < scores.shape[1] - 1):
        return nothing
    return (
        column - reach + _peak(scores[row, column - 1 : column + 2]),
        row - reach + _peak(scores[row - 1 : row + 2, column]),
        float(scores[row, column]),
    )


def _peak(three: np.ndarray) -> float:
    """Place of the top of a parabola through three values, -0.5..0.5 from the middle one."""
    left, middle, right = (float(value) for value in three)
    bend = left - 2 * middle + right
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))


def _patches(area: BaseGeometry, patch: float) -> list[tuple[float, float, float, float]]:
    shapely.prepare(area)
    west, south, east, north = area.bounds
    x, y = np.meshgrid(np.arange(west, east - patch, patch), np.arange(south, north - patch, patch))
    boxes = shapely.box(x.ravel(), y.ravel(), x.ravel() + patch, y.ravel() + patch)
    return [tuple(part.bounds) for part in boxes[shapely.contains(area, boxes)]]
