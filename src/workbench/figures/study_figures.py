"""Figures of studies in the form of the thesis, from the tidy table alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from workbench.cameras import intersection_angle
from workbench.errors import StudyError
from workbench.figures.maps import figure
from workbench.rasters import Grid
from workbench.studies.analysis import means
from workbench.studies.collapse import Collapse
from workbench.surface.statistics import RATIO_CLASSES

_COLOURS = ("#1b5e8c", "#d1822b", "#4b8a3f", "#a23b52", "#6d5ba6", "#7a7a7a")
_MARKS = ("o", "s", "^", "D", "v", "P")


def draw_angle_over_overlap(cameras: pd.DataFrame) -> Figure:
    """Intersection angle over forward overlap for cameras [thesis figures 4.3, 4.9, 4.15].

    Parameters
    ----------
    cameras
        Columns ``camera``, ``focal_mm``, ``pixel_um``, ``pixels_along``, as ``published/cameras.csv``.
    """
    made, axes = figure(7.0, 4.2)
    overlap = np.linspace(0.5, 1.0, 51)
    for place, row in enumerate(cameras.to_dict("records")):
        angle = [
            intersection_angle(o, row["pixels_along"], row["pixel_um"] * 1e-3, row["focal_mm"])
            for o in overlap
        ]
        label = f"{row['camera']}, {row['focal_mm']:g} mm"
        axes.plot(100 * overlap, angle, label=label, color=_COLOURS[place % len(_COLOURS)])
    axes.axhspan(5, 10, color="#4b8a3f", alpha=0.12, lw=0)
    axes.text(99, 7.5, "usable in trees (thesis)", fontsize=8, va="center", ha="left", rotation=0)
    axes.set(xlim=(100, 50), ylim=(0, None), xlabel="forward overlap (%)", ylabel="intersection angle (°)")
    axes.legend(fontsize=8, frameon=False)
    axes.grid(alpha=0.3)
    return made


def draw_ratio_histogram(table: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]], scope: str) -> Figure:
    """Shares of the eleven classes of V in chosen cells [thesis figures 4.4, 4.11, 4.16, 4.19].

    Parameters
    ----------
    table
        Tidy table with the responses of ``counts``.
    cells
        Legend and levels (factor to level) of each group of bars.
    scope
        ``area`` or ``mask``.
    """
    made, axes = figure(7.5, 4.0)
    width = 0.8 / max(len(cells), 1)
    for place, (label, levels) in enumerate(cells.items()):
        shares = [_mean_in(table, f"v_{name}_{scope}", levels) for name in RATIO_CLASSES]
        at = np.arange(len(RATIO_CLASSES)) + (place - (len(cells) - 1) / 2) * width
        axes.bar(at, shares, width, label=label, color=_COLOURS[place % len(_COLOURS)])
    names = ["0", *(f"≤{high}" for high in range(10, 110, 10))]
    axes.set_xticks(range(len(RATIO_CLASSES)), names)
    where = "area" if scope == "area" else "trees"
    axes.set(xlabel="measured of possible pairs (%)", ylabel=f"share of the {where} (%)")
    axes.legend(fontsize=8, frameon=False)
    return made


def draw_response(
    table: pd.DataFrame, response: str, *, over: str, by: str | None = None, label: str | None = None
) -> Figure:
    """Mean of a response over the levels of one factor, a line per level of another, intervals over seeds.

    With ``over="thin"`` unmatched shares look like thesis figures 4.10 and 4.24; with tops and angles like
    4.33-4.36.

    Parameters
    ----------
    table
        Tidy table; other factors are averaged.
    response
        What is drawn.
    over, by
        Factor (or ``angle``, the measured one) along the axis, and factor of the lines.
    label
        Of the axis of ``over``.
    """
    made, axes = figure(6.5, 4.0)
    draw_response_on(axes, table, response, over=over, by=by)
    axes.set_xlabel(label or over)
    return made


def draw_response_on(
    axes: Axes, table: pd.DataFrame, response: str, *, over: str, by: str | None = None
) -> None:
    """The same on axes that exist."""
    lines = [None] if by is None else list(dict.fromkeys(table[by].astype(str)))
    unit = table.loc[table["response"] == response, "unit"]
    for place, level in enumerate(lines):
        part = table if level is None else table[table[by].astype(str) == level]
        summary = _summary(part, response, over)
        style: dict[str, Any] = {
            "color": _COLOURS[place % len(_COLOURS)],
            "marker": _MARKS[place % len(_MARKS)],
        }
        x = summary[over].to_numpy()
        drawn = np.arange(len(x)) if x.dtype == object else x.astype(float)
        spread = np.nan_to_num(summary[["low", "high"]].to_numpy())
        axes.plot(
            drawn, summary["mean"], label=None if level is None else f"{by} {level}", lw=1.4, ms=5, **style
        )
        if summary["low"].notna().any():
            axes.vlines(drawn, spread[:, 0], spread[:, 1], color=style["color"], lw=1, alpha=0.6)
        if x.dtype == object:
            axes.set_xticks(drawn, x)
    drawn_means = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()])
    known = drawn_means[np.isfinite(drawn_means)]
    if known.size:
        # Student's intervals of two seeds would press the lines flat: they are cut off by the frame.
        reach = max(float(np.ptp(known)), 1e-9)
        axes.set_ylim(float(known.min()) - 0.25 * reach, float(known.max()) + 0.25 * reach)
    axes.set_ylabel(f"{response} ({unit.iloc[0]})" if len(unit) else response)
    axes.grid(alpha=0.3)
    if by is not None:
        axes.legend(fontsize=8, frameon=False)


def count_table(table: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Shares of the counts in the area and in trees, a column per cell [thesis tables 4.2-4.12].

    Parameters
    ----------
    table
        Tidy table with the responses of ``counts``.
    cells
        Name and levels of each cell.
    """
    names = [name for name in table["response"].unique() if name.startswith("count_") and "mean" not in name]
    counts = sorted({int(name.split("_")[1]) for name in names})
    columns: dict[str, list[float]] = {}
    for label, levels in cells.items():
        for scope, title in (("area", "area"), ("mask", "trees")):
            if f"count_0_{scope}" in names:
                columns[f"{label}, {title}"] = [_mean_in(table, f"count_{n}_{scope}", levels) for n in counts]
    made = pd.DataFrame(columns, index=pd.Index(counts, name="count"))
    return made[(made.fillna(0) > 0).any(axis=1)]


def draw_count_maps(maps: Mapping[str, xr.DataArray], extent: tuple[float, float, float, float]) -> Figure:
    """Count layers side by side on one scale; cells that no pair measured are red.

    Parameters
    ----------
    maps
        Title and count raster of each map.
    extent
        West, south, east, north that is shown, m.
    """
    if not maps:
        raise StudyError("No map to draw: run the study with maps: true.")
    columns = min(len(maps), 4)
    rows = -(-len(maps) // columns)
    made = Figure(figsize=(3.1 * columns, 2.6 * rows + 0.4), layout="constrained")
    top = max(int(raster.max()) for raster in maps.values())
    image = None
    for place, (title, raster) in enumerate(maps.items()):
        axes = made.add_subplot(rows, columns, place + 1)
        west, south, east, north = Grid.of(raster).bounds
        counts = np.ma.masked_equal(raster.to_numpy(), 0)
        axes.set_facecolor("#b3243b")
        image = axes.imshow(
            counts, extent=(west, east, south, north), cmap="viridis", vmin=1, vmax=max(top, 2)
        )
        axes.set(xlim=(extent[0], extent[2]), ylim=(extent[1], extent[3]), xticks=[], yticks=[])
        axes.set_title(title, fontsize=9)
    if image is not None:
        made.colorbar(image, ax=made.axes, label="pairs that measured the cell (red: none)", shrink=0.7)
    return made


def draw_beside_published(merged: pd.DataFrame, rho: float, label: str) -> Figure:
    """Simulated over published values of one table, with the rank correlation."""
    made, axes = figure(4.6, 4.2)
    axes.scatter(merged["published"], merged["simulated"], color=_COLOURS[0])
    top = 1.05 * float(np.nanmax(merged[["published", "simulated"]].to_numpy()))
    axes.plot([0, top], [0, top], color="#7a7a7a", lw=0.8)
    axes.set(xlabel=f"{label}, published", ylabel=f"{label}, simulated", xlim=(0, top), ylim=(0, top))
    axes.set_title(f"rank correlation {rho:.2f}", fontsize=10)
    return made


def draw_collapse(ours: Collapse, published: Collapse) -> Figure:
    """Unmatched share over disparity per metre of height, logit scale: virtual flights and Table 4.1."""
    made, axes = figure(6.5, 4.6)
    for name, fit, colour, filled in (
        ("virtual", ours, _COLOURS[0], True),
        ("Table 4.1", published, "#b3243b", False),
    ):
        for place, (gsd, part) in enumerate(fit.cells.groupby("gsd_cm")):
            face = colour if filled else "none"
            mark = _MARKS[place % len(_MARKS)]
            axes.plot(
                part["pixels_per_metre"],
                part["logit"],
                mark,
                mec=colour,
                mfc=face,
                label=f"{name}, {gsd:g} cm",
            )
        x = np.geomspace(fit.cells["pixels_per_metre"].min(), fit.cells["pixels_per_metre"].max(), 20)
        axes.plot(x, fit.intercept + fit.slope * np.log(x), color=colour, lw=1)
    axes.set_xscale("log")
    shares = np.array([0.02, 0.1, 0.5, 1, 2, 5, 10, 20, 40, 60, 80, 95, 99.5])
    axes.set_yticks(np.log(shares / (100 - shares)), [f"{share:g}" for share in shares])
    axes.set(xlabel="disparity (px per metre of height)", ylabel="unmatched (%)")
    axes.legend(fontsize=8, frameon=False, ncols=2)
    axes.grid(alpha=0.3)
    return made


def draw_verdicts(findings: pd.DataFrame) -> Figure:
    """Verdicts of all findings, a strip per paper; lighter where an interval holds its threshold."""
    colours = {"confirmed": "#2e7d4f", "not confirmed": "#b3243b", "not testable": "#9a9a9a"}
    made, axes = figure(9.5, 2.2)
    papers = list(dict.fromkeys(findings["source"]))
    for line, paper in enumerate(papers):
        for place, row in enumerate(findings[findings["source"] == paper].to_dict("records")):
            sure = row["sure"] or row["verdict"] == "not testable"
            axes.barh(-line, 0.92, left=place, color=colours[row["verdict"]], alpha=1 if sure else 0.55)
            axes.text(place + 0.46, -line, row["id"], ha="center", va="center", fontsize=7, color="white")
    axes.set_yticks([-line for line in range(len(papers))], papers)
    axes.set_xticks([])
    axes.spines[:].set_visible(False)
    handles = [axes.barh(0, 0, color=colour, label=name) for name, colour in colours.items()]
    axes.legend(
        handles=handles, fontsize=8, ncols=3, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1)
    )
    return made


def _summary(table: pd.DataFrame, response: str, over: str) -> pd.DataFrame:
    if over == "angle":
        angle = table[table["response"] == "angle"]
        factors = [c for c in table.columns if c not in ("response", "value", "unit", "seed")]
        key = [*factors, "seed"]
        joined = table[table["response"] == response].merge(
            angle[[*key, "value"]].rename(columns={"value": "angle"}), on=key
        )
        means_ = joined.groupby(factors, sort=False)[["angle", "value"]].mean().reset_index()
        ordered = means_.rename(columns={"value": "mean"}).sort_values("angle")
        return ordered.assign(low=np.nan, high=np.nan)
    other = [c for c in table.columns if c in (over, "seed", "response", "value", "unit")]
    averaged = table[other].groupby([over, "seed", "response", "unit"], sort=False)["value"].mean()
    return means(averaged.reset_index(), response)


def _mean_in(table: pd.DataFrame, response: str, levels: Mapping[str, Any]) -> float:
    chosen = table[table["response"] == response]
    for factor, level in levels.items():
        chosen = chosen[chosen[factor].astype(str) == str(level)]
    return float(chosen["value"].mean())
