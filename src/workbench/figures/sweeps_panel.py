"""Interactive exploration of a study: factor, response, facet, and the count layer of any cell."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import panel as pn
from matplotlib.figure import Figure

from workbench.errors import StudyError
from workbench.figures.maps import draw_values, figure
from workbench.figures.study_figures import draw_response_on
from workbench.rasters import read_raster
from workbench.studies.analysis import factors_of

_NONE = "(none)"


def study_names(root: Path) -> list[str]:
    """Studies below a root that have a table."""
    return sorted(path.parent.name for path in (Path(root) / "data" / "studies").glob("*/table.csv"))


def read_study(root: Path, name: str) -> pd.DataFrame:
    """Tidy table of a study.

    Raises
    ------
    StudyError
        If it has not been run.
    """
    path = Path(root) / "data" / "studies" / name / "table.csv"
    if not path.exists():
        raise StudyError(f"{path}: not there. Run `workbench study {name.removesuffix('-quick')}`.")
    return pd.read_csv(path, low_memory=False)


def draw_facets(
    table: pd.DataFrame, response: str, *, over: str, by: str | None, facet: str | None
) -> Figure:
    """A response over one factor, lines by another, a panel per level of a third."""
    levels = [None] if facet is None else list(dict.fromkeys(table[facet].astype(str)))
    made = Figure(figsize=(max(3.4 * len(levels), 6.0), 3.8), layout="constrained")
    first = None
    for place, level in enumerate(levels):
        axes = made.add_subplot(1, len(levels), place + 1, sharey=first)
        first = first or axes
        part = table if level is None else table[table[facet].astype(str) == level]
        draw_response_on(axes, part, response, over=over, by=by)
        axes.set_xlabel(over)
        if level is not None:
            axes.set_title(f"{facet} {level}", fontsize=10)
    return made


def sweeps_panel(root: Path) -> pn.Column:
    """Choose study, response, factors and a map; everything is drawn from the table and ``maps/``.

    Raises
    ------
    StudyError
        If no study has been run below the root.
    """
    names = study_names(root)
    if not names:
        raise StudyError(f"{root}: no study has a table. Run `workbench study angle-gsd --quick`.")
    study = pn.widgets.Select(name="study", options=names, value=names[0])
    response = pn.widgets.Select(name="response")
    over = pn.widgets.Select(name="along the axis")
    by = pn.widgets.Select(name="lines")
    facet = pn.widgets.Select(name="panels")
    chosen = pn.widgets.Select(name="count layer of cell")

    def refill(name: str) -> None:
        table = read_study(root, name)
        factors = factors_of(table)
        response.options = sorted(table["response"].unique())
        over.options = factors + (["angle"] if "angle" in response.options else [])
        by.options = facet.options = [_NONE, *factors]
        over.value = factors[-1]
        by.value = factors[0] if len(factors) > 1 else _NONE
        facet.value = _NONE
        preferred = [
            r for r in ("count_0_mask", "completeness_visible", "heights.total.rmse") if r in response.options
        ]
        response.value = preferred[0] if preferred else response.options[0]
        chosen.options = sorted(p.stem for p in (Path(root) / "data/studies" / name / "maps").glob("*.tif"))

    refill(study.value)
    study.param.watch(lambda event: refill(event.new), "value")

    def curve(name: str, what: str, along: str, lines: str, panels: str) -> pn.pane.Matplotlib:
        table = read_study(root, name)
        if what not in set(table["response"]) or along not in {*factors_of(table), "angle"}:
            return pn.pane.Matplotlib(figure()[0])  # Between two studies the choices are refilled one by one.
        drawn = draw_facets(
            table,
            what,
            over=along,
            by=None if lines in (_NONE, along) else lines,
            facet=None if panels in (_NONE, along, lines) else panels,
        )
        return pn.pane.Matplotlib(drawn, tight=True, sizing_mode="scale_width", max_width=1000)

    def count_map(name: str, cell: str | None) -> pn.viewable.Viewable:
        path = Path(root) / "data" / "studies" / name / "maps" / f"{cell}.tif"
        if cell is None or not path.exists():
            return pn.pane.Markdown("No count layers were kept with this study.")
        made, axes = figure(7.0, 3.2)
        raster = read_raster(path)
        draw_values(axes, raster, label="pairs", vmin=0, vmax=max(int(raster.max()), 1))
        axes.set_title(cell, fontsize=9)
        return pn.pane.Matplotlib(made, tight=True, sizing_mode="scale_width", max_width=800)

    return pn.Column(
        pn.Row(study, response),
        pn.Row(over, by, facet),
        pn.bind(curve, study, response, over, by, facet),
        chosen,
        pn.bind(count_map, study, chosen),
    )
