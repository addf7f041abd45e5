"""Error matrices of extent, density and status against the field and the eye [reed 2.6]."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from workbench.assessment.error_matrix import ErrorMatrix, error_matrix
from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.reed.extent import ReedExtent
from workbench.reed.measure import ReedMetrics
from workbench.reed.status import EXCLUDED, HEALTHY, STRESSED

_DEFAULTS = ReedParameters()
REED, WATER = "aquatic reed", "water"
SPARSE, DENSE = "sparse reed", "dense reed"
_UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class Agreement:
    """An error matrix, and the samples that could not enter it."""

    matrix: ErrorMatrix
    """Rows classified, columns reference."""
    samples: pd.DataFrame
    """Every sample with ``classified`` and ``reference``."""
    left_out: int
    """Samples without a class: surface unknown, or section excluded."""


@dataclass(frozen=True, eq=False)
class References:
    """What is known of the reed from elsewhere: a field campaign, an interpreted orthophoto."""

    points: pd.DataFrame | None = None
    """As :func:`workbench.reed.read_field_points`."""
    plots: pd.DataFrame | None = None
    """As :func:`workbench.reed.read_plots`."""
    status: pd.DataFrame | None = None
    """``aoi``, ``section``, ``status`` (healthy or stressed)."""


def agreements(
    metrics: ReedMetrics, references: References, *, dense_stems: float = _DEFAULTS.plot_dense_stems
) -> dict[str, Agreement]:
    """Error matrices of ``extent``, ``density`` and ``status``, of those that there is a reference for."""
    found: dict[str, Agreement] = {}
    if references.points is not None:
        found["extent"] = extent_agreement(references.points, metrics.extent)
    if references.plots is not None:
        found["density"] = density_agreement(
            references.plots, references.points, metrics.cells, metrics.extent, dense_stems=dense_stems
        )
    if references.status is not None and len(metrics.sections):
        found["status"] = status_agreement(metrics.sections, references.status)
    return found


def extent_agreement(points: pd.DataFrame, extent: ReedExtent) -> Agreement:
    """Reed or water at every point of the transects [reed table 2].

    The reference is reed where a stem was measured; points on unknown ground or outside of the mapped
    lake are left out.

    Parameters
    ----------
    points
        As :func:`workbench.reed.read_field_points`.
    extent
        As :func:`workbench.reed.map_extent`.
    """
    x, y = points.x.to_numpy(), points.y.to_numpy()
    for shape in (extent.reed, extent.lake, extent.unknown):
        shapely.prepare(shape)
    inside = shapely.contains_xy(extent.reed, x, y)
    known = shapely.contains_xy(extent.lake, x, y) & ~shapely.contains_xy(extent.unknown, x, y)
    classified = np.where(inside, REED, np.where(known, WATER, _UNKNOWN))
    reference = np.where(np.isfinite(points.stem_height_m), REED, WATER)
    return _agreement(points, classified, reference, [REED, WATER])


def density_agreement(
    plots: pd.DataFrame,
    points: pd.DataFrame | None,
    cells: gpd.GeoDataFrame,
    extent: ReedExtent,
    *,
    dense_stems: float = _DEFAULTS.plot_dense_stems,
) -> Agreement:
    """Sparse reed, dense reed or water at the plots, and at open water of the transects [reed table 3].

    A plot has the class of the cell that holds its middle, and is water where no reed is there. Open
    water is sampled once a transect, at its first point without reed.

    Parameters
    ----------
    plots
        As :func:`workbench.reed.read_plots`; ``density`` goes before stems.
    points
        As :func:`workbench.reed.read_field_points`; None: plots only.
    cells
        As :func:`workbench.reed.density_cells`.
    extent
        Knows where the surface is unknown.
    dense_stems
        Plots with as many stems a square metre are dense.
    """
    counted = np.where(plots.stems_per_m2 >= dense_stems, DENSE, SPARSE)
    counted = np.where(np.isfinite(plots.stems_per_m2), counted, _UNKNOWN)
    judged = plots.density.map({"sparse": SPARSE, "dense": DENSE, "": ""}).to_numpy()
    samples = plots[["aoi", "transect", "x", "y"]].assign(reference=np.where(judged == "", counted, judged))
    if points is not None:
        open_water = points[~np.isfinite(points.stem_height_m)]
        first = open_water.groupby(["aoi", "transect"], sort=False).head(1)
        samples = pd.concat(
            [samples, first[["aoi", "transect", "x", "y"]].assign(reference=WATER)], ignore_index=True
        )
    places = shapely.points(samples.x.to_numpy(), samples.y.to_numpy())
    found, cell = shapely.STRtree(cells.geometry.to_numpy()).query(places, predicate="intersects")[:, ::-1]
    classes = cells.density.map({"sparse": SPARSE, "dense": DENSE, "unknown": _UNKNOWN}).to_numpy()
    unknown = shapely.contains_xy(extent.unknown, samples.x, samples.y)
    outside = ~shapely.contains_xy(extent.lake, samples.x, samples.y)
    classified = np.where(unknown | outside, _UNKNOWN, WATER).astype(object)
    classified[found] = classes[cell]
    return _agreement(samples, classified, samples.reference.to_numpy(), [SPARSE, DENSE, WATER])


def status_agreement(sections: gpd.GeoDataFrame, reference: pd.DataFrame) -> Agreement:
    """Stressed or healthy, section by section [reed table 4]; excluded sections are left out.

    Parameters
    ----------
    sections
        As :func:`workbench.reed.assess_sections`.
    reference
        ``aoi``, ``section``, ``status`` (healthy or stressed), from visual interpretation.

    Raises
    ------
    ReedError
        If columns are missing, a status is another word, or no section is in both.
    """
    lacking = [name for name in ("aoi", "section", "status") if name not in reference.columns]
    if lacking:
        raise ReedError(f"The reference status lacks the column {' and '.join(lacking)}.")
    strange = set(reference.status) - {HEALTHY, STRESSED}
    if strange:
        raise ReedError(f"The reference status holds {sorted(map(str, strange))}: write healthy or stressed.")
    columns = ["aoi", "section", "status"]
    left, right = (
        pd.DataFrame(frame[columns]).astype({"aoi": str, "section": int}) for frame in (sections, reference)
    )
    both = left.merge(right, on=["aoi", "section"], suffixes=("", "_reference"))
    if both.empty:
        raise ReedError("No section of the reference status is among the sections: do aoi and section agree?")
    classified = both.status.replace(EXCLUDED, _UNKNOWN).to_numpy()
    return _agreement(both, classified, both.status_reference.to_numpy(), [STRESSED, HEALTHY])


def _agreement(
    samples: pd.DataFrame, classified: np.ndarray, reference: np.ndarray, classes: list[str]
) -> Agreement:
    keep = (classified != _UNKNOWN) & (reference != _UNKNOWN)
    matrix = error_matrix(classified[keep], reference[keep], classes)
    table = pd.DataFrame(samples).assign(classified=classified, reference=reference)
    return Agreement(matrix, table, int((~keep).sum()))
