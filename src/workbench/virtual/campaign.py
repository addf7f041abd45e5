"""The reed field campaign of a scene: transects, points, plots, and the status of sections [reed 2.4]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from shapely.geometry import LineString, Polygon

from workbench.params import SimulateParameters
from workbench.virtual.composition import ReedSpec
from workbench.virtual.particles import stem_table
from workbench.virtual.scene import Scene

_DEFAULTS = SimulateParameters()
_BEYOND_FRONT = 6.0  # Metres of open water at the outer end of a transect.
_REACH = 0.5  # A stem within this distance of a point is measured, m.
_INLAND = 12.0  # Depth of an area of interest behind the shoreline, m.
_FRAYED = 1.6  # Sinuosity above which the eye calls a front frayed.
_OUTER, _INNER = 0.15, 0.7  # Places of the two plots, as shares of the reed from the front to the shore.

POINT_COLUMNS = ["aoi", "transect", "point", "x", "y", "stem_height_m", "water_depth_m", "n_stems"]
PLOT_COLUMNS = ["aoi", "transect", "plot", "x", "y", "stems_per_m2", "green", "dead", "zone"]


@dataclass(frozen=True, eq=False)
class ReedCampaign:
    """What was recorded in the field, and beside it the truth of sections."""

    areas: gpd.GeoDataFrame
    """Areas of interest: ``aoi``, polygons."""
    transects: gpd.GeoDataFrame
    """Recorded lines from the water to the shore: ``aoi``, ``transect``."""
    points: pd.DataFrame
    """``POINT_COLUMNS``: recorded place; height of the stem from its foot to its top and water depth, m;
    stems within half a metre; without any the height is NaN."""
    plots: pd.DataFrame
    """``PLOT_COLUMNS``: recorded middle of a square metre, its stems, green and dead ones."""
    status: gpd.GeoDataFrame
    """Visual interpretation between neighbouring transects: ``aoi``, ``section``, ``status``."""
    true_transects: gpd.GeoDataFrame
    """Transects where they really were."""
    true_sections: gpd.GeoDataFrame
    """``aoi``, ``section``, ``sinuosity`` (NaN without front), ``islets``, ``holes``, ``status``."""


def survey_reed(
    scene: Scene,
    *,
    rng: np.random.Generator,
    line_length: float = _DEFAULTS.line_length,
    transect_spacing: float = _DEFAULTS.transect_spacing,
    point_spacing: float = _DEFAULTS.point_spacing,
    height_reading: float = _DEFAULTS.height_reading,
    gnss_error: float = _DEFAULTS.field_gnss_error,
) -> ReedCampaign:
    """Survey every reed belt of a scene.

    A line is laid along the shore of each belt, and from it transects at right angles, walked from the
    water to the shore. Heights and depths are read to ``height_reading``. The receiver's error is common
    to one transect, whose points are taped off within minutes: it moves recorded positions, not what
    was measured there.

    Parameters
    ----------
    scene
        With reed; without it all tables are empty.
    rng
        Source of the errors.
    line_length, transect_spacing, point_spacing
        Design, m; the line is as long as the belt where that is shorter.
    height_reading
        Graduation of the rule, m.
    gnss_error
        Horizontal root mean square error of recorded positions, m.
    """
    rows: dict[str, list] = {key: [] for key in ("areas", "lines", "true", "points", "plots", "sections")}
    for belt in scene.spec.reed:
        walks = _lay_out(scene, belt, line_length, transect_spacing)
        if not walks:
            continue
        stems = _Stems(scene, walks)
        rows["areas"].append({"aoi": belt.aoi, "geometry": _area(walks, scene)})
        for number, walk in enumerate(walks, start=1):
            shift = rng.normal(0, gnss_error / math.sqrt(2), 2)
            key = {"aoi": belt.aoi, "transect": number}
            rows["true"].append({**key, "geometry": LineString(walk)})
            rows["lines"].append({**key, "geometry": LineString(walk + shift)})
            measured = _measure(scene, stems, walk, point_spacing, height_reading)
            rows["points"] += [{**key, **row, **_moved(row, shift)} for row in measured]
            rows["plots"] += [{**key, **row, **_moved(row, shift)} for row in _plots(stems, measured)]
        rows["sections"] += _sections(scene, belt.aoi, walks)
    sections = _frame(rows["sections"], ["aoi", "section", "sinuosity", "islets", "holes", "status"], scene)
    return ReedCampaign(
        _frame(rows["areas"], ["aoi"], scene),
        _frame(rows["lines"], ["aoi", "transect"], scene),
        pd.DataFrame(rows["points"], columns=POINT_COLUMNS),
        pd.DataFrame(rows["plots"], columns=PLOT_COLUMNS),
        sections[["aoi", "section", "status", "geometry"]],
        _frame(rows["true"], ["aoi", "transect"], scene),
        sections,
    )


def _lay_out(scene: Scene, belt: ReedSpec, line_length: float, spacing: float) -> list[np.ndarray]:
    """Transects (2, 2) from the water to the shore, CRS."""
    if scene.spec.lake is None or scene.shoreline is None:
        return []
    offset = scene.origin[:2]
    outline = Polygon(scene.spec.lake.outline)
    ring = LineString(outline.exterior.coords)
    length = min(line_length, belt.along[1] - belt.along[0])
    start = (belt.along[0] + belt.along[1] - length) / 2
    ends = np.array([ring.interpolate(place).coords[0] for place in (start, start + length)])
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    out = np.array([-along[1], along[0]])
    if not outline.contains(shapely.Point(ends.mean(axis=0) + 5 * out)):
        out = -out
    reach = belt.width * (1 + 0.5 * belt.fray) + _BEYOND_FRONT
    walks = []
    for index in range(int(length / spacing + 1e-9) + 1):
        foot = ends[0] + index * spacing * along + offset
        walk = _walk(scene, foot, out, reach)
        if walk is not None:
            walks.append(walk)
    return walks


def _walk(scene: Scene, foot: np.ndarray, out: np.ndarray, reach: float) -> np.ndarray | None:
    """From the water to the shoreline (2, 2); None where the line does not meet the water in the scene."""
    line = LineString([foot + 3 * reach * out, foot - reach * out])
    wet = line.intersection(scene.shoreline)
    parts = [part for part in getattr(wet, "geoms", [wet]) if part.length > 1]
    if not parts:
        return None
    ends = np.array(max(parts, key=lambda part: part.length).coords)
    shore = ends[np.argmin(ends @ out)]
    length = min(reach, float(np.ptp(ends @ out)))
    return np.array([shore + length * out, shore])


class _Stems:
    """All stems near the transects of a belt."""

    def __init__(self, scene: Scene, walks: list[np.ndarray]) -> None:
        places = np.concatenate(walks) - scene.origin[:2]
        west, south = places.min(axis=0) - 2
        east, north = places.max(axis=0) + 2
        table = stem_table(scene.reed.fields, (west, south, east, north))
        self.places = table[:, :2] + scene.origin[:2]
        self.tall = table[:, 3]
        self.green = table[:, 4] > 0
        self.tree = cKDTree(self.places) if len(table) else None

    def near(self, place: np.ndarray) -> np.ndarray:
        """Indices of the stems within reach, nearest first."""
        if self.tree is None:
            return np.zeros(0, dtype=int)
        found = np.array(self.tree.query_ball_point(place, _REACH), dtype=int)
        return found[np.argsort(np.hypot(*(self.places[found] - place).T), kind="stable")]

    def count(self, place: np.ndarray) -> tuple[int, int]:
        """Stems and green stems in the square metre around a place."""
        inside = np.all(np.abs(self.places - place) <= 0.5, axis=1)
        return int(inside.sum()), int((inside & self.green).sum())


def _measure(
    scene: Scene, stems: _Stems, walk: np.ndarray, spacing: float, reading: float
) -> list[dict[str, float]]:
    length = float(np.linalg.norm(walk[1] - walk[0]))
    steps = np.arange(0, length + 1e-6, spacing) / length
    places = walk[0] + steps[:, None] * (walk[1] - walk[0])
    level = scene.water_level if scene.water_level is not None else -np.inf
    depths = np.maximum(level - scene.ground_z(places[:, 0], places[:, 1]), 0)
    rows = []
    for number, (place, depth) in enumerate(zip(places, depths, strict=True), start=1):
        near = stems.near(place)
        height = stems.tall[near[0]] + depth if len(near) else np.nan
        rows.append(
            {
                "point": number,
                "x": place[0],
                "y": place[1],
                "stem_height_m": round(round(height / reading) * reading, 4) if len(near) else np.nan,
                "water_depth_m": round(round(depth / reading) * reading, 4),
                "n_stems": len(near),
            }
        )
    return rows


def _plots(stems: _Stems, measured: list[dict[str, float]]) -> list[dict[str, object]]:
    """One plot in the outer, sparse zone and one in the inner, dense zone of the reed."""
    reed = [row for row in measured if row["n_stems"] > 0]
    rows: list[dict[str, object]] = []
    for number, (zone, share) in enumerate((("outer", _OUTER), ("inner", _INNER)), start=1):
        if len(reed) < 2:
            return []
        row = reed[round(share * (len(reed) - 1))]
        count, green = stems.count(np.array([row["x"], row["y"]]))
        rows.append(
            {
                "plot": number,
                "x": row["x"],
                "y": row["y"],
                "stems_per_m2": count,
                "green": green,
                "dead": count - green,
                "zone": zone,
            }
        )
    return rows


def _moved(row: dict, shift: np.ndarray) -> dict[str, float]:
    return {"x": round(row["x"] + shift[0], 3), "y": round(row["y"] + shift[1], 3)}


def _area(walks: list[np.ndarray], scene: Scene) -> Polygon:
    inland = [walk[1] + _INLAND * (walk[1] - walk[0]) / np.linalg.norm(walk[1] - walk[0]) for walk in walks]
    ring = [walk[0] for walk in walks] + inland[::-1]
    area = Polygon(ring) if len(walks) > 1 else LineString([walks[0][0], inland[0]]).buffer(5.0)
    return area.intersection(shapely.box(*scene.extent))


def _sections(scene: Scene, aoi: str, walks: list[np.ndarray]) -> list[dict[str, object]]:
    """Between neighbouring transects: what a front, its islets and its holes look like."""
    reed = scene.reed
    front = shapely.union_all(list(reed.front.geometry[reed.front.aoi == aoi]))
    rows = []
    for number, (first, second) in enumerate(pairwise(walks), start=1):
        box = Polygon([first[0], second[0], second[1], first[1]])
        islets, holes = (
            int(frame[frame.aoi == aoi].representative_point().within(box).sum())
            for frame in (reed.islets, reed.holes)
        )
        sinuosity = _sinuosity(front.intersection(box))
        stressed = islets + holes > 0 or not sinuosity <= _FRAYED
        rows.append(
            {
                "aoi": aoi,
                "section": number,
                "sinuosity": sinuosity,
                "islets": islets,
                "holes": holes,
                "status": "stressed" if stressed else "healthy",
                "geometry": box,
            }
        )
    return rows


def _sinuosity(front: shapely.Geometry) -> float:
    """Length of the front over the straight distance of its ends; NaN without a front."""
    pieces = shapely.get_parts(shapely.line_merge(front))
    ends = [shapely.distance(shapely.get_point(piece, 0), shapely.get_point(piece, -1)) for piece in pieces]
    return float(shapely.length(pieces).sum() / sum(ends)) if sum(ends) > 0 else math.nan


def _frame(rows: list[dict], columns: list[str], scene: Scene) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(rows, columns=[*columns, "geometry"], geometry="geometry", crs=scene.spec.crs)
