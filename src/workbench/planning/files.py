"""A mission from files, and as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas as gpd
import shapely
from rasterio.crs import CRS

from workbench.errors import PlanningError
from workbench.planning.export import litchi_table, mavlink_waypoints, qgroundcontrol_plan
from workbench.planning.mission import Mission, plan_mission
from workbench.planning.reached import reached
from workbench.rasters import Grid, read_raster
from workbench.vectors import read_vector, write_layers
from workbench.virtual.flight_cameras import FlightCamera

_WRITERS = {".plan": qgroundcontrol_plan, ".waypoints": mavlink_waypoints, ".litchi.csv": litchi_table}


def plan_files(
    area: Path | str,
    camera: FlightCamera,
    out: Path | str,
    *,
    surface: Path | str | None = None,
    **options: Any,
) -> Mission:
    """Plan the photographs of an area and write what ground stations read.

    Parameters
    ----------
    area
        Vector file of polygons, any CRS.
    camera
        See :func:`workbench.virtual.flight_cameras.flight_camera`.
    out
        Folder of the files: ``part_1.plan`` (QGroundControl), ``part_1.waypoints`` (MAVLink text),
        ``part_1.litchi.csv`` and so on, ``mission.gpkg`` with the layers ``area``, ``ways`` and
        ``photographs`` (what is reached at each).
    surface
        Raster of heights; its CRS is that of the mission. Without one, UTM and flat ground.
    options
        As :func:`workbench.planning.plan_mission`.

    Raises
    ------
    PlanningError
        As :func:`workbench.planning.plan_mission`, or if the file has no polygon.
    RasterError, VectorError
        If a file cannot be read.
    """
    frame = read_vector(area)
    relief = None if surface is None else read_raster(surface)
    crs = CRS.from_wkt(
        (frame.estimate_utm_crs() if frame.crs.is_geographic else frame.crs).to_wkt()
        if relief is None
        else Grid.of(relief).crs.to_wkt()
    )
    outline = shapely.union_all(frame.to_crs(crs).geometry.to_numpy())
    if outline.geom_type not in ("Polygon", "MultiPolygon"):
        raise PlanningError(f"{area}: holds no polygon but {outline.geom_type}: draw the area to fly.")
    mission = plan_mission(outline, crs, camera, surface=relief, **options)
    write_mission(mission, Path(out))
    return mission


def write_mission(mission: Mission, folder: Path) -> None:
    """Write the files of a mission into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, part in enumerate(mission.parts, 1):
        for suffix, text in _WRITERS.items():
            path = folder / f"part_{number}{suffix}"
            path.write_text(text(mission, part), encoding="utf-8")
    table = reached(mission)
    ways = [
        {"part": number, "line": leg.line + 1, "geometry": shapely.LineString(leg.way)}
        for number, part in enumerate(mission.parts, 1)
        for leg in part.legs
    ]
    write_layers(
        {
            "area": gpd.GeoDataFrame({"geometry": [mission.area]}, crs=mission.crs),
            "ways": gpd.GeoDataFrame(ways, crs=mission.crs),
            "photographs": gpd.GeoDataFrame(
                table, geometry=gpd.points_from_xy(table.x, table.y, table.z), crs=mission.crs
            ),
        },
        folder / "mission.gpkg",
    )
