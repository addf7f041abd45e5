"""What the reed paper found, R01 to R10, as numbers measured on products and a field campaign.

Whether a number confirms a finding is for the reader, or a study, to judge.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

from workbench.reed.accuracy import Agreement, References
from workbench.reed.heights import HeightAgreement, agreement_by_area
from workbench.reed.measure import ReedMetrics


def height_findings(compared: pd.DataFrame) -> dict[str, float]:
    """R01, R02: errors of the heights, and the line of surface on field [reed 3.1].

    ``compared`` as :func:`workbench.reed.compare_heights`.
    """
    table = agreement_by_area(compared).set_index("aoi")
    areas = table.drop(index="total").rmse.dropna()
    total = HeightAgreement.of(compared.field_m, compared.surface_m)
    known = compared.dropna(subset=["field_m", "surface_m"])
    low, tall = (known[mask] for mask in _halves(known.field_m))
    return {
        "rmse_m": total.rmse,
        "rmse_of_best_area_m": float(areas.min()),
        "rmse_of_worst_area_m": float(areas.max()),
        "r2": total.r2,
        "slope": total.slope,
        "intercept_m": total.intercept,
        "bias_of_lower_half_m": HeightAgreement.of(low.field_m, low.surface_m).bias,
        "bias_of_taller_half_m": HeightAgreement.of(tall.field_m, tall.surface_m).bias,
    }


def depth_findings(compared: pd.DataFrame, metrics: ReedMetrics, references: References) -> dict[str, float]:
    """R03: rank correlation of water depth with height and density, in the field and in the products."""
    numbers = {
        "depth_to_height_field": _rank(compared.water_depth_m, compared.field_m),
        "depth_to_height_surface": _rank(compared.water_depth_m, compared.surface_m),
    }
    if references.plots is None or references.points is None:
        return numbers
    plots, points = references.plots, references.points.dropna(subset="water_depth_m")
    depth = _nearest(plots, points, points.water_depth_m.to_numpy())
    cells = metrics.cells[metrics.cells.density != "unknown"]
    middles = pd.DataFrame({"x": cells.geometry.centroid.x, "y": cells.geometry.centroid.y})
    sparse = (cells.density == "sparse").to_numpy(dtype=float)
    return numbers | {
        "depth_to_stems_field": _rank(depth, plots.stems_per_m2),
        "depth_to_sparse_surface": _rank(depth, _nearest(plots, middles, sparse, reach=1.0)),
    }


def matrix_findings(found: Mapping[str, Agreement]) -> dict[str, float]:
    """R04, R05, R06: overall accuracy, kappa, producer and user accuracy of every class."""
    numbers: dict[str, float] = {}
    for name, agreement in found.items():
        matrix = agreement.matrix
        numbers |= {f"{name}_overall": matrix.overall_accuracy, f"{name}_kappa": matrix.kappa}
        for column, values in (("producer", matrix.producer_accuracy), ("user", matrix.user_accuracy)):
            numbers |= {f"{name}_{column}_{label}": float(value) for label, value in values.items()}
    return numbers


def motion_finding(rmse: Mapping[str, float], motion: Mapping[str, float]) -> float:
    """R07: rank correlation of the motion of canopy and water (any measure, by area) with the RMSE."""
    areas = [area for area in rmse if area in motion]
    return _rank([motion[area] for area in areas], [rmse[area] for area in areas])


def front_finding(metrics: ReedMetrics, fray: Mapping[str, float]) -> float:
    """R08: rank correlation of how frayed the front of an area is with its mean sinuosity."""
    mean = metrics.sections.groupby("aoi").sinuosity.mean()
    areas = [area for area in fray if area in mean.index]
    return _rank([fray[area] for area in areas], mean.loc[areas])


def coverage_finding(metrics: ReedMetrics, compared: pd.DataFrame) -> dict[str, float]:
    """R09, for one rig: share of lake and of field points with a height, RMSE and R2."""
    lake = metrics.extent.lake.area
    total = HeightAgreement.of(compared.field_m, compared.surface_m)
    return {
        "lake_known": 1 - metrics.extent.unknown.area / lake,
        "points_known": float(np.isfinite(compared.surface_m).mean()),
        "rmse_m": total.rmse,
        "bias_m": total.bias,
        "r2": total.r2,
    }


def _halves(values: pd.Series) -> tuple[pd.Series, pd.Series]:
    return values < values.median(), values >= values.median()


def _rank(first: ArrayLike, second: ArrayLike) -> float:
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < 3 or np.ptp(a[known]) == 0 or np.ptp(b[known]) == 0:
        return float("nan")
    return float(spearmanr(a[known], b[known]).statistic)


def _nearest(
    places: pd.DataFrame, others: pd.DataFrame, values: np.ndarray, reach: float = np.inf
) -> np.ndarray:
    """Value of the nearest other place, NaN beyond the reach (m)."""
    distance, index = cKDTree(others[["x", "y"]]).query(places[["x", "y"]], distance_upper_bound=reach)
    return np.where(np.isfinite(distance), np.append(values, np.nan)[index], np.nan)
