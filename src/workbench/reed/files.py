"""Reed of any surface: a DSM, a water level and a shoreline as files, without a site."""

from __future__ import annotations

from pathlib import Path

from workbench.errors import ReedError
from workbench.params import Parameters
from workbench.rasters import VERTICAL_DATUM, read_raster
from workbench.reed.accuracy import References
from workbench.reed.field import read_field_points, read_plots
from workbench.reed.measure import ReedModel
from workbench.reed.stage import measure_into
from workbench.stages import FOLDERS
from workbench.vectors import read_vector


def reed_files(
    dsm: Path | str,
    out: Path | str,
    parameters: Parameters | None = None,
    *,
    water_level: float | None = None,
    vertical_datum: str | None = None,
    shoreline: Path | str | None = None,
    areas: Path | str | None = None,
    transects: Path | str | None = None,
    spread: Path | str | None = None,
    field_points: Path | str | None = None,
    plots: Path | str | None = None,
    reference_status: Path | str | None = None,
) -> dict:
    """Measure the reed of a surface that was made elsewhere, and write what the reed stage writes.

    Parameters
    ----------
    dsm
        Raster of heights, one band, m, any CRS in metres.
    out
        Folder of the results: ``reed/`` with all products, ``metrics/reed.json``.
    parameters
        Section ``reed`` is read; defaults if None.
    water_level
        Of the day of the surface, m in its vertical datum; None: that of the parameters.
    vertical_datum
        What heights and water level refer to, in words, where the file does not state it.
    shoreline
        Polygon of the lake side, any CRS; None: all of the surface is lake.
    areas, transects
        Polygons with ``aoi``; lines with ``aoi`` and ``transect``. Any CRS.
    spread
        Raster with the standard deviation of the heights in every pixel, m.
    field_points, plots, reference_status
        Of a field campaign, as a site has them.

    Returns
    -------
    dict
        As :func:`workbench.reed.reed_site`.

    Raises
    ------
    ReedError
        If the datum or water level is unknown, or files do not fit each other.
    RasterError, VectorError, SiteError
        If a file cannot be read.
    """
    options = (parameters or Parameters()).reed
    if water_level is None and options.water_level is None:
        raise ReedError(f"{dsm}: the water level is open. State it in metres (--water-level).")
    surface = read_raster(dsm, vertical_datum=vertical_datum)
    if not surface.attrs.get(VERTICAL_DATUM):
        raise ReedError(
            f"{dsm}: does not state what its heights refer to. Say it in words (--vertical-datum DHHN2016); "
            "the water level must refer to the same."
        )
    model = ReedModel(
        surface,
        water_level,
        None if shoreline is None else read_vector(shoreline),
        areas=None if areas is None else read_vector(areas),
        transects=None if transects is None else read_vector(transects),
        spread=None if spread is None else read_raster(spread),
    )
    references = References(
        None if field_points is None else read_field_points(field_points),
        None if plots is None else read_plots(plots),
        None if reference_status is None else read_vector(reference_status),
    )
    if water_level is not None:
        options = options.model_copy(update={"water_level": water_level})
    return measure_into(Path(out) / FOLDERS["reed"], model, references, options)
