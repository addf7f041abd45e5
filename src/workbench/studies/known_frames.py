"""Photographs cut to what they show of a virtual scene: beyond it nothing is known and nothing is counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from workbench.cameras import Camera, Pose
from workbench.errors import StudyError
from workbench.photographs import read_photograph
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS

_AROUND = 12.0
"""Metres of land that stay around the scene: matching needs them at the border, and roofs and crowns lean."""
_STEPS = 64
"""Parts of a frame along either edge in which its rays are looked at."""
_WHOLE = 12
"""Windows are multiples of this, px, so that they can be reduced by 2, 3, 4 and 6 without a remainder."""
_LEAST = 240
"""Least edge of a window, px: of a fifth of it (the least overlap of a pair) a third (the coarsest downscale)
is still as wide as matching needs."""
_FOLDER = "photographs"


def cut_photographs(site: Site, poses: Mapping[str, Pose], folder: Path) -> dict[str, Camera]:
    """Write the photographs of a virtual site, cut to what they show of the scene, without loss.

    Parameters
    ----------
    site
        A virtual site.
    poses
        True poses, by the name of the photograph without its ending.
    folder
        Orientation folder of the site.

    Returns
    -------
    dict
        Camera of each photograph that shows the scene: all its rays are those of the whole frame.

    Raises
    ------
    StudyError
        If fewer than two photographs show the scene.
    """
    surface = read_raster((site.truth or site.folder) / "dsm_mean.tif")
    limits = float(np.nanmin(surface)), float(np.nanmax(surface))
    lenses = {}
    for photograph in site.photographs:
        lens, pose = site.cameras[photograph.camera], poses[photograph.name.rpartition(".")[0]]
        window = window_of(lens, pose, Grid.of(surface).bounds, limits)
        if window is None:
            continue
        rows, columns = window
        lenses[photograph.name] = replace(
            lens,
            width=columns.stop - columns.start,
            height=rows.stop - rows.start,
            principal_x=lens.principal_x - columns.start,
            principal_y=lens.principal_y - rows.start,
        )
        path = folder / _FOLDER / f"{photograph.name}.tif"
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = np.ascontiguousarray(read_photograph(photograph.path)[window])
        Image.fromarray(pixels, "RGB" if pixels.shape[-1] == 3 else "RGBA").save(path, "TIFF")
    if len(lenses) < 2:
        raise StudyError(f"Site {site.name}: {len(lenses)} photographs show the scene; two are needed.")
    return lenses


def window_of(
    lens: Camera, pose: Pose, bounds: tuple[float, float, float, float], heights: tuple[float, float]
) -> tuple[slice, slice] | None:
    """Rows and columns of a frame that show an area, from its lowest to its highest surface.

    Parameters
    ----------
    lens, pose
        Of the photograph.
    bounds
        West, south, east, north of the area, m.
    heights
        Lowest and highest surface, m.

    Returns
    -------
    tuple of slice or None
        None if the frame shows nothing of it.
    """
    share = np.arange(_STEPS + 1) / _STEPS
    columns, rows = np.meshgrid(share * lens.width, share * lens.height)
    rays = pose.to_world(lens.rays(np.stack([columns.ravel(), rows.ravel()], axis=1)))
    down = np.minimum(rays[:, 2], -1e-3)
    distance = np.full(len(rays), np.inf)
    for height in heights:
        x, y, _ = (pose.centre + rays * ((height - pose.centre[2]) / down)[:, None]).T
        out = np.maximum.reduce([bounds[0] - x, x - bounds[2], bounds[1] - y, y - bounds[3]])
        distance = np.where(rays[:, 2] < -1e-3, np.minimum(distance, out), distance)
    if not (distance < 0).any():
        return None
    shown = (distance < _AROUND).reshape(_STEPS + 1, _STEPS + 1)
    return _whole(np.any(shown, axis=1), lens.height), _whole(np.any(shown, axis=0), lens.width)


def _whole(shown: Any, size: int) -> slice:
    """Pixels from the first to the last part that is shown, one part more at either end."""
    places = np.flatnonzero(shown)
    first = int(max(places[0] - 1, 0) * size / _STEPS) // _WHOLE * _WHOLE
    last = min(int(np.ceil(min(places[-1] + 1, _STEPS) * size / _STEPS)), size)
    wanted = min(max(last - first, _LEAST), size)
    first = max(min(first, first - (wanted - (last - first)) // 2, size - wanted), 0) // _WHOLE * _WHOLE
    length = -(-max(wanted, last - first) // _WHOLE) * _WHOLE
    if first + length > size:
        # At the edge of the frame a few pixels that are no multiple stay.
        length = size - first
    return slice(first, first + length)


def with_cut_photographs(site: Site) -> Site:
    """The site with the photographs that its orientation cut; those that show nothing of the scene go."""
    folder = site.products / FOLDERS["orient"] / _FOLDER
    cut = [replace(p, path=folder / f"{p.name}.tif") for p in site.photographs]
    return replace(site, photographs=tuple(p for p in cut if p.path.exists()))
