"""Interactive bilateral filter: map, and a profile through a tree before and after [thesis figure 4.25]."""

from __future__ import annotations

import time
from functools import lru_cache

import numpy as np
import panel as pn
import xarray as xr
from matplotlib.figure import Figure

from workbench.errors import SurfaceError
from workbench.figures.maps import draw_surface
from workbench.rasters import Grid
from workbench.surface import bilateral

SIZES = (5, 9, 13, 25, 49, 97, 149, 249)
"""Windows to choose from, cells; the thesis uses 49 and 249."""


def smoothing_panel(surface: xr.DataArray) -> pn.Column:
    """Sliders for the window and both sigmas; the profile follows a row of the surface.

    Parameters
    ----------
    surface
        Heights (y, x), metres, a few hundred cells across; NaN where nothing was measured.

    Raises
    ------
    SurfaceError
        If the surface holds no height.
    """
    row = highest_row(surface)
    size = pn.widgets.DiscreteSlider(name="window (cells)", options=list(SIZES), value=49)
    sigma = pn.widgets.FloatSlider(name="sigma of height (m)", start=0.5, end=30, step=0.5, value=10)
    share = pn.widgets.FloatSlider(name="sigma of space / window", start=0.05, end=0.5, step=0.01, value=0.17)
    line = pn.widgets.IntSlider(name="row of the profile", start=0, end=surface.sizes["y"] - 1, value=row)

    @lru_cache(maxsize=48)
    def filtered(window: int, height: float, space: float) -> tuple[xr.DataArray, float]:
        started = time.perf_counter()
        result = bilateral(surface.values, window, height, max(space * window, 0.1))
        return surface.copy(data=np.asarray(result)), time.perf_counter() - started

    def draw(window: int, height: float, space: float, chosen: int) -> Figure:
        return draw_smoothing(surface, filtered(window, height, space)[0], chosen)

    def told(window: int, height: float, space: float) -> str:
        smooth, seconds = filtered(window, height, space)
        change = np.abs((smooth - surface).values)
        return (
            f"{seconds:.2f} s for {surface.size / 1e6:.2f} million cells; the surface moved by "
            f"{np.nanmedian(change):.2f} m in the median, by {np.nanpercentile(change, 95):.2f} m in 5 %."
        )

    moved = [widget.param.value_throttled for widget in (size, sigma, share)]
    return pn.Column(
        pn.Row(pn.Column(size, sigma), pn.Column(share, line)),
        pn.pane.Matplotlib(pn.bind(draw, *moved, line.param.value_throttled), tight=True, width=820),
        pn.pane.Markdown(pn.bind(told, *moved)),
    )


def highest_row(surface: xr.DataArray) -> int:
    """Row of the highest cell: a profile through the top of a tree.

    Raises
    ------
    SurfaceError
        If the surface holds no height.
    """
    values = surface.values
    if not np.isfinite(values).any():
        raise SurfaceError(f"Surface {surface.name} holds no height: nothing to smooth.")
    return int(np.unravel_index(np.nanargmax(values), values.shape)[0])


def draw_smoothing(surface: xr.DataArray, smooth: xr.DataArray, row: int) -> Figure:
    """The filtered surface as a map, and one row of it before and after."""
    made = Figure(figsize=(8.6, 7.2), layout="constrained")
    above, below = made.subplots(2, 1, height_ratios=[2, 1])
    draw_surface(above, smooth, label="filtered (m)")
    grid = Grid.of(surface)
    above.axhline(grid.y[row], color="white", linewidth=1, linestyle="--")
    distance = grid.x - grid.west
    below.plot(distance, surface.values[row], color="0.55", linewidth=0.9, label="measured")
    below.plot(distance, smooth.values[row], color="#c0392b", linewidth=1.4, label="filtered")
    below.set_xlabel("distance along the dashed line (m)")
    below.set_ylabel("height (m)")
    below.legend(fontsize=8)
    return made
