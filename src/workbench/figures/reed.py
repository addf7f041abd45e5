"""Interactive panel of the reed metrics: thresholds beside orthophoto, heights, extent, density and front.

Rasters are brought to the screen's resolution once. A moved slider computes only the steps that depend
on it (:class:`workbench.reed.ReedModel`), and sends only the layers that changed.
"""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import panel as pn
import rasterio.features
import shapely
import xarray as xr
from bokeh.models import ColumnDataSource, HoverTool, LinearColorMapper
from bokeh.palettes import Viridis256
from bokeh.plotting import figure
from rasterio.transform import from_bounds

from workbench.errors import ReedError, WorkbenchError
from workbench.figures.controls import write_button
from workbench.params import ReedParameters
from workbench.rasters import Grid, read_raster
from workbench.reed import (
    Agreement,
    HeightAgreement,
    ReedMetrics,
    ReedModel,
    References,
    agreements,
    compare_heights,
    doubts,
    load_model,
    load_references,
)
from workbench.site import Site
from workbench.stages import FOLDERS

_LONGEST = 1200  # Pixels of the longer edge of a picture.
_MARGIN = 5.0  # Metres shown around one area.
_WIDE = 2.5  # Areas longer than this many times their width are shown below each other.
_SLIDERS: tuple[tuple[str, str, float, float, float], ...] = (
    ("min_height", "Minimum height b (m)", 0.0, 3.0, 0.05),
    ("max_height", "Maximum height c (m)", 1.0, 12.0, 0.1),
    ("variance_cut", "Variance cut (m²)", 0.0, 1.0, 0.01),
    ("mean_cut", "Mean height cut (m)", 0.0, 5.0, 0.05),
    ("arsi_cut", "aRSI cut", 3.0, 20.0, 0.1),
    ("cell_size", "Density cell (m)", 0.5, 3.0, 0.1),
)
_LEVEL = ("water_level", "Water level a (m)", 1.0, 0.01)  # Name, title, reach to both sides, step.
_WATER = "#dceaf5"
_EXTENT = ("#00000000", "#4c9a2a", "#bdbdbd")
_DENSITY = {"": "#00000000", "sparse": "#f2a93b", "dense": "#1f6d2c", "unknown": "#bdbdbd"}
_STATUS = {"healthy": "#2ca25f", "stressed": "#d7301f", "excluded": "#9e9e9e"}
_CLOSED = {"islet": "#fdae61", "hole": "#2b83ba"}


def reed_panel(
    source: Site | ReedModel,
    *,
    area: str | None = None,
    ortho: xr.DataArray | None = None,
    references: References | None = None,
    options: ReedParameters | None = None,
    parameters_file: Path | str | None = None,
) -> pn.Row:
    """Sliders for every threshold, and at once what they do to extent, density, front, status and scores.

    Parameters
    ----------
    source
        A site with a surface, or any surface as a :class:`workbench.reed.ReedModel`.
    area
        Show this area of interest only; by default all of the surface.
    ortho
        Orthophoto (band, y, x), uint8; of a site its own.
    references
        For the error matrices; of a site its own.
    options
        Where the sliders begin.
    parameters_file
        ``params.yaml`` that the button writes to; without it there is no button.

    Returns
    -------
    panel.Row
        For a notebook, or for an app: ``pn.serve(lambda: reed_panel(site))``.

    Raises
    ------
    ReedError
        If the site has no surface or water level, or there is no such area.
    """
    options = options or ReedParameters()
    if isinstance(source, Site):
        dsm_file = source.products / FOLDERS["surface"] / "dsm.tif"
        stamp = dsm_file.stat().st_mtime_ns if dsm_file.exists() else 0
        # The files are read once for all visitors; every visitor has a model, which keeps the last steps.
        loaded = pn.state.as_cached(f"reed {dsm_file} {stamp}", lambda: _load(source, options))
        model, ortho, references = (
            loaded[0],
            ortho if ortho is not None else loaded[1],
            references or loaded[2],
        )
    else:
        model = source
    model, ortho = _of_area(model, ortho, area)
    return _ReedPanel(model, ortho, _within(references or References(), area), options, parameters_file).view


class _ReedPanel:
    """Widgets, data of the pictures, and what connects them."""

    def __init__(
        self,
        model: ReedModel,
        ortho: xr.DataArray | None,
        references: References,
        options: ReedParameters,
        parameters_file: Path | str | None,
    ) -> None:
        self.model, self.references, self.options = model, references, options
        level = options.water_level if options.water_level is not None else model.water_level
        if level is None:
            raise ReedError("The water level is unknown: state water_level in site.yaml or params.yaml.")
        self.level = float(level)
        self.shown = _display_grid(model.grid)
        self.sources = {
            name: ColumnDataSource() for name in ("extent", "density", "boxes", "lines", "closed")
        }
        self.mapper = LinearColorMapper(palette=Viridis256, nan_color="#bdbdbd")
        self.scores = pn.pane.HTML("", width=330)
        self.message = pn.pane.Alert("", alert_type="danger", visible=False, width=330)
        self.doubts = pn.pane.Alert("", alert_type="warning", visible=False, width=330)
        self.sliders = _sliders(options, self.level, model.grid.resolution)
        for slider in self.sliders.values():
            slider.param.watch(self.update, "value_throttled")
        self.heights: HeightAgreement | None = None
        self.unknown = np.zeros(self.shown.shape, dtype=np.uint8)
        self.update()
        controls: list[Any] = [*self.sliders.values(), self.message, self.doubts]
        if parameters_file is not None:
            controls.append(write_button(parameters_file, self.values))
        pictures = self._pictures(ortho)
        bounds = _seen(model)
        wide = bounds[2] - bounds[0] > _WIDE * (bounds[3] - bounds[1])
        box = pn.Column(*pictures) if wide else pn.GridBox(*pictures, ncols=3)
        self.view = pn.Row(pn.Column(*controls, self.scores, width=340), box)

    def values(self) -> dict[str, Any]:
        """What the sliders stand at, by dotted path; the site's own water level is left to the site."""
        values: dict[str, Any] = {f"reed.{name}": slider.value for name, slider in self.sliders.items()}
        if self.options.water_level is None and values["reed.water_level"] == self.level:
            values["reed.water_level"] = None
        return values

    def update(self, *_: Any) -> None:
        """Measure with the thresholds of the sliders, and show what changed."""
        chosen = {name: slider.value for name, slider in self.sliders.items()}
        try:
            options = ReedParameters(**(self.options.model_dump() | chosen))
            metrics = self.model.measure(options)
        except (WorkbenchError, ValueError) as error:
            self.message.object, self.message.visible = _plain(error), True
            return
        computed = self.model.computed
        with pn.io.hold():
            self.message.visible = False
            if "ohm" in computed:
                self._rescale(options)
                self._doubt(metrics, options)
                if self.references.points is not None:
                    compared = compare_heights(
                        metrics.ohm, self.references.points, radius=options.point_radius
                    )
                    self.heights = HeightAgreement.of(compared.field_m, compared.surface_m)
            if "ground" in computed:
                self.unknown = _burnt(metrics.extent.unknown, self.shown)
            if "extent" in computed:
                classes = np.where(_burnt(metrics.extent.reed, self.shown), 1, 2 * self.unknown)
                self.sources["extent"].data = _image(classes.astype(np.uint8), self.shown)
            if "cells" in computed:
                self.sources["density"].data = _density_image(metrics)
            if "front" in computed:
                self.sources["lines"].data = _lines(metrics.front.lines)
                closed = metrics.front.closed
                self.sources["closed"].data = _polygons(closed[closed.kind != "unknown"], "kind", _CLOSED)
            if "sections" in computed:
                self.sources["boxes"].data = _boxes(metrics.sections)
            found = agreements(metrics, self.references, dense_stems=options.plot_dense_stems)
            self.scores.object = _scores(metrics, found, self.heights)

    def _doubt(self, metrics: ReedMetrics, options: ReedParameters) -> None:
        """Say whether surface, level and shoreline seem not to fit; they change with the level only."""
        found = doubts(metrics, options, shoreline=self.model.shoreline is not None)
        self.doubts.object, self.doubts.visible = "\n\n".join(found), bool(found)

    def _rescale(self, options: ReedParameters) -> None:
        """Another water level only shifts the colours of the heights, which are kept above the first one."""
        shift = (options.water_level if options.water_level is not None else self.level) - self.level
        self.mapper.update(low=shift, high=shift + 5.0)

    def _pictures(self, ortho: xr.DataArray | None) -> list[Any]:
        plots = _plots(_seen(self.model), _TITLES if ortho is not None else _TITLES[1:])
        ohm, extent, density, front = plots[-4:]
        if ortho is not None:
            picture = ColumnDataSource(_rgba_image(ortho))
            plots[0].image_rgba(source=picture, **_PLACE)
            front.image_rgba(source=picture, alpha=0.45, **_PLACE)
        heights = _reduced(self.model.dsm.values, self.model.grid, self.shown) - np.float32(self.level)
        ohm.image(source=ColumnDataSource(_image(heights, self.shown)), color_mapper=self.mapper, **_PLACE)
        extent.image(source=self.sources["extent"], color_mapper=_classes(_EXTENT), **_PLACE)
        colours = _classes(tuple(_DENSITY.values()))
        density.image(source=self.sources["density"], color_mapper=colours, **_PLACE)
        filled = {"xs": "xs", "ys": "ys", "fill_color": "colour"}
        boxes = front.patches(
            source=self.sources["boxes"], **filled, fill_alpha=0.45, line_color="colour", line_alpha=0.9
        )
        front.multi_polygons(source=self.sources["closed"], **filled, fill_alpha=0.9, line_color="black")
        front.multi_line("xs", "ys", source=self.sources["lines"], line_color="black", line_width=2)
        front.add_tools(HoverTool(renderers=[boxes], tooltips=_TOOLTIPS))
        legend = pn.pane.HTML(_LEGEND, width=front.frame_width)
        return [*(pn.pane.Bokeh(plot) for plot in plots), legend]


def _seen(model: ReedModel) -> tuple[float, float, float, float]:
    """West, south, east, north of the areas of interest and a margin; of the surface without areas."""
    if model.areas is None:
        return model.grid.bounds
    around = shapely.buffer(shapely.box(*model.areas.total_bounds), _MARGIN, join_style="mitre")
    return shapely.intersection(around, shapely.box(*model.grid.bounds)).bounds


def _plots(bounds: tuple[float, float, float, float], titles: tuple[str, ...]) -> list[Any]:
    """Empty pictures that move together."""
    west, south, east, north = bounds
    width = 1000 if east - west > _WIDE * (north - south) else 380
    height = int(np.clip(width * (north - south) / (east - west), 90, 800))
    settings: dict[str, Any] = {
        "frame_width": width,
        "frame_height": height,
        "x_range": (west, east),
        "y_range": (south, north),
        "tools": "pan,wheel_zoom,box_zoom,reset,save",
        "active_scroll": "wheel_zoom",
        "match_aspect": True,
        "toolbar_location": "right",
        "background_fill_color": _WATER,
    }
    plots: list[Any] = []
    for title in titles:
        plot = figure(title=title, name=title.split()[0].lower(), **settings)
        settings |= {"x_range": plot.x_range, "y_range": plot.y_range, "toolbar_location": None}
        plot.axis.visible = False
        plot.grid.visible = False
        plots.append(plot)
    return plots


_TITLES = ("Orthophoto", "Height above the water (0 to 5 m)", "Extent", "Density", "Front and status")
_PLACE: dict[str, Any] = {"x": "x", "y": "y", "dw": "dw", "dh": "dh", "image": "image"}
_TOOLTIPS = [
    ("area, section", "@aoi, @section"),
    ("sinuosity", "@sinuosity{0.00}"),
    ("islets, holes", "@islets, @holes"),
    ("aRSI", "@arsi{0.00}"),
    ("status", "@status @reason"),
]
_LEGEND = "".join(
    f"<div><b>{title}:</b> "
    + ", ".join(
        f'<span style="color:{colour}">&#9632;</span> {name}' for name, colour in classes.items() if name
    )
    + "</div>"
    for title, classes in (
        ("Extent", dict(zip(("", "reed", "unknown"), _EXTENT, strict=True))),
        ("Density", _DENSITY),
        ("Status", _STATUS),
        ("Closed lines", _CLOSED),
    )
)


def _sliders(options: ReedParameters, level: float, pixel: float) -> dict[str, Any]:
    name, title, reach, step = _LEVEL
    rows = [(name, title, level - reach, level + reach, step, level)]
    for name, title, start, end, step in _SLIDERS:
        value = getattr(options, name)
        lowest = max(start, step * np.ceil(pixel / step)) if name == "cell_size" else start
        rows.append((name, title, min(lowest, value), max(end, value), step, value))
    return {
        name: pn.widgets.FloatSlider(name=title, start=start, end=end, step=step, value=value, width=320)
        for name, title, start, end, step, value in rows
    }


def _load(site: Site, options: ReedParameters) -> tuple[ReedModel, xr.DataArray | None, References]:
    file = site.products / FOLDERS["mosaic"] / "ortho.tif"
    return (
        load_model(site, options),
        read_raster(file) if file.exists() else None,
        load_references(site),
    )


def _of_area(
    model: ReedModel, ortho: xr.DataArray | None, area: str | None
) -> tuple[ReedModel, xr.DataArray | None]:
    """A model of its own for every panel, of the whole surface or of one area and a margin."""
    areas, transects, dsm, spread = model.areas, model.transects, model.dsm, model.spread
    if area is not None:
        if areas is None or area not in set(areas.aoi):
            known = "none" if areas is None else ", ".join(areas.aoi)
            raise ReedError(f"There is no area {area}: the areas are {known}.")
        areas = areas[areas.aoi == area]
        transects = None if transects is None else transects[transects.aoi == area]
        bounds = shapely.buffer(shapely.box(*areas.total_bounds), _MARGIN, join_style="mitre").bounds
        dsm = _clipped(dsm, bounds)
        spread = None if spread is None else _clipped(spread, bounds)
        ortho = None if ortho is None else _clipped(ortho, bounds)
    part = ReedModel(dsm, model.water_level, model.shoreline, areas=areas, transects=transects, spread=spread)
    return part, ortho


def _clipped(raster: xr.DataArray, bounds: tuple[float, float, float, float]) -> xr.DataArray:
    west, south, east, north = bounds
    x = (raster.x >= west) & (raster.x <= east)
    y = (raster.y >= south) & (raster.y <= north)
    part = raster.isel(x=np.flatnonzero(x.values), y=np.flatnonzero(y.values))
    # What belonged to the whole raster is worked out again from the coordinates.
    return part.rio.write_transform(part.rio.transform(recalc=True))


def _within(references: References, area: str | None) -> References:
    if area is None:
        return references
    tables = (references.points, references.plots, references.status)
    return References(*(None if t is None else t[t.aoi.astype(str) == area] for t in tables))


def _display_grid(grid: Grid) -> Grid:
    """Cells of the pictures: those of the surface, or fewer."""
    step = max(1, int(np.ceil(max(grid.shape) / _LONGEST)))
    return Grid(
        grid.crs,
        grid.west,
        grid.north,
        grid.resolution * step,
        -(-grid.width // step),
        -(-grid.height // step),
    )


def _reduced(values: np.ndarray, grid: Grid, shown: Grid) -> np.ndarray:
    """The middle cell of every block, so that a picture of gaps has gaps."""
    step = round(shown.resolution / grid.resolution)
    rows = np.minimum(np.arange(shown.height) * step + step // 2, grid.height - 1)
    columns = np.minimum(np.arange(shown.width) * step + step // 2, grid.width - 1)
    return values[..., rows[:, None], columns[None, :]]


def _image(values: np.ndarray, grid: Grid) -> dict[str, Any]:
    west, south, east, north = grid.bounds
    return {
        "image": [np.ascontiguousarray(values[::-1])],
        "x": [west],
        "y": [south],
        "dw": [east - west],
        "dh": [north - south],
    }


def _rgba_image(ortho: xr.DataArray) -> dict[str, Any]:
    """Red, green and blue; where all are 0 there is no photograph."""
    transform = ortho.rio.transform(recalc=True)
    grid = Grid(ortho.rio.crs, transform.c, transform.f, transform.a, ortho.sizes["x"], ortho.sizes["y"])
    shown = _display_grid(grid)
    bands = _reduced(ortho.values[:3], grid, shown).astype(np.uint8)
    rgba = np.empty((*bands.shape[1:], 4), dtype=np.uint8)
    rgba[..., :3] = np.moveaxis(bands, 0, -1)
    rgba[..., 3] = np.where((bands == 0).all(axis=0), 0, 255)
    return _image(rgba.view(np.uint32).reshape(rgba.shape[:2]), shown)


def _burnt(shape: shapely.Geometry, shown: Grid) -> np.ndarray:
    """1 in the cells of the picture whose middle lies in a shape, 0 elsewhere."""
    if shape.is_empty:
        return np.zeros(shown.shape, dtype=np.uint8)
    west, south, east, north = shown.bounds
    transform = from_bounds(west, south, east, north, shown.width, shown.height)
    return rasterio.features.rasterize([shape], out_shape=shown.shape, transform=transform, dtype="uint8")


def _density_image(metrics: ReedMetrics) -> dict[str, Any]:
    """Classes on the grid of the density cells itself."""
    codes = {name: code for code, name in enumerate(_DENSITY)}
    grid, cells = metrics.statistics.grid, metrics.cells
    values = np.zeros(grid.shape, dtype=np.uint8)
    values[cells.row.to_numpy(), cells.column.to_numpy()] = cells.density.map(codes).to_numpy(dtype=np.uint8)
    return _image(values, grid)


def _lines(lines: gpd.GeoDataFrame) -> dict[str, Any]:
    coordinates = [shapely.get_coordinates(line) for line in lines.geometry]
    return {"xs": [c[:, 0] for c in coordinates], "ys": [c[:, 1] for c in coordinates]}


def _boxes(sections: gpd.GeoDataFrame) -> dict[str, Any]:
    data: dict[str, Any] = {
        name: sections[name].to_list()
        for name in ("aoi", "section", "sinuosity", "islets", "holes", "arsi", "status", "reason")
    }
    rings = [shapely.get_coordinates(shape.convex_hull) for shape in sections.geometry]
    data |= {"xs": [ring[:, 0] for ring in rings], "ys": [ring[:, 1] for ring in rings]}
    return data | {"colour": [_STATUS[status] for status in sections.status]}


def _polygons(frame: gpd.GeoDataFrame, column: str, colours: dict[str, str]) -> dict[str, Any]:
    rings = [shapely.get_coordinates(shape.exterior) for shape in frame.geometry]
    return {
        "xs": [[[ring[:, 0]]] for ring in rings],
        "ys": [[[ring[:, 1]]] for ring in rings],
        "colour": [colours[kind] for kind in frame[column]],
    }


def _classes(colours: tuple[str, ...]) -> LinearColorMapper:
    return LinearColorMapper(palette=list(colours), low=-0.5, high=len(colours) - 0.5)


def _scores(metrics: ReedMetrics, found: dict[str, Agreement], heights: HeightAgreement | None) -> str:
    totals = metrics.totals()
    lines = [
        f"<b>Reed</b> {totals['extent_m2']:.0f} m²: dense {totals['dense_m2']:.0f}, "
        f"sparse {totals['sparse_m2']:.0f}, unknown {totals['unknown_density_m2']:.0f} m²",
        f"<b>Front</b> {totals['front_m']:.0f} m, {totals['islets']} islets, {totals['holes']} holes",
        f"<b>Sections</b> {totals['healthy']} healthy, {totals['stressed']} stressed, "
        f"{totals['excluded']} excluded",
    ]
    if heights is not None and heights.n:
        lines.append(
            f"<b>Heights</b> n {heights.n}, RMSE {heights.rmse:.2f} m, bias {heights.bias:+.2f} m, "
            f"R² {heights.r2:.2f}"
        )
    text = "".join(f"<div>{line}</div>" for line in lines)
    return text + "".join(_matrix(name, agreement) for name, agreement in found.items())


def _matrix(name: str, agreement: Agreement) -> str:
    """An error matrix as a small table: rows classified, columns reference."""
    matrix = agreement.matrix
    if not matrix.counts.sum():
        return f"<div><b>{name}</b>: nothing to compare</div>"
    head = "".join(f"<th>{html.escape(c)}</th>" for c in matrix.classes)
    rows = "".join(
        f"<tr><th>{html.escape(c)}</th>" + "".join(f"<td>{int(v)}</td>" for v in row) + "</tr>"
        for c, row in zip(matrix.classes, matrix.counts, strict=True)
    )
    left_out = f", {agreement.left_out} left out" if agreement.left_out else ""
    return (
        f'<table style="margin-top:8px;text-align:right" class="matrix-{name}"><caption><b>{name}</b> '
        f"{100 * matrix.overall_accuracy:.1f} %, kappa {matrix.kappa:.2f}{left_out}</caption>"
        f"<tr><th></th>{head}</tr>{rows}</table>"
    )


def _plain(error: Exception) -> str:
    """First sentence of what is wrong, without the frame that pydantic puts around it."""
    return str(error).split("Value error, ")[-1].split(" [type=")[0]
