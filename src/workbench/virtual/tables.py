"""Truth of a scene as tables: trees, buildings, targets, the shoreline."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import shapely
from shapely.geometry import Polygon
from skimage.measure import find_contours

from workbench.virtual.canopy import sink_feet
from workbench.virtual.composition import SceneSpec
from workbench.virtual.forest import Crown, Stem, breast_height_diameter
from workbench.virtual.world import Terrain


def tree_table(
    stems: list[Stem],
    crowns: list[Crown],
    feet: np.ndarray,
    visible: np.ndarray,
    origin: np.ndarray,
    crs: str,
) -> gpd.GeoDataFrame:
    """One row a tree, coordinates in the CRS."""
    rows = []
    for index, (stem, crown) in enumerate(zip(stems, crowns, strict=True)):
        x, y, ground = stem.x + origin[0], stem.y + origin[1], float(feet[index]) + origin[2]
        rows.append(
            {
                "tree_id": index + 1,
                "species_group": stem.species_group,
                "x": x,
                "y": y,
                "ground_z": ground,
                "top_x": x + crown.top[0],
                "top_y": y + crown.top[1],
                "top_z": ground + stem.height,
                "height_m": stem.height,
                "dbh_m": breast_height_diameter(stem),
                "visible": bool(visible[index]),
                "dead": stem.dead,
                "understorey": stem.understorey,
                "geometry": Polygon(crown.outline + (x, y)),
            }
        )
    columns = ["tree_id", "species_group", "x", "y", "ground_z", "top_x", "top_y", "top_z", "height_m"]
    columns += ["dbh_m", "visible", "dead", "understorey", "geometry"]
    return gpd.GeoDataFrame(rows, columns=columns, geometry="geometry", crs=crs)


def building_table(spec: SceneSpec, terrain: Terrain, origin: np.ndarray) -> gpd.GeoDataFrame:
    """Footprints of walls with heights."""
    rows = []
    for b in spec.buildings:
        a = np.radians(b.azimuth)
        along, across = np.array([np.sin(a), np.cos(a)]), np.array([-np.cos(a), np.sin(a)])
        middle = np.array([b.x, b.y]) + origin[:2]
        signs = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        ring = [middle + i * b.length / 2 * along + j * b.width / 2 * across for i, j in signs]
        ground = float(sink_feet(terrain, [(b.x, b.y)])[0]) + origin[2]
        rows.append(
            {
                "ground_z": ground,
                "eaves_z": ground + b.eaves,
                "ridge_z": ground + b.ridge,
                "geometry": Polygon(ring),
            }
        )
    columns = ["ground_z", "eaves_z", "ridge_z", "geometry"]
    return gpd.GeoDataFrame(rows, columns=columns, geometry="geometry", crs=spec.crs)


def target_table(spec: SceneSpec, terrain: Terrain, origin: np.ndarray) -> gpd.GeoDataFrame:
    """Signals of control points."""
    z = sink_feet(terrain, [(t.x, t.y) for t in spec.targets]) + origin[2]
    rows = [
        {
            "name": t.name,
            "kind": t.kind,
            "x": t.x + origin[0],
            "y": t.y + origin[1],
            "z": float(h),
            "edge_m": t.edge,
        }
        for t, h in zip(spec.targets, z, strict=True)
    ]
    frame = gpd.GeoDataFrame(
        rows, columns=["name", "kind", "x", "y", "z", "edge_m", "geometry"], crs=spec.crs
    )
    return frame.set_geometry(gpd.points_from_xy(frame.x.astype(float), frame.y.astype(float)), crs=spec.crs)


def lake_polygon(
    terrain: Terrain, level: float | None, spec: SceneSpec, origin: np.ndarray
) -> Polygon | None:
    """The largest part of the lake within the scene; the level is local."""
    if level is None:
        return None
    padded = np.pad(terrain.height, 1, constant_values=1e6)
    rings = find_contours(padded, level)
    polygons = []
    for ring in rings:
        if len(ring) < 4:
            continue
        xy = (
            (ring[:, ::-1] - 1) * float(terrain.step)
            + (float(terrain.west), float(terrain.south))
            + origin[:2]
        )
        polygons.append(Polygon(xy).buffer(0))
    west, south = spec.origin
    inside = shapely.box(west, south, west + spec.size[0], south + spec.size[1])
    whole = shapely.union_all([p for p in polygons if p.area > 1]).intersection(inside)
    return max(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
