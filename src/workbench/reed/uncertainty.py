"""How far the metrics can be trusted: errors of surface and water level propagated, thresholds moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from scipy.ndimage import gaussian_filter

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.rasters import Grid, match_grid
from workbench.reed.measure import ReedModel
from workbench.reed.status import EXCLUDED, STRESSED

_DEFAULTS = ReedParameters()
THRESHOLDS = (
    "min_height",
    "max_height",
    "min_area",
    "min_hole",
    "cell_size",
    "variance_cut",
    "mean_cut",
    "shore_tolerance",
    "front_smoothing",
    "box_buffer",
    "arsi_cut",
)
"""Thresholds that the aRSI or the status depends on."""


@dataclass(frozen=True)
class Uncertainty:
    """Metrics of many surfaces that are as likely as the one that was measured."""

    summary: pd.DataFrame
    """One row a metric: ``metric, value`` (of the surface itself)``, mean, sd, p05, p95``."""
    sections: pd.DataFrame
    """One row a section: ``aoi, section, arsi`` (of the surface itself)``, arsi_mean, arsi_sd`` (over draws
    with a finite index)``, stressed, excluded`` (shares of draws, 0..1)."""
    draws: int
    """Surfaces drawn."""


def propagate(
    model: ReedModel,
    options: ReedParameters | None = None,
    *,
    spread: xr.DataArray | float | None = None,
    draws: int | None = None,
    seed: int | None = None,
) -> Uncertainty:
    """Monte Carlo: measure surfaces drawn around the given one.

    A draw adds to the surface a Gaussian field with the spread of each cell as standard deviation and
    ``error_length`` as range, and to the water level one number for all.

    Parameters
    ----------
    model
        Surface, water level and shoreline.
    options
        Thresholds, and ``water_level_sd``, ``error_length``, ``draws``, ``seed``.
    spread
        Standard deviation of the surface, m: raster or one number; cells without one take the median.
    draws, seed
        Instead of those of the options.

    Raises
    ------
    ReedError
        If there are less than two draws or the spread is negative.
    """
    o = options or ReedParameters()
    number = o.draws if draws is None else draws
    if number < 2:
        raise ReedError(f"{number} draws have no spread: use 2 or more, 50 for a standard deviation to 10 %.")
    sd = _spread(spread, model.grid)
    rng = np.random.default_rng([o.seed if seed is None else seed, 6])
    base = model.measure(o)
    level = o.water_level if o.water_level is not None else model.water_level
    totals, indices, states = [], [], []
    for _ in range(number):
        noise = sd * _field(rng, model.grid, o.error_length)
        drawn = ReedModel(
            model.dsm.copy(data=(model.dsm.values + noise).astype(np.float32)),
            model.water_level,
            model.shoreline,
            areas=model.areas,
            transects=model.transects,
            spread=model.spread,
        )
        shifted = o.model_copy(update={"water_level": float(level or 0.0) + rng.normal(0, o.water_level_sd)})
        metrics = drawn.measure(shifted)
        totals.append(metrics.totals())
        indices.append(metrics.sections.arsi.to_numpy(dtype=float))
        states.append(metrics.sections.status.to_numpy())
    table = pd.DataFrame(totals)
    summary = pd.DataFrame(
        {
            "metric": table.columns,
            "value": list(base.totals().values()),
            "mean": table.mean().to_numpy(),
            "sd": table.std().to_numpy(),
            "p05": table.quantile(0.05).to_numpy(),
            "p95": table.quantile(0.95).to_numpy(),
        }
    )
    return Uncertainty(summary, _sections(base.sections, np.array(indices), np.array(states)), number)


def sensitivity(
    model: ReedModel,
    options: ReedParameters | None = None,
    *,
    thresholds: Sequence[str] = THRESHOLDS,
    factors: Sequence[float] = (0.5, 0.8, 0.9, 1.0, 1.1, 1.2, 2.0),
) -> pd.DataFrame:
    """Move one threshold at a time, and watch index and status.

    Returns
    -------
    DataFrame
        Long: ``threshold, factor, value, arsi_median`` (of sections with a finite index)``, stressed,
        excluded`` (sections)``, changed`` (sections whose status differs from the one at factor 1)
        ``, extent_m2, dense_m2, sparse_m2``.

    Raises
    ------
    ReedError
        If a threshold is not a number of the options.
    """
    o = options or ReedParameters()
    base = model.measure(o).sections.status.to_numpy()
    rows = []
    for name in thresholds:
        value = getattr(o, name, None)
        if not isinstance(value, float):
            raise ReedError(f"'{name}' is no threshold of the reed metrics: choose from {THRESHOLDS}.")
        for factor in factors:
            moved = ReedParameters(**(o.model_dump() | {name: value * factor}))
            metrics = model.measure(moved)
            status, index = metrics.sections.status.to_numpy(), metrics.sections.arsi.to_numpy(dtype=float)
            finite = index[np.isfinite(index)]
            totals: Mapping[str, float] = metrics.totals()
            rows.append(
                {
                    "threshold": name,
                    "factor": factor,
                    "value": value * factor,
                    "arsi_median": float(np.median(finite)) if len(finite) else np.nan,
                    "stressed": int((status == STRESSED).sum()),
                    "excluded": int((status == EXCLUDED).sum()),
                    "changed": int((status != base).sum()),
                    **{key: totals[key] for key in ("extent_m2", "dense_m2", "sparse_m2")},
                }
            )
    return pd.DataFrame(rows)


def _spread(spread: xr.DataArray | float | None, grid: Grid) -> np.ndarray:
    """Standard deviation (rows, columns) of the surface, m."""
    if spread is None:
        return np.zeros(grid.shape)
    if isinstance(spread, xr.DataArray):
        values = match_grid(spread, grid).values.astype(float) if Grid.of(spread) != grid else spread.values
        values = np.array(values, dtype=float)
        known = np.isfinite(values)
        values[~known] = np.median(values[known]) if known.any() else 0.0
    else:
        values = np.full(grid.shape, float(spread))
    if np.any(values < 0):
        raise ReedError("The spread of the surface is negative: give standard deviations in metres.")
    return values


def _field(rng: np.random.Generator, grid: Grid, length: float) -> np.ndarray:
    """Gaussian field of unit variance whose correlation falls to exp(-1) at ``length``."""
    white = rng.standard_normal(grid.shape)
    sigma = length / grid.resolution / 2
    if sigma < 0.1:
        return white
    # White noise blurred by a Gaussian of sigma s has variance 1 / (4 pi s^2) and range 2 s.
    blurred = gaussian_filter(white, sigma, mode="wrap")
    return blurred / blurred.std()


def _sections(base: pd.DataFrame, indices: np.ndarray, states: np.ndarray) -> pd.DataFrame:
    table = pd.DataFrame(base[["aoi", "section", "arsi"]]).reset_index(drop=True)
    finite = np.where(np.isfinite(indices), indices, np.nan)
    count = np.isfinite(finite).sum(axis=0)
    filled = np.nan_to_num(finite)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(count > 0, filled.sum(axis=0) / count, np.nan)
        squares = np.where(np.isfinite(finite), (finite - mean) ** 2, 0).sum(axis=0)
        sd = np.where(count > 1, np.sqrt(squares / (count - 1)), np.nan)
    table["arsi_mean"], table["arsi_sd"] = mean, sd
    table["stressed"] = (states == STRESSED).mean(axis=0)
    table["excluded"] = (states == EXCLUDED).mean(axis=0)
    return table
