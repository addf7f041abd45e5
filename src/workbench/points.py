"""Point clouds: LAS and LAZ in and out. Nothing else opens or writes a point cloud."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from pyproj import CRS

from workbench.errors import PointsError


def read_points(path: Path | str) -> tuple[np.ndarray, CRS | None, dict[str, np.ndarray]]:
    """Read a point cloud.

    Returns
    -------
    xyz : ndarray (n, 3), float64
    crs : pyproj CRS, or None where the file states none
    attributes : dict of ndarray (n,)
        All other dimensions of the file by name.

    Raises
    ------
    PointsError
        If the file is missing or unreadable.
    """
    path = Path(path)
    try:
        cloud = laspy.read(path)
    except (OSError, laspy.errors.LaspyException, RuntimeError) as error:
        raise PointsError(f"{path}: not a readable point cloud ({error}).") from error
    attributes = {
        name: np.asarray(cloud[name])
        for name in cloud.point_format.dimension_names
        if name not in {"X", "Y", "Z"}
    }
    return np.asarray(cloud.xyz), cloud.header.parse_crs(), attributes


def write_points(
    xyz: np.ndarray,
    path: Path | str,
    *,
    crs: Any,
    attributes: Mapping[str, np.ndarray] | None = None,
    precision: float = 0.001,
) -> Path:
    """Write points (n, 3) with extra attributes (n,) as LAZ, under a temporary name first.

    Raises
    ------
    PointsError
        If the folder cannot be written.
    """
    path = Path(path)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets = np.floor(xyz.min(axis=0)) if len(xyz) else np.zeros(3)
    header.scales = np.full(3, precision)
    header.add_crs(CRS.from_user_input(crs))
    header.creation_date = None
    for name, values in (attributes or {}).items():
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=values.dtype))
    cloud = laspy.LasData(header)
    cloud.xyz = xyz
    for name, values in (attributes or {}).items():
        cloud[name] = values
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            packed = Path(folder) / path.name
            cloud.write(packed)
            packed.replace(path)
    except OSError as error:
        raise PointsError(
            f"{path}: cannot be written ({error}). Free space or choose another root."
        ) from error
    return path
