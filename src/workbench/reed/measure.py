"""All metrics of aquatic reed from one surface, each step computed again only if its parameters changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
import xarray as xr
from shapely.geometry.base import BaseGeometry

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import Grid
from workbench.reed.density import CellStatistics, cell_statistics, classify_cells, reed_area
from workbench.reed.extent import ReedExtent, Shoreline, map_extent, stand_height, survey_ground
from workbench.reed.front import Front, trace_front
from workbench.reed.heights import known_heights, object_height
from workbench.reed.status import EXCLUDED, HEALTHY, STRESSED, assess_sections
from workbench.reed.transects import lay_transects, strips

T = TypeVar("T")
WHOLE = "shore"
"""Name of the area where a site has none: the whole lakeshore."""


@dataclass(frozen=True, eq=False)
class ReedMetrics:
    """Everything that is measured on a surface."""

    ohm: xr.DataArray
    """Heights above the water, m."""
    extent: ReedExtent
    """Reed and unknown ground of the whole lake side."""
    areas: gpd.GeoDataFrame
    """One row an area of interest: ``aoi``, ``extent_m2``, ``dense_m2``, ``sparse_m2``,
    ``unknown_density_m2`` (reed), ``unknown_m2`` (lake without heights), and the reed in it."""
    cells: gpd.GeoDataFrame
    """Density cells with reed, and the ``aoi`` that holds their middle ('' outside of all)."""
    statistics: CellStatistics
    """Mean and variance of all cells."""
    front: Front
    """Open and closed lines."""
    sections: gpd.GeoDataFrame
    """Sections with metrics, index and status."""

    def totals(self) -> dict[str, Any]:
        """Sums over all areas, as numbers."""
        status = self.sections.status
        numbers = {
            f"{name}_m2": float(self.areas[f"{name}_m2"].sum())
            for name in ("extent", "dense", "sparse", "unknown_density", "unknown")
        }
        front = self.sections.front_m.sum() if len(self.sections) else self.front.lines.length_m.sum()
        return numbers | {
            "front_m": float(front),
            "islets": int((self.front.closed.kind == "islet").sum()),
            "holes": int((self.front.closed.kind == "hole").sum()),
            "sections": len(self.sections),
            HEALTHY: int((status == HEALTHY).sum()),
            STRESSED: int((status == STRESSED).sum()),
            EXCLUDED: int((status == EXCLUDED).sum()),
        }


class ReedModel:
    """A surface with its water level and shoreline, measured as often as parameters change.

    Works on any surface, also one that was not made here. Steps whose parameters are those of the last
    call are not computed again.

    Parameters
    ----------
    dsm
        Surface heights (y, x), m, with CRS and vertical datum; NaN where unknown.
    water_level
        m in that datum; a parameter ``water_level`` goes first.
    shoreline
        Polygon of the lake side; None: all of the raster is lake.
    areas
        Areas of interest, polygons with ``aoi``; None: the whole lakeshore.
    transects
        Lines with ``aoi`` and ``transect``; None: sections of equal length along the smoothed shore.
    spread
        Standard deviation of the measured heights in every pixel of the surface, m, for the variance of
        cells; None: it is that of the surface alone.

    Raises
    ------
    ReedError
        If the surface is not in metres, there is no water level, or areas or transects have no CRS or lack
        columns.
    """

    def __init__(
        self,
        dsm: xr.DataArray,
        water_level: float | None,
        shoreline: Shoreline | None = None,
        *,
        areas: gpd.GeoDataFrame | None = None,
        transects: gpd.GeoDataFrame | None = None,
        spread: xr.DataArray | None = None,
    ) -> None:
        self.dsm = known_heights(dsm)
        self.spread = spread
        self.grid = Grid.of(self.dsm)
        self.water_level = water_level
        self.shoreline = shoreline
        self.areas = None if areas is None else _in_grid(areas, self.grid, "areas of interest", "aoi")
        self.transects = (
            None if transects is None else _in_grid(transects, self.grid, "transects", "transect")
        )
        self._steps: dict[str, tuple[Any, Any]] = {}
        self.computed: tuple[str, ...] = ()
        """Names of the steps that the last call of :meth:`measure` computed."""

    def measure(self, options: ReedParameters | None = None) -> ReedMetrics:
        """Every metric with these thresholds.

        Raises
        ------
        ReedError
            If water level, thresholds, shoreline or transects are impossible.
        """
        o = options or ReedParameters()
        level = o.water_level if o.water_level is not None else self.water_level
        if level is None:
            raise ReedError("The water level is unknown: state water_level in site.yaml or params.yaml.")
        self.computed = ()
        ohm = self._step("ohm", level, lambda: object_height(self.dsm, level))
        for_stand = (level, o.edge_share > 0, o.edge_reach, o.max_height)
        for_extent = (for_stand, o.edge_share, o.min_height, o.min_area, o.min_hole, o.sliver_width)
        ground = self._step("ground", (), lambda: survey_ground(ohm, self.shoreline))
        stand = None
        if o.edge_share > 0:
            stand = self._step("stand", for_stand, lambda: stand_height(ohm, o.edge_reach, o.max_height))
        extent = self._step(
            "extent",
            for_extent,
            lambda: map_extent(
                ohm,
                self.shoreline,
                min_height=o.min_height,
                max_height=o.max_height,
                min_area=o.min_area,
                min_hole=o.min_hole,
                sliver_width=o.sliver_width,
                edge_share=o.edge_share,
                stand=stand,
                ground=ground,
            ),
        )
        spread = self.spread if o.cell_spread else None
        for_cells = (level, o.cell_size, o.cell_weights, o.cell_variance, spread is not None)
        statistics = self._step(
            "statistics",
            for_cells,
            lambda: cell_statistics(
                ohm,
                spread=spread,
                cell_size=o.cell_size,
                weights=o.cell_weights,
                variance=o.cell_variance,
            ),
        )
        area = self._step(
            "reed_area",
            (for_extent, o.cell_size),
            lambda: reed_area(self.grid, extent.reed, statistics.grid),
        )
        for_density = (for_extent, for_cells, o.variance_cut, o.mean_cut, o.cell_known)
        cells = self._step("cells", for_density, lambda: self._cells(statistics, area, o))
        for_front = (for_extent, o.shore_tolerance, o.front_smoothing, o.front_piece)
        front = self._step(
            "front",
            for_front,
            lambda: trace_front(
                extent,
                shore_tolerance=o.shore_tolerance,
                smoothing=o.front_smoothing,
                shortest=o.front_piece,
                min_hole=o.min_hole,
            ),
        )
        for_strips = (o.section_length, o.transect_length, o.shore_smoothing, o.box_buffer)
        lanes = self._step("strips", for_strips, lambda: self._strips(extent, o))
        sections = self._step(
            "sections",
            (for_density, for_front, for_strips, o.arsi_cut),
            lambda: assess_sections(
                lanes,
                front,
                cells,
                extent.unknown,
                box_buffer=o.box_buffer,
                shortest=o.front_piece,
                cut=o.arsi_cut,
            ),
        )
        unknown = self._step("unknown", (), lambda: self._unknown(extent))
        areas = self._step("areas", (for_extent, for_density), lambda: self._areas(extent, cells, unknown))
        return ReedMetrics(ohm, extent, areas, cells, statistics, front, sections)

    def _step(self, name: str, key: Any, compute: Callable[[], T]) -> T:
        known = self._steps.get(name)
        if known is not None and known[0] == key:
            return known[1]
        value = compute()
        self._steps[name] = (key, value)
        self.computed = (*self.computed, name)
        return value

    def _cells(self, statistics: CellStatistics, area: np.ndarray, o: ReedParameters) -> gpd.GeoDataFrame:
        cells = classify_cells(
            statistics, area, variance=o.variance_cut, mean_height=o.mean_cut, min_known=o.cell_known
        )
        if self.areas is None:
            return cells.assign(aoi=WHOLE)
        names = np.full(len(cells), "", dtype=object)
        x, y = (cells.geometry.bounds[[f"min{a}", f"max{a}"]].mean(axis=1).to_numpy() for a in "xy")
        for aoi, shape in zip(self.areas.aoi, self.areas.geometry, strict=True):
            shapely.prepare(shape)
            names[shapely.contains_xy(shape, x, y)] = aoi
        return cells.assign(aoi=names)

    def _strips(self, extent: ReedExtent, o: ReedParameters) -> gpd.GeoDataFrame:
        if self.transects is not None:
            return strips(self.transects, extent.shore, beyond=o.box_buffer)
        return strips(self._laid(extent, o), extent.shore, beyond=o.box_buffer, may_cross=True)

    def _laid(self, extent: ReedExtent, o: ReedParameters) -> gpd.GeoDataFrame:
        places = [(WHOLE, extent.shore)]
        if self.areas is not None:
            places = [
                (aoi, shapely.intersection(extent.shore, shape))
                for aoi, shape in zip(self.areas.aoi, self.areas.geometry, strict=True)
            ]
        parts = [
            lay_transects(
                shore,
                extent.lake,
                self.grid.crs,
                spacing=o.section_length,
                length=o.transect_length,
                smoothing=o.shore_smoothing,
                aoi=aoi,
            )
            for aoi, shore in places
        ]
        return gpd.GeoDataFrame(pd.concat(parts, ignore_index=True), geometry="geometry", crs=self.grid.crs)

    def _places(self, extent: ReedExtent) -> list[tuple[str, BaseGeometry]]:
        if self.areas is None:
            return [(WHOLE, extent.lake)]
        return list(zip(self.areas.aoi, self.areas.geometry, strict=True))

    def _unknown(self, extent: ReedExtent) -> list[float]:
        """Area without heights in every area of interest, m²."""
        if self.areas is None:
            return [extent.unknown.area]
        return [shapely.intersection(extent.unknown, shape).area for shape in self.areas.geometry]

    def _areas(self, extent: ReedExtent, cells: gpd.GeoDataFrame, unknown: list[float]) -> gpd.GeoDataFrame:
        rows = []
        for (aoi, shape), dark in zip(self._places(extent), unknown, strict=True):
            reed = extent.reed if self.areas is None else shapely.intersection(extent.reed, shape)
            inside = cells[cells.aoi == aoi]
            by_class = inside.groupby("density").reed_m2.sum()
            rows.append(
                {
                    "aoi": aoi,
                    "extent_m2": reed.area,
                    "dense_m2": float(by_class.get("dense", 0.0)),
                    "sparse_m2": float(by_class.get("sparse", 0.0)),
                    "unknown_density_m2": float(by_class.get("unknown", 0.0)),
                    "unknown_m2": dark,
                    "geometry": reed,
                }
            )
        return gpd.GeoDataFrame(rows, geometry="geometry", crs=self.grid.crs)


def measure_reed(
    dsm: xr.DataArray,
    water_level: float | None,
    shoreline: Shoreline | None = None,
    *,
    areas: gpd.GeoDataFrame | None = None,
    transects: gpd.GeoDataFrame | None = None,
    spread: xr.DataArray | None = None,
    options: ReedParameters | None = None,
) -> ReedMetrics:
    """Measure a surface once; see :class:`ReedModel`."""
    model = ReedModel(dsm, water_level, shoreline, areas=areas, transects=transects, spread=spread)
    return model.measure(options)


def _in_grid(frame: gpd.GeoDataFrame, grid: Grid, what: str, column: str) -> gpd.GeoDataFrame:
    if frame.crs is None:
        raise ReedError(f"The {what} have no CRS: set it, for example with .set_crs().")
    if column not in frame.columns or "aoi" not in frame.columns:
        lacking = " and ".join(name for name in dict.fromkeys(["aoi", column]) if name not in frame.columns)
        raise ReedError(f"The {what} lack the column {lacking}: add it in QGIS, for example.")
    moved = frame.to_crs(grid.crs).assign(aoi=frame.aoi.astype(str))
    if not shapely.intersects(shapely.box(*grid.bounds), moved.geometry.to_numpy()).any():
        raise ReedError(f"The {what} do not touch the surface: is their CRS {frame.crs} the right one?")
    return moved
