"""Control points and their observations as tables."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from workbench.errors import SiteError
from workbench.site.model import ControlPoint, Observation, Role
from workbench.site.tables import number, read_table

CONTROL_HEADER = "name,x,y,z,sd_xy,sd_z,role"
OBSERVATION_HEADER = "name,photo,column,row"
_COLLINEAR = 0.02  # Second over largest spread of points; below, a rotation about the line is free.
_ROLES: dict[str, Role] = {"control": "control", "check": "check", "verify": "verify"}
_USUAL_SD = 0.02  # Survey with RTK, where the file leaves the accuracy open.


def on_a_line(points: np.ndarray) -> bool:
    """Whether points (n, 2 or 3) lie so close to a line that a block could turn about it."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < _COLLINEAR * spread[0])


def read_control(path: Path | str) -> tuple[ControlPoint, ...]:
    """Read control points from a CSV with the header ``name,x,y,z,sd_xy,sd_z,role``.

    Decimal commas and semicolons are understood. Without a standard deviation 2 cm are taken, without
    a role ``control``.

    Raises
    ------
    SiteError
        Naming the file and line of what is missing, not a number, repeated, or an unknown role.
    """
    path = Path(path)
    points: dict[str, ControlPoint] = {}
    for line, row in read_table(path, CONTROL_HEADER.split(",")[:4]):
        name = row["name"]
        stated = (row.get("role") or "control").lower()
        role = _ROLES.get(stated)
        if role is None:
            raise SiteError(f"{path}, line {line}: role '{stated}'; use control, check or verify.")
        if name in points:
            raise SiteError(f"{path}, line {line}: point '{name}' occurs twice; give each its own name.")
        x, y, z = (number(row, key, path, line) for key in ("x", "y", "z"))
        sd_xy, sd_z = (number(row, key, path, line, _USUAL_SD) for key in ("sd_xy", "sd_z"))
        if min(sd_xy, sd_z) <= 0:
            raise SiteError(f"{path}, line {line}: standard deviations must be positive.")
        points[name] = ControlPoint(name, x, y, z, sd_xy, sd_z, role)
    return tuple(points.values())


def read_observations(path: Path | str) -> tuple[Observation, ...]:
    """Read observations from a CSV with the header ``name,photo,column,row``.

    Raises
    ------
    SiteError
        Naming the file and line of what is missing or not a number.
    """
    path = Path(path)
    return tuple(
        Observation(
            row["name"], row["photo"], number(row, "column", path, line), number(row, "row", path, line)
        )
        for line, row in read_table(path, OBSERVATION_HEADER.split(","))
    )


def render_control(points: tuple[ControlPoint, ...]) -> str:
    """Control points as CSV text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CONTROL_HEADER.split(","))
    for p in points:
        writer.writerow([p.name, f"{p.x:.4f}", f"{p.y:.4f}", f"{p.z:.4f}", p.sd_xy, p.sd_z, p.role])
    return out.getvalue()


def render_observations(observations: tuple[Observation, ...]) -> str:
    """Observations as CSV text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(OBSERVATION_HEADER.split(","))
    for o in observations:
        writer.writerow([o.name, o.photo, f"{o.column:.3f}", f"{o.row:.3f}"])
    return out.getvalue()
