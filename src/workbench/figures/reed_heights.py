"""Heights of the surface against those of the field, one picture an area and one of all [reed figure 5]."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from workbench.reed import HeightAgreement

_COLUMNS = 5


def height_scatter(compared: pd.DataFrame) -> Figure:
    """Scatter of surface on field heights with the line 1:1 and the fitted one, per area and in total.

    Parameters
    ----------
    compared
        As :func:`workbench.reed.compare_heights` gives it.
    """
    parts = [*((str(aoi), part) for aoi, part in compared.groupby("aoi", sort=False)), ("total", compared)]
    columns = min(_COLUMNS, len(parts))
    rows = -(-len(parts) // columns)
    made = Figure(figsize=(2.4 * columns, 2.5 * rows), layout="constrained")
    known = compared[["field_m", "surface_m"]].to_numpy(dtype=float)
    known = known[np.isfinite(known)]
    limits = (min(0.0, float(known.min())), float(known.max())) if known.size else (0.0, 1.0)
    grid = made.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(parts) :]:
        axes.remove()
    for axes, (name, part) in zip(grid.flat, parts, strict=False):
        _draw(axes, name, part, limits)
    made.supxlabel("height above the water in the field (m)", fontsize=9)
    made.supylabel("in the surface (m)", fontsize=9)
    return made


def _draw(axes: Axes, name: str, part: pd.DataFrame, limits: tuple[float, float]) -> None:
    found = HeightAgreement.of(part.field_m, part.surface_m)
    axes.plot(part.field_m, part.surface_m, ".", markersize=2, color="#2c7fb8", alpha=0.6)
    ends = np.array(limits)
    axes.plot(ends, ends, color="#999999", linewidth=0.8)
    if np.isfinite(found.slope):
        axes.plot(ends, found.intercept + found.slope * ends, color="#d7301f", linewidth=1.2)
    axes.set_title(f"{name}: RMSE {found.rmse:.2f} m, R² {found.r2:.2f}", fontsize=8)
    axes.set_xlim(*limits)
    axes.set_ylim(*limits)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
