"""Heights against true heights, by land cover."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from workbench.errors import AssessmentError
from workbench.rasters import Grid

NMAD = 1.4826
"""Median absolute deviation times this is the standard deviation of normal errors."""


def height_errors(
    measured: xr.DataArray,
    truth: xr.DataArray,
    cover: xr.DataArray | None = None,
    names: Mapping[int, str] | None = None,
    *,
    gross: float = 0.5,
) -> pd.DataFrame:
    """Errors of a surface, for all cells and by land cover.

    Parameters
    ----------
    measured, truth
        (y, x) heights on the same grid, metres, NaN = unknown.
    cover
        (y, x) integer code of land cover on that grid; None: only the row of all cells.
    names
        Name of each code; codes that are not named are left out.
    gross
        Errors above this are counted as gross, metres.

    Returns
    -------
    DataFrame
        A row per cover, the first for ``all``: cells (with truth), coverage (share measured), bias_m
        (median), nmad_m, rmse_m, p95_m (95 % of absolute errors are below), gross_share.

    Raises
    ------
    AssessmentError
        If grids differ.
    """
    if Grid.of(measured) != Grid.of(truth) or (cover is not None and Grid.of(cover) != Grid.of(measured)):
        raise AssessmentError(
            "Surface, truth and land cover lie on different grids: use rasters.match_grid first."
        )
    known = np.isfinite(truth.to_numpy())
    error = (measured.to_numpy() - truth.to_numpy())[known]
    rows = [_row("all", error, gross)]
    if cover is not None:
        code = cover.to_numpy()[known]
        rows += [
            _row(name, error[code == value], gross)
            for value, name in (names or {}).items()
            if np.any(code == value)
        ]
    return pd.DataFrame(rows)


def _row(name: str, error: np.ndarray, gross: float) -> dict[str, object]:
    found = error[np.isfinite(error)]
    row: dict[str, object] = {
        "cover": name,
        "cells": len(error),
        "coverage": len(found) / len(error) if len(error) else float("nan"),
    }
    if len(found) == 0:
        return row | dict.fromkeys(("bias_m", "nmad_m", "rmse_m", "p95_m", "gross_share"), float("nan"))
    middle = float(np.median(found))
    return row | {
        "bias_m": middle,
        "nmad_m": float(NMAD * np.median(np.abs(found - middle))),
        "rmse_m": float(np.sqrt(np.mean(found.astype(np.float64) ** 2))),
        "p95_m": float(np.quantile(np.abs(found), 0.95)),
        "gross_share": float(np.mean(np.abs(found) > gross)),
    }
