"""Surveys of a scene on the ground: targets by receiver, stems by terrestrial scan."""

from __future__ import annotations

import geopandas as gpd
import numpy as np

from workbench.params import SimulateParameters
from workbench.site import ControlPoint
from workbench.virtual.scene import Scene

_DEFAULTS = SimulateParameters()
_BREAST = 1.3  # Height of the lower point on a stem, m.
_UPPER_SHARE = 0.45  # Height of the upper point as a share of the tree's: above it leaves hide the stem.

TREE_COLUMNS = ["tree_id", "species_group", "dbh_m", "height_m", "x1", "y1", "z1", "x2", "y2", "z2", "dead"]


def survey_targets(
    scene: Scene,
    *,
    rng: np.random.Generator,
    sd_xy: float = _DEFAULTS.survey_sd_xy,
    sd_z: float = _DEFAULTS.survey_sd_z,
    check_every: int = _DEFAULTS.check_every,
) -> tuple[ControlPoint, ...]:
    """Targets with the errors of a survey; every ``check_every``-th one is a checkpoint."""
    targets = scene.targets[scene.targets.kind == "quadrant"]
    points = []
    for number, target in enumerate(targets.itertuples(), start=1):
        x, y, z = np.array([target.x, target.y, target.z]) + rng.normal(0, 1, 3) * (sd_xy, sd_xy, sd_z)
        role = "check" if number % check_every == 0 else "control"
        points.append(ControlPoint(str(target.name), float(x), float(y), float(z), sd_xy, sd_z, role))  # type: ignore[arg-type]
    return tuple(points)


def scan_stems(
    scene: Scene,
    *,
    rng: np.random.Generator,
    sd: float = _DEFAULTS.scan_sd,
    min_dbh_broadleaf: float = _DEFAULTS.min_dbh_broadleaf,
    min_dbh_conifer: float = _DEFAULTS.min_dbh_conifer,
) -> gpd.GeoDataFrame:
    """Reference trees: two points on each counted stem, from which the top is extrapolated [METHODS 7].

    Stems thinner than the minimum diameter at breast height and the understorey are not counted.

    Returns
    -------
    GeoDataFrame
        ``TREE_COLUMNS``; the geometry is the lower point. Heights are those of a hypsometer, to 0.1 m.
    """
    trees = scene.trees
    least = np.where(trees.species_group == "conifer", min_dbh_conifer, min_dbh_broadleaf)
    trees = trees[(trees.dbh_m >= least) & ~trees.understorey.astype(bool)]
    foot = trees[["x", "y", "ground_z"]].to_numpy(dtype=float)
    top = trees[["top_x", "top_y", "top_z"]].to_numpy(dtype=float)
    height = np.maximum(top[:, 2] - foot[:, 2], 1e-6)
    lower, upper = (
        foot + share[:, None] * (top - foot) + rng.normal(0, 1, foot.shape) * sd
        for share in (np.minimum(_BREAST / height, 0.3), np.full(len(trees), _UPPER_SHARE))
    )
    frame = gpd.GeoDataFrame(
        {
            "tree_id": trees.tree_id.to_numpy(),
            "species_group": trees.species_group.to_numpy(),
            "dbh_m": trees.dbh_m.to_numpy(dtype=float).round(3),
            "height_m": height.round(1),
            **{f"{axis}1": lower[:, i].round(3) for i, axis in enumerate("xyz")},
            **{f"{axis}2": upper[:, i].round(3) for i, axis in enumerate("xyz")},
            "dead": trees.dead.to_numpy(dtype=bool),
        },
        columns=TREE_COLUMNS,
    )
    return frame.set_geometry(gpd.points_from_xy(frame.x1, frame.y1), crs=scene.spec.crs)
