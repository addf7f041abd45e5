"""Interactive panel of single trees: every limit beside a map of tops and crowns, their errors, a profile.

The orthophoto is brought to the screen once. A moved slider computes only the steps that depend on it
(:class:`workbench.trees.TreeModel`), and sends only tops and crown borders.
"""

from __future__ import annotations

import html
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import panel as pn
import xarray as xr
from bokeh.events import Tap
from bokeh.models import ColumnDataSource, HoverTool
from bokeh.plotting import figure

from workbench.assessment import TreeMatch, match_trees, site_reference_trees
from workbench.errors import WorkbenchError
from workbench.figures.controls import write_button
from workbench.figures.tree_pictures import (
    COLOURS,
    base_picture,
    border_picture,
    clipped,
    clipped_inputs,
    profile,
)
from workbench.params import AssessParameters, TreesParameters
from workbench.rasters import Grid, read_raster
from workbench.site import Site
from workbench.stages import FOLDERS
from workbench.trees import TreeInputs, TreeModel, read_tree_inputs

_SLIDERS: tuple[tuple[str, str, float, float, float], ...] = (
    ("working_resolution", "Working resolution (m)", 0.1, 1.0, 0.05),
    ("radius", "Constant radius (m)", 0.2, 7.0, 0.1),
    ("window_start", "Growing radius: at height zero (m)", -3.0, 4.0, 0.1),
    ("window_growth", "Growing radius: per metre of height", 0.0, 0.3, 0.005),
    ("min_height", "Minimum height (m)", 1.0, 20.0, 0.5),
    ("spacing", "Constant spacing of tops (m)", 0.5, 10.0, 0.25),
    ("spacing_growth", "Growing spacing: per metre of height", 0.0, 0.4, 0.01),
    ("saddle_share", "Saddle that parts near trees (share of height)", 0.0, 0.2, 0.005),
    ("top_smoothing", "Smoothing before tops (m)", 0.0, 1.0, 0.05),
    ("prominence_share", "Least prominence (share of height)", 0.0, 0.2, 0.005),
    ("smoothing_size", "Filter size (cells of 0.2 m)", 1, 99, 2),
    ("smoothing_sigma", "Filter sigma (m)", 0.5, 30.0, 0.5),
    ("max_slope", "Largest slope (degrees)", 10.0, 90.0, 1.0),
    ("max_aspect", "Largest turn of aspect (22.5 degrees)", 0, 8, 1),
    ("min_brightness", "Least brightness", 1.0, 150.0, 1.0),
)
_INDICES = {"ndvi": ("min_ndvi", "Least NDVI"), "gli": ("min_gli", "Least GLI")}
_SWITCHED = {"spacing": 2.0, "max_slope": 60.0, "min_brightness": 20.0}  # Off by default; where they begin.
_REACH = 12.0  # Metres on both sides of a tree in its profile.
_SMALLEST_CROWN = 1.0  # Square metres; a top with less has no crown.
_MARKERS = {"found": "circle", "false": "x", "missed": "inverted_triangle", "top": "circle"}


def tree_panel(
    source: Site | TreeInputs,
    *,
    area: tuple[float, float, float, float] | None = None,
    ortho: xr.DataArray | None = None,
    references: Mapping[str, gpd.GeoDataFrame] | None = None,
    options: TreesParameters | None = None,
    assessment: AssessParameters | None = None,
    parameters_file: Path | str | None = None,
) -> pn.Row:
    """Sliders for every limit, and at once what they do to tops, crowns and their errors.

    Parameters
    ----------
    source
        A site with a surface, or any heights and layers.
    area
        West, south, east, north of the part that is shown, in the CRS of the surface; by default all.
        About a hectare answers a moved slider at once.
    ortho
        Orthophoto (band, y, x); of a site its own. Without it the shaded surface is shown.
    references
        Reference trees by kind, as :func:`workbench.assessment.site_reference_trees` gives them; of a
        site its own. The last kind colours the errors on the map.
    options, assessment
        Where the sliders begin.
    parameters_file
        ``params.yaml`` that the button writes to; without it there is no button.

    Returns
    -------
    panel.Row
        For a notebook, or for an app: ``pn.serve(lambda: tree_panel(site))``.

    Raises
    ------
    TreesError
        If the site has no surface, or the part lies outside it.
    """
    options, assessment = options or TreesParameters(), assessment or AssessParameters()
    if isinstance(source, Site):
        stamp = source.products / FOLDERS["surface"] / "metrics.json"
        key = f"trees {source.products} {stamp.stat().st_mtime_ns if stamp.exists() else 0}"
        # Files are read once for all visitors; every visitor has a model, which keeps the last steps.
        inputs, own_ortho, own_references = pn.state.as_cached(
            key, partial(_load, source, options, assessment)
        )
        ortho = own_ortho if ortho is None else ortho
        references = own_references if references is None else references
    else:
        inputs = source
    references = dict(references or {})
    if area is not None:
        inputs = clipped_inputs(inputs, area)
        ortho = None if ortho is None else clipped(ortho, area)
        references = {
            name: table.cx[area[0] : area[2], area[1] : area[3]] for name, table in references.items()
        }
    references = {name: table.reset_index(drop=True) for name, table in references.items()}
    return _TreePanel(inputs, ortho, references, options, assessment, parameters_file).view


class _TreePanel:
    """Widgets, data of the pictures, and what connects them."""

    def __init__(
        self,
        inputs: TreeInputs,
        ortho: xr.DataArray | None,
        references: dict[str, gpd.GeoDataFrame],
        options: TreesParameters,
        assessment: AssessParameters,
        parameters_file: Path | str | None,
    ) -> None:
        self.model, self.references, self.options = TreeModel(inputs), references, options
        self.distance = assessment.match_distance
        self.sources = {name: ColumnDataSource() for name in ("borders", "points", "lines", "place")}
        self.scores = pn.pane.HTML("", width=340)
        self.message = pn.pane.Alert("", alert_type="danger", visible=False, width=340)
        self.window = pn.widgets.RadioButtonGroup(
            name="Search disc", options=["constant", "growing"], value=_kind(options), width=320
        )
        self.aspect = pn.widgets.RadioButtonGroup(
            name="Aspect", options=["never", "conifer", "always"], value=options.aspect, width=320
        )
        self.switches = {
            name: pn.widgets.Checkbox(name=_title(name), value=getattr(options, name) is not None, width=320)
            for name in _SWITCHED
        }
        self.sliders = _sliders(options, tuple(inputs.layers))
        self.chosen: tuple[float, float] | None = None
        for slider in self.sliders.values():
            slider.param.watch(self.update, "value_throttled")
        for widget in (self.window, self.aspect, *self.switches.values()):
            widget.param.watch(self.update, "value")
        map_, cut = self._map(ortho), self._profile()
        self.update()
        controls: list[Any] = [self.message, *self._controls()]
        if parameters_file is not None:
            controls.append(write_button(parameters_file, self.values))
        self.view = pn.Row(
            pn.Column(*controls, width=350),
            pn.Column(pn.pane.Bokeh(map_), pn.pane.Bokeh(cut), self.scores),
        )

    def chosen_options(self) -> dict[str, Any]:
        """Parameters that the widgets stand for."""
        values = {name: slider.value for name, slider in self.sliders.items()}
        values |= {name: values[name] if switch.value else None for name, switch in self.switches.items()}
        values["radius"] = values["radius"] if self.window.value == "constant" else None
        values["aspect"] = self.aspect.value
        return values

    def values(self) -> dict[str, Any]:
        """The same by dotted path, for ``params.yaml``."""
        return {f"trees.{name}": value for name, value in self.chosen_options().items()}

    def update(self, *_: Any) -> None:
        """Find the trees with the limits of the widgets, and show them."""
        started = time.perf_counter()
        try:
            options = TreesParameters(**(self.options.model_dump() | self.chosen_options()))
            tops, labels = self.model.tops(options), self.model.labels(options)
        except (WorkbenchError, ValueError) as error:
            self.message.object, self.message.visible = html.escape(str(error)), True
            return
        matches = {
            name: match_trees(tops, trees, self.distance)
            for name, trees in self.references.items()
            if len(trees)
        }
        # The last kind of reference colours the map.
        kind = list(matches)[-1] if matches else None
        judged = _judged(len(tops), matches.get(kind) if kind else None)
        missed = self.references[kind].iloc[matches[kind].missed] if kind else tops.iloc[:0]
        cells = np.bincount(labels.values.ravel(), minlength=len(tops) + 1)[1:]
        area = cells * Grid.of(labels).resolution ** 2
        with pn.io.hold():
            self.message.visible = False
            self.sources["borders"].data = border_picture(labels, judged)
            self.sources["points"].data = _points(tops, judged, area, missed)
            self._cut(options)
            self.scores.object = _scores(tops, area, matches, time.perf_counter() - started)

    def _controls(self) -> list[Any]:
        rows: list[Any] = []
        for name, slider in self.sliders.items():
            if name == "radius":
                rows += [pn.pane.Markdown("**Search disc**"), self.window]
            if name == "max_aspect":
                rows += [pn.pane.Markdown("**Aspect limits crowns in stands of**"), self.aspect]
            rows += [self.switches[name], slider] if name in self.switches else [slider]
        return rows

    def _map(self, ortho: xr.DataArray | None) -> Any:
        grid = Grid.of(self.model.inputs.height)
        west, south, east, north = grid.bounds
        style: dict[str, Any] = {
            "title": "Tops and crowns: click a tree for its profile",
            "frame_width": 640,
            "frame_height": int(np.clip(640 * (north - south) / (east - west), 200, 800)),
            "x_range": (west, east),
            "y_range": (south, north),
            "tools": "pan,wheel_zoom,box_zoom,reset,save",
            "active_scroll": "wheel_zoom",
            "match_aspect": True,
            "name": "tree_map",
        }
        plot = figure(**style)
        plot.axis.visible = plot.grid.visible = False
        place: dict[str, Any] = {"x": "x", "y": "y", "dw": "dw", "dh": "dh", "image": "image"}
        plot.image_rgba(source=ColumnDataSource(base_picture(self.model.inputs.height, ortho)), **place)
        plot.image_rgba(source=self.sources["borders"], **place)
        points = plot.scatter(
            "x", "y", source=self.sources["points"], marker="marker", size=8, line_width=2,
            line_color="colour", fill_color="colour", fill_alpha=0.4,
        )  # fmt: skip
        plot.scatter("x", "y", source=self.sources["place"], marker="square", size=18, line_width=2,
                     line_color="white", fill_alpha=0)  # fmt: skip
        tips = [("", "@judged"), ("height", "@height{0.0} m"), ("prominence", "@prominence{0.0} m")]
        plot.add_tools(HoverTool(renderers=[points], tooltips=[*tips, ("crown", "@diameter{0.0} m")]))
        plot.on_event(Tap, self._tapped)
        return plot

    def _profile(self) -> Any:
        style: dict[str, Any] = {
            "title": "Profile through the chosen tree",
            "frame_width": 640,
            "frame_height": 190,
            "toolbar_location": None,
            "x_range": (-_REACH, _REACH),
            "name": "tree_profile",
        }
        plot = figure(**style)
        for column, colour, dash, label in (
            ("west_east", "#1b6ca8", "solid", "west-east"),
            ("south_north", "#c2571a", "solid", "south-north"),
            ("smooth_west_east", "#1b6ca8", "dashed", "west-east, filtered"),
            ("smooth_south_north", "#c2571a", "dashed", "south-north, filtered"),
        ):
            plot.line("distance", column, source=self.sources["lines"], line_color=colour, line_dash=dash,
                      line_width=1.6, legend_label=label)  # fmt: skip
        plot.xaxis.axis_label, plot.yaxis.axis_label = "distance from the top (m)", "height (m)"
        plot.legend.label_text_font_size = "8pt"
        plot.legend.location = "top_right"
        plot.legend.background_fill_alpha = 0.6
        return plot

    def _tapped(self, event: Any) -> None:
        self.chosen = (event.x, event.y)
        with pn.io.hold():
            self._cut(TreesParameters(**(self.options.model_dump() | self.chosen_options())))

    def _cut(self, options: TreesParameters) -> None:
        """Profile through the top nearest to the chosen place; of the highest tree where none is chosen."""
        points = self.sources["points"].data
        places = np.stack([np.asarray(points["x"], float), np.asarray(points["y"], float)], axis=1)
        if not len(places):
            return
        if self.chosen is None:
            k = int(np.nanargmax(points["height"]))
        else:
            k = int(np.argmin(np.hypot(*(places - self.chosen).T)))
        x, y = places[k].tolist()
        self.sources["place"].data = {"x": [x], "y": [y]}
        self.sources["lines"].data = profile(
            self.model.inputs.height, self.model.smooth(options), x, y, _REACH
        )


def _load(site: Site, options: TreesParameters, assessment: AssessParameters) -> tuple:
    inputs = read_tree_inputs(site, options)
    ortho = site.products / FOLDERS["mosaic"] / "ortho.tif"
    crs = Grid.of(inputs.height).crs
    return inputs, read_raster(ortho) if ortho.exists() else None, site_reference_trees(site, assessment, crs)


def _judged(tops: int, match: TreeMatch | None) -> np.ndarray:
    """Word of :data:`COLOURS` for every top."""
    if match is None:
        return np.full(tops, "top", dtype=object)
    judged = np.full(tops, "false", dtype=object)
    judged[match.pairs["top"].to_numpy(int)] = "found"
    return judged


def _points(
    tops: gpd.GeoDataFrame, judged: np.ndarray, area: np.ndarray, missed: gpd.GeoDataFrame
) -> dict[str, Any]:
    """Tops and missed trees, for the map."""
    words = np.r_[judged, np.full(len(missed), "missed", dtype=object)]
    none = np.full(len(missed), np.nan)
    heights = missed["height_m"].to_numpy() if "height_m" in missed else none
    return {
        "x": np.r_[tops.geometry.x, missed.geometry.x],
        "y": np.r_[tops.geometry.y, missed.geometry.y],
        "judged": words,
        "colour": [COLOURS[word] for word in words],
        "marker": [_MARKERS[word] for word in words],
        "height": np.r_[tops["height_m"], heights],
        "prominence": np.r_[tops["prominence_m"], none],
        "diameter": np.r_[2 * np.sqrt(area / np.pi), none],
    }


def _kind(options: TreesParameters) -> str:
    return "growing" if options.radius is None else "constant"


def _title(name: str) -> str:
    return {
        "spacing": "Constant spacing",
        "max_slope": "Limit the slope",
        "min_brightness": "Stop in shadow",
    }[name]


def _sliders(options: TreesParameters, layers: tuple[str, ...]) -> dict[str, Any]:
    rows = [*_SLIDERS, *((*_INDICES[name], -0.5, 0.9, 0.01) for name in _INDICES if name in layers)]
    first = {"radius": 1.5, **_SWITCHED}
    sliders = {}
    for name, title, start, end, step in rows:
        value = getattr(options, name)
        value = first.get(name, start) if value is None else value
        kind = pn.widgets.IntSlider if isinstance(step, int) else pn.widgets.FloatSlider
        sliders[name] = kind(
            name=title, start=min(start, value), end=max(end, value), step=step, value=value, width=320
        )
    return sliders


def _scores(tops: gpd.GeoDataFrame, area: np.ndarray, matches: dict[str, Any], seconds: float) -> str:
    bare = int((area < _SMALLEST_CROWN).sum())
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{match.completeness:.1%}</td><td>{match.correctness:.1%}</td>"
        f"<td>{match.f1:.2f}</td><td>{len(match.pairs)}</td><td>{len(match.missed)}</td>"
        f"<td>{len(match.false)}</td></tr>"
        for name, match in matches.items()
    )
    table = (
        "<table cellpadding=3><tr><th>reference</th><th>completeness</th><th>correctness</th><th>F1</th>"
        f"<th style='color:{COLOURS['found']}'>found</th><th style='color:{COLOURS['missed']}'>missed</th>"
        f"<th style='color:{COLOURS['false']}'>orphan tops</th></tr>{rows}</table>"
        if matches
        else "<p>No reference trees here: nothing to compare the tops with.</p>"
    )
    return (
        f"<p><b>{len(tops)} tops</b>, {bare} without a crown of {_SMALLEST_CROWN:g} m²; "
        f"computed in {1000 * seconds:.0f} ms</p>{table}"
    )
