"""Rasters on disk and in memory: grids, cloud-optimised GeoTIFF, and the one tiling helper.

A raster is an :class:`xarray.DataArray` with dimensions ``(y, x)`` (or ``(band, y, x)``), cell-centre
coordinates, a CRS, and the attributes ``units``, ``long_name`` and, for heights, ``vertical_datum``.
Nothing outside this module opens or writes a raster file or knows about tiles.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import dask
import numpy as np
import rasterio
import rasterio.shutil
import rioxarray
import xarray as xr
from rasterio.crs import CRS
from rasterio.transform import Affine
from rasterio.windows import Window

from workbench.errors import RasterError

# GDAL would keep a twentieth of the machine's memory of blocks that tiles have done with. Megabytes.
os.environ.setdefault("GDAL_CACHEMAX", "64")

VERTICAL_DATUM = "vertical_datum"
_COG_BLOCK = 512
_GDAL_TAGS = frozenset({"AREA_OR_POINT", "OVR_RESAMPLING_ALG"})


@dataclass(frozen=True)
class Grid:
    """Where the cells of a north-up raster lie.

    The upper left corner of cell ``(row 0, column 0)`` is ``(west, north)``; rows run south.
    """

    crs: CRS
    """Coordinate reference system of the cell coordinates."""
    west: float
    """x of the left edge, in units of the CRS."""
    north: float
    """y of the upper edge, in units of the CRS."""
    resolution: float
    """Edge length of a square cell, in units of the CRS."""
    width: int
    """Number of columns."""
    height: int
    """Number of rows."""

    @classmethod
    def from_bounds(cls, crs: Any, bounds: tuple[float, float, float, float], resolution: float) -> Grid:
        """Smallest grid that covers ``(west, south, east, north)``, snapped to whole multiples of the cell.

        Raises
        ------
        RasterError
            If the bounds are empty or not finite, or the resolution is not positive.
        """
        west, south, east, north = bounds
        if not np.all(np.isfinite(bounds)) or west >= east or south >= north or not resolution > 0:
            raise RasterError(
                f"Bounds {bounds} with cells of {resolution} hold no raster: "
                "give west < east, south < north and a positive resolution."
            )
        column, row = np.floor(west / resolution), np.ceil(north / resolution)
        width = int(np.ceil(east / resolution) - column)
        height = int(row - np.floor(south / resolution))
        return cls(
            CRS.from_user_input(crs),
            column * resolution,
            row * resolution,
            resolution,
            width,
            height,
        )

    @classmethod
    def of(cls, raster: xr.DataArray) -> Grid:
        """Grid of a raster.

        Raises
        ------
        RasterError
            If the raster has no CRS, or its cells are not square, north-up and equally spaced.
        """
        crs = raster.rio.crs
        if crs is None:
            raise RasterError(f"Raster {_name(raster)} has no CRS: set it with raster.rio.write_crs().")
        transform = raster.rio.transform(recalc=True)
        if transform.a <= 0 or not np.isclose(transform.a, -transform.e, rtol=1e-6):
            raise RasterError(
                f"Raster {_name(raster)} has cells of {transform.a} x {transform.e}: "
                "resample it to square, north-up cells."
            )
        return cls(crs, transform.c, transform.f, transform.a, raster.sizes["x"], raster.sizes["y"])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.height, self.width

    @property
    def transform(self) -> Affine:
        """Affine from (column, row) of cell corners to (x, y)."""
        return Affine(self.resolution, 0, self.west, 0, -self.resolution, self.north)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        return (
            self.west,
            self.north - self.height * self.resolution,
            self.west + self.width * self.resolution,
            self.north,
        )

    @property
    def x(self) -> np.ndarray:
        """x of the column centres."""
        return self.west + (np.arange(self.width) + 0.5) * self.resolution

    @property
    def y(self) -> np.ndarray:
        """y of the row centres, falling."""
        return self.north - (np.arange(self.height) + 0.5) * self.resolution

    def window(self, rows: slice, columns: slice) -> Grid:
        """Part of the grid between whole rows and columns."""
        return Grid(
            self.crs,
            self.west + columns.start * self.resolution,
            self.north - rows.start * self.resolution,
            self.resolution,
            columns.stop - columns.start,
            rows.stop - rows.start,
        )

    def tiles(self, size: int = 2048, margin: int = 0) -> Iterator[Tile]:
        """Tiles that cover the grid without overlap, each with its margin clipped at the border."""
        return tiles(self.shape, size=size, margin=margin)


@dataclass(frozen=True)
class Tile:
    """A rectangle of cells that is computed at once."""

    core: tuple[slice, slice]
    """Rows and columns that the tile is responsible for."""
    padded: tuple[slice, slice]
    """Rows and columns that it may read: the core and its margin, clipped at the raster's border."""

    @property
    def inner(self) -> tuple[slice, slice]:
        """Where the core lies within the padded window."""
        rows, columns = (
            slice(core.start - padded.start, core.stop - padded.start)
            for core, padded in zip(self.core, self.padded, strict=True)
        )
        return rows, columns


def tiles(shape: tuple[int, int], *, size: int = 2048, margin: int = 0) -> Iterator[Tile]:
    """Cut a raster into tiles, row by row.

    Parameters
    ----------
    shape
        Rows and columns of the raster.
    size
        Largest edge of a tile's core, cells.
    margin
        Cells beside the core that a step needs to see.

    Raises
    ------
    RasterError
        If the size is not positive, the margin is negative, or a tile is smaller than its margin.
    """
    if size < 1 or margin < 0 or size < margin:
        raise RasterError(
            f"Tiles of {size} cells cannot carry a margin of {margin} cells: "
            "choose a tile size of at least the margin."
        )
    height, width = shape
    for top in range(0, height, size):
        for left in range(0, width, size):
            bottom, right = min(top + size, height), min(left + size, width)
            yield Tile(
                core=(slice(top, bottom), slice(left, right)),
                padded=(
                    slice(max(top - margin, 0), min(bottom + margin, height)),
                    slice(max(left - margin, 0), min(right + margin, width)),
                ),
            )


def map_tiles(
    function: Callable[..., Any],
    *rasters: xr.DataArray,
    margin: int,
    tile_size: int = 2048,
    attributes: Sequence[Mapping[str, Any]] | None = None,
) -> Any:
    """Apply a function of numpy arrays to rasters tile by tile.

    The function sees each tile with its margin (clipped, never padded, at the raster's border) and
    returns one array, or a tuple of arrays, of the shape that it was given; the margin is cut off.
    Its result is independent of the tile size if the margin is as wide as the function looks.
    Tiles run on the active dask scheduler: threads by default, processes or a cluster if configured.

    Parameters
    ----------
    function
        Called with one array (rows, columns) or (band, rows, columns) per raster.
    rasters
        Rasters on one grid, in memory or chunked.
    margin
        Cells that the function looks beyond the cell it computes.
    tile_size
        Edge of a tile, cells.
    attributes
        Attributes of each result; those of the first raster by default.

    Returns
    -------
    DataArray or tuple of DataArray
        Like the function's result, on the grid of the first raster.

    Raises
    ------
    RasterError
        If the rasters lie on different grids or a tile is smaller than its margin.
    """
    first, *others = rasters
    for other in others:
        require_same_grid(first, other)
    shape = first.sizes["y"], first.sizes["x"]
    all_tiles = list(tiles(shape, size=tile_size, margin=margin))

    def compute(tile: Tile) -> Any:
        rows, columns = tile.padded
        parts = [raster.isel(y=rows, x=columns).values for raster in rasters]
        result = function(*parts)
        many = result if isinstance(result, tuple) else (result,)
        return tuple(part[(..., *tile.inner)] for part in many), isinstance(result, tuple)

    if len(all_tiles) == 1:
        computed = [compute(all_tiles[0])]
    else:
        computed = list(dask.compute(*[dask.delayed(compute)(tile) for tile in all_tiles]))
    outputs = []
    for index, sample in enumerate(computed[0][0]):
        whole = np.empty((*sample.shape[:-2], *shape), dtype=sample.dtype)
        for tile, (parts, _) in zip(all_tiles, computed, strict=True):
            whole[(..., *tile.core)] = parts[index]
        dims = ("y", "x") if whole.ndim == 2 else ("band", "y", "x")
        output = xr.DataArray(whole, dims=dims, coords={"y": first.y, "x": first.x})
        output.attrs = dict(attributes[index] if attributes else first.attrs)
        outputs.append(output.rio.write_crs(first.rio.crs))
    return tuple(outputs) if computed[0][1] else outputs[0]


def new_raster(
    values: np.ndarray,
    grid: Grid,
    *,
    name: str,
    units: str,
    long_name: str = "",
    vertical_datum: str | None = None,
    nodata: float | None = None,
    copy: bool = True,
    **attributes: Any,
) -> xr.DataArray:
    """Wrap values of shape ``grid.shape`` or (band, rows, columns) as a raster.

    Floats use NaN for missing cells; for integers give ``nodata`` where a value means missing. Without
    ``copy`` the values themselves are taken over.
    """
    dims = ("y", "x") if values.ndim == 2 else ("band", "y", "x")
    if values.shape[-2:] != grid.shape:
        raise RasterError(f"Values of shape {values.shape} do not fit the grid {grid.shape} of {name}.")
    raster = xr.DataArray(
        values.copy() if copy else values, dims=dims, coords={"y": grid.y, "x": grid.x}, name=name
    )
    raster.attrs = {"units": units, "long_name": long_name or name, **attributes}
    if vertical_datum is not None:
        raster.attrs[VERTICAL_DATUM] = vertical_datum
    if nodata is None and np.issubdtype(values.dtype, np.floating):
        nodata = np.nan
    # In place: each of these would copy all values once more.
    raster.rio.write_crs(grid.crs, inplace=True)
    raster.rio.write_transform(grid.transform, inplace=True)
    if nodata is not None:
        raster.rio.write_nodata(nodata, inplace=True)
    return raster


def require_same_grid(a: xr.DataArray, b: xr.DataArray) -> None:
    """Refuse two rasters that do not share CRS, size, resolution and origin.

    Raises
    ------
    RasterError
        Naming both rasters and what differs.
    """
    first, second = Grid.of(a), Grid.of(b)
    if first.crs != second.crs:
        raise RasterError(f"{_name(a)} is in {first.crs}, {_name(b)} in {second.crs}: reproject one of them.")
    shift = max(abs(first.west - second.west), abs(first.north - second.north))
    if (
        first.shape != second.shape
        or not np.isclose(first.resolution, second.resolution, rtol=1e-6)
        or shift > 0.01 * first.resolution
    ):
        raise RasterError(
            f"{_name(a)} ({first.shape} cells of {first.resolution}) and {_name(b)} ({second.shape} "
            f"cells of {second.resolution}) lie on different grids: resample one with match_grid()."
        )


def match_grid(raster: xr.DataArray, grid: Grid, *, resampling: str = "bilinear") -> xr.DataArray:
    """Resample (and reproject) a raster onto a grid, keeping its attributes."""
    method = getattr(rasterio.enums.Resampling, resampling)
    result = raster.rio.reproject(grid.crs, shape=grid.shape, transform=grid.transform, resampling=method)
    result = result.assign_coords(x=grid.x, y=grid.y)
    result.attrs.update(raster.attrs)
    return result


def require_heights(raster: xr.DataArray) -> str:
    """Vertical datum of a height raster.

    Raises
    ------
    RasterError
        If the raster does not state its CRS or vertical datum.
    """
    Grid.of(raster)
    datum = raster.attrs.get(VERTICAL_DATUM)
    if not datum:
        raise RasterError(
            f"Height raster {_name(raster)} states no vertical datum: "
            f"set raster.attrs['{VERTICAL_DATUM}'] or read it with vertical_datum='...'."
        )
    return str(datum)


def read_raster(
    path: Path | str, *, vertical_datum: str | None = None, chunks: int | None = None
) -> xr.DataArray:
    """Read a raster: ``(y, x)`` for one band, ``(band, y, x)`` for several.

    Missing cells of float rasters become NaN; integer rasters keep their type and ``rio.nodata``.

    Parameters
    ----------
    path
        Any raster file that GDAL reads.
    vertical_datum
        States the datum of heights where the file does not.
    chunks
        Edge of the dask chunks; without it the raster is loaded.

    Raises
    ------
    RasterError
        If the file is missing, unreadable or has no CRS, or states another vertical datum.
    """
    path = Path(path)
    if not path.exists():
        raise RasterError(f"{path}: no such raster file.")
    try:
        with rasterio.open(path) as source:
            tags, kind = source.tags(), np.dtype(source.dtypes[0])
            units, description = source.units[0], source.descriptions[0]
        is_float = np.issubdtype(kind, np.floating)
        raster = rioxarray.open_rasterio(
            path,
            masked=is_float,
            chunks={"x": chunks, "y": chunks} if chunks else None,
            lock=False if chunks else None,
        )
    except (rasterio.errors.RasterioError, OSError) as error:
        raise RasterError(f"{path}: not a readable raster ({error}).") from error
    assert isinstance(raster, xr.DataArray)
    if raster.rio.crs is None:
        raise RasterError(f"{path}: no CRS. Assign it, for example with gdal_edit.py -a_srs EPSG:n.")
    stated = tags.get("VERTICAL_DATUM")
    if stated and vertical_datum and stated != vertical_datum:
        raise RasterError(
            f"{path}: heights refer to '{stated}', not to '{vertical_datum}': transform them first."
        )
    nodata = None if is_float else raster.rio.nodata
    raster.attrs = {key.lower(): value for key, value in tags.items() if key not in _GDAL_TAGS}
    if nodata is not None:
        raster = raster.rio.write_nodata(nodata)
    raster.attrs["units"] = units or raster.attrs.get("units", "1")
    raster.attrs["long_name"] = description or raster.attrs.get("long_name", path.stem)
    if stated or vertical_datum:
        raster.attrs[VERTICAL_DATUM] = stated or vertical_datum
    raster.name = path.stem
    if raster.sizes["band"] == 1:
        raster = raster.isel(band=0, drop=True)
    return raster if chunks else raster.load()


def read_overview(path: Path | str, *, longest: int = 1600) -> xr.DataArray:
    """Read a raster reduced for display, so that its longer edge has at most ``longest`` cells.

    Uses the overviews of the file: cost and memory do not grow with the raster. Nearest cells, so
    that classes stay classes.

    Raises
    ------
    RasterError
        As :func:`read_raster`.
    """
    path = Path(path)
    try:
        with rasterio.open(path) as source:
            factor = max(max(source.width, source.height) / longest, 1)
            shape = max(round(source.height / factor), 1), max(round(source.width / factor), 1)
            values = source.read(out_shape=(source.count, *shape), masked=True)
            nodata, crs, bounds = source.nodata, source.crs, source.bounds
    except (rasterio.errors.RasterioError, OSError) as error:
        raise RasterError(f"{path}: not a readable raster ({error}).") from error
    if np.issubdtype(values.dtype, np.floating):
        values = values.filled(np.nan)
    west, south, east, north = bounds
    x = west + (np.arange(shape[1]) + 0.5) * (east - west) / shape[1]
    y = north - (np.arange(shape[0]) + 0.5) * (north - south) / shape[0]
    overview = xr.DataArray(
        np.ma.getdata(values), dims=("band", "y", "x"), coords={"y": y, "x": x}, name=path.stem
    )
    overview = overview.rio.write_crs(crs)
    if nodata is not None:
        overview = overview.rio.write_nodata(nodata)
    return overview.isel(band=0, drop=True) if overview.sizes["band"] == 1 else overview


def write_raster(raster: xr.DataArray, path: Path | str) -> Path:
    """Write a raster as cloud-optimised GeoTIFF under a temporary name, then rename it.

    The same raster gives the same bytes.

    Raises
    ------
    RasterError
        If the raster has no CRS, heights have no vertical datum, or the folder cannot be written.
    """
    grid = Grid.of(raster)
    values = raster.values if raster.ndim == 3 else raster.values[None]
    with RasterWriter(
        path,
        grid,
        dtype=str(values.dtype),
        bands=values.shape[0],
        nodata=raster.rio.nodata if raster.rio.nodata is not None else raster.rio.encoded_nodata,
        attributes={k: v for k, v in raster.attrs.items() if k not in {"_FillValue", "scale_factor"}},
    ) as writer:
        writer.write(values, (slice(0, grid.height), slice(0, grid.width)))
    return Path(path)


class RasterWriter:
    """Writes a raster window by window; it appears under its name only when it is complete.

    Examples
    --------
    >>> with RasterWriter("dsm.tif", grid, dtype="float32", attributes={"units": "m"}) as writer:
    ...     for tile in grid.tiles(1024):
    ...         writer.write(compute(tile), tile.core)
    """

    def __init__(
        self,
        path: Path | str,
        grid: Grid,
        *,
        dtype: str,
        bands: int = 1,
        nodata: float | None = None,
        attributes: Mapping[str, Any] | None = None,
        resampling: str = "nearest",
    ) -> None:
        self.path = Path(path)
        self.grid = grid
        self._resampling = resampling
        self._is_float = np.issubdtype(np.dtype(dtype), np.floating)
        if nodata is None and self._is_float:
            nodata = np.nan
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = tempfile.TemporaryDirectory(prefix=f".{self.path.name}.", dir=self.path.parent)
        except OSError as error:
            raise RasterError(
                f"{self.path.parent}: cannot be written ({error}). Free some space or choose another root."
            ) from error
        self._plain = Path(self._folder.name) / "plain.tif"
        self._dataset = rasterio.open(
            self._plain,
            "w",
            driver="GTiff",
            width=grid.width,
            height=grid.height,
            count=bands,
            dtype=dtype,
            crs=grid.crs,
            transform=grid.transform,
            nodata=nodata,
            tiled=True,
            blockxsize=_COG_BLOCK,
            blockysize=_COG_BLOCK,
            BIGTIFF="IF_SAFER",
        )
        attributes = dict(attributes or {})
        units = str(attributes.pop("units", "1"))
        long_name = str(attributes.pop("long_name", self.path.stem))
        names = attributes.pop("band_names", None)
        for band in range(1, bands + 1):
            self._dataset.set_band_unit(band, units)
            self._dataset.set_band_description(band, names[band - 1] if names else long_name)
        tags = {k.upper(): str(v) for k, v in attributes.items() if isinstance(v, str | int | float)}
        self._dataset.update_tags(UNITS=units, LONG_NAME=long_name, **tags)

    def write(self, values: np.ndarray, window: tuple[slice, slice]) -> None:
        """Write values (rows, columns) or (band, rows, columns) into a window of rows and columns."""
        rows, columns = window
        target = Window(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
        try:
            self._dataset.write(values if values.ndim == 3 else values[None], window=target)
        except (rasterio.errors.RasterioError, OSError) as failure:
            raise self._unwritable(failure) from failure

    def __enter__(self) -> RasterWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._dataset.close()
            if kind is None:
                self._finish()
        except (rasterio.errors.RasterioError, OSError) as failure:
            raise self._unwritable(failure) from failure
        finally:
            self._folder.cleanup()

    def _unwritable(self, failure: Exception) -> RasterError:
        return RasterError(
            f"{self.path}: cannot be written ({failure}). Free some space or choose another root."
        )

    def _finish(self) -> None:
        packed = Path(self._folder.name) / "packed.tif"
        rasterio.shutil.copy(
            self._plain,
            packed,
            driver="COG",
            compress="DEFLATE",
            predictor="FLOATING_POINT" if self._is_float else "STANDARD",
            blocksize=_COG_BLOCK,
            level=6,
            overview_resampling=self._resampling,
            bigtiff="IF_SAFER",
            num_threads="2",
        )
        packed.replace(self.path)


class ScratchArrays:
    """Arrays of one shape on disk, written and read by window, for steps that must see a whole area.

    They live in a hidden folder beside the products and vanish at the end. Windows that were never
    written are zero.

    Examples
    --------
    >>> with ScratchArrays(folder, grid.shape, {"height": "float32"}) as scratch:
    ...     scratch.write("height", compute(tile), tile.core)
    """

    def __init__(self, folder: Path, shape: tuple[int, int], kinds: Mapping[str, str]) -> None:
        self.shape = shape
        self._kinds = dict(kinds)
        try:
            self._folder = tempfile.TemporaryDirectory(prefix=".scratch.", dir=folder)
            for name, kind in self._kinds.items():
                with self._path(name).open("wb") as file:
                    file.truncate(max(shape[0] * shape[1] * np.dtype(kind).itemsize, 1))
        except OSError as error:
            raise RasterError(
                f"{folder}: cannot be written ({error}). Free some space or choose another root."
            ) from error

    def write(self, name: str, values: np.ndarray, window: tuple[slice, slice]) -> None:
        """Write values (rows, columns) of an array into a window of rows and columns."""
        mapped = self._map(name, "r+")
        mapped[window] = values
        mapped.flush()

    def read(self, name: str, window: tuple[slice, slice]) -> np.ndarray:
        """Copy of a window of rows and columns of an array."""
        return np.array(self._map(name, "r")[window])

    def __enter__(self) -> ScratchArrays:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def _path(self, name: str) -> Path:
        return Path(self._folder.name) / name

    def _map(self, name: str, mode: Literal["r", "r+"]) -> np.memmap:
        # Mapped anew each time: the pages of a map that stays open count as memory of the process.
        return np.memmap(self._path(name), dtype=self._kinds[name], mode=mode, shape=self.shape)


def _name(raster: xr.DataArray) -> str:
    return str(raster.name or raster.attrs.get("long_name") or "raster")
