"""Maps of rasters: hillshade, classes, counts and orthophotos, ready for a report or a notebook."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

_SUN_AZIMUTH, _SUN_ELEVATION = 315.0, 45.0


def hillshade(
    surface: xr.DataArray, *, azimuth: float = _SUN_AZIMUTH, elevation: float = _SUN_ELEVATION
) -> np.ndarray:
    """Brightness (rows, columns), 0..1, of a surface lit from an azimuth and elevation in degrees.

    NaN stays NaN; its neighbours keep their own slope where one side is known.
    """
    step_y, step_x = (abs(float(surface[axis][1] - surface[axis][0])) for axis in ("y", "x"))
    down, right = np.gradient(surface.values.astype(float), step_y, step_x)
    sun, height = np.radians(azimuth), np.radians(elevation)
    # Rows run south: a height that grows downwards falls to the north.
    toward_east, toward_north = -right, down
    light = (
        np.sin(height) + np.cos(height) * (toward_east * np.sin(sun) + toward_north * np.cos(sun))
    ) / np.sqrt(1 + right**2 + down**2)
    return np.clip(light, 0, 1)


def figure(width: float = 6.2, height: float = 4.9) -> tuple[Figure, Axes]:
    """An empty figure with one axes, without any global state of matplotlib."""
    made = Figure(figsize=(width, height), layout="constrained")
    return made, made.add_subplot()


def draw_surface(
    axes: Axes, surface: xr.DataArray, label: str = "height (m)", cmap: str = "gist_earth"
) -> None:
    """Hillshade under a colour scale of heights; the scale spans the 1st to 99th percentile."""
    draw_values(axes, surface, label=label, cmap=cmap)
    axes.imshow(hillshade(surface), extent=extent(surface), cmap="gray", alpha=0.45, vmin=0, vmax=1)


def draw_values(axes: Axes, raster: xr.DataArray, *, label: str, cmap: str = "viridis", **style: Any) -> None:
    """One continuous band with its colour bar, spanning the 1st to 99th percentile."""
    values = raster.values.astype(float)
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, [1, 99]) if finite.size else (0.0, 1.0)
    style = {"vmin": low, "vmax": high if high > low else low + 1} | style
    image = axes.imshow(values, extent=extent(raster), cmap=cmap, interpolation="nearest", **style)
    colour_bar(axes, image, label)
    _name_axes(axes, raster)


def colour_bar(axes: Axes, drawn: Any, label: str) -> None:
    """Colour bar beside the axes, as high as they are, whatever the shape of the map."""
    beside = axes.inset_axes((1.02, 0.0, 0.035, 1.0))
    axes.figure.colorbar(drawn, cax=beside, label=label)
    beside.tick_params(labelsize=7)


def draw_classes(axes: Axes, raster: xr.DataArray, classes: dict[int, tuple[str, str]]) -> None:
    """Class values with a legend: value to (label, colour)."""
    values = list(classes)
    norm = BoundaryNorm([value - 0.5 for value in values] + [values[-1] + 0.5], len(values))
    colours = ListedColormap([colour for _, colour in classes.values()])
    axes.imshow(raster.values, extent=extent(raster), cmap=colours, norm=norm, interpolation="nearest")
    present = set(np.unique(raster.values).tolist())
    for value, (label, colour) in classes.items():
        if value in present:
            axes.plot([], [], "s", color=colour, label=label)
    axes.legend(loc="upper right", fontsize=7, framealpha=0.9)
    _name_axes(axes, raster)


def draw_orthophoto(axes: Axes, ortho: xr.DataArray) -> None:
    """Red, green, blue of an orthophoto; nodata is white, 16 bit is stretched to its 99th percentile."""
    bands = np.moveaxis(ortho.values[:3], 0, -1) if ortho.ndim == 3 else ortho.values[..., None]
    if bands.shape[-1] < 3:
        bands = np.repeat(bands[..., :1], 3, axis=-1)
    empty = (bands == 0).all(axis=-1)
    white = (
        255.0
        if bands.dtype == np.uint8
        else float(np.percentile(bands[~empty], 99))
        if (~empty).any()
        else 1.0
    )
    picture = np.clip(bands / white, 0, 1)
    picture[empty] = 1
    axes.imshow(picture, extent=extent(ortho), interpolation="nearest")
    _name_axes(axes, ortho)


def extent(raster: xr.DataArray) -> tuple[float, float, float, float]:
    """West, east, south, north of a raster whose cells need not be square."""
    x, y = raster.x.values, raster.y.values
    half_x = abs(x[1] - x[0]) / 2 if len(x) > 1 else 0.5
    half_y = abs(y[1] - y[0]) / 2 if len(y) > 1 else 0.5
    return float(x[0] - half_x), float(x[-1] + half_x), float(y[-1] - half_y), float(y[0] + half_y)


def _name_axes(axes: Axes, raster: xr.DataArray) -> None:
    code = raster.rio.crs.to_epsg() if raster.rio.crs is not None else None
    axes.set_xlabel(f"east (m), EPSG:{code}" if code else "east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelsize=7)
    axes.tick_params(axis="y", rotation=90)
    axes.set_aspect("equal")
