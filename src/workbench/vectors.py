"""Vector files: GeoPackage layers in and out. Nothing else opens or writes a vector file."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas as gpd
import pyogrio

from workbench.errors import VectorError

# GeoPackages note when they were written; a fixed date lets the same layers give the same bytes.
pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": "2000-01-01T00:00:00Z"})


def read_vector(path: Path | str, *, layer: str | None = None, crs: Any | None = None) -> gpd.GeoDataFrame:
    """Read a layer of any vector file, reprojected to ``crs`` if one is given.

    Raises
    ------
    VectorError
        If the file or layer is missing, unreadable or has no CRS.
    """
    path = Path(path)
    if not path.exists():
        raise VectorError(f"{path}: no such vector file.")
    try:
        frame = gpd.read_file(path, layer=layer)
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, ValueError) as error:
        raise VectorError(f"{path}: layer {layer or '(first)'} cannot be read ({error}).") from error
    if frame.crs is None:
        raise VectorError(f"{path}: no CRS. Assign it, for example in QGIS, and save again.")
    return frame if crs is None else frame.to_crs(crs)


def layer_names(path: Path | str) -> tuple[str, ...]:
    """Names of the layers of a vector file.

    Raises
    ------
    VectorError
        If the file is missing or unreadable.
    """
    try:
        return tuple(str(name) for name, _ in pyogrio.list_layers(path))
    except pyogrio.errors.DataSourceError as error:
        raise VectorError(f"{path}: not a readable vector file ({error}).") from error


def write_layers(layers: Mapping[str, gpd.GeoDataFrame], path: Path | str) -> Path:
    """Write GeoPackage layers under a temporary name, then rename the file.

    The same layers give the same bytes.

    Raises
    ------
    VectorError
        If a layer has no CRS or the folder cannot be written.
    """
    path = Path(path)
    for name, frame in layers.items():
        if frame.crs is None:
            raise VectorError(f"{path}: layer {name} has no CRS.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            packed = Path(folder) / path.name
            for name, frame in layers.items():
                frame.to_file(packed, layer=name, driver="GPKG")
            packed.replace(path)
    except (
        OSError,
        pyogrio.errors.DataSourceError,
        pyogrio.errors.DataLayerError,
        pyogrio.errors.FeatureError,
    ) as error:
        raise VectorError(
            f"{path}: cannot be written ({error}). Free space or choose another root."
        ) from error
    return path
