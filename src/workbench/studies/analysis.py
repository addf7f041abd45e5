"""What a tidy table says: means with intervals, effects, interactions, the optimum, agreement of ranks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pandas as pd
from scipy import stats

from workbench.errors import StudyError

_TIDY = ("seed", "response", "value", "unit")


def factors_of(table: pd.DataFrame) -> list[str]:
    """Columns of a tidy table that are factors."""
    return [name for name in table.columns if name not in _TIDY]


def means(table: pd.DataFrame, response: str, *, level: float = 0.95) -> pd.DataFrame:
    """Mean of a response over seeds in every combination of levels, with Student's interval.

    Parameters
    ----------
    table
        Tidy table of a study.
    response
        Name of the response.
    level
        Confidence, 0..1.

    Returns
    -------
    DataFrame
        Factors, mean, low, high, seeds, unit. With one seed low and high are unknown (NaN).

    Raises
    ------
    StudyError
        If the table has no such response.
    """
    chosen = _of(table, response)
    factors = factors_of(table)
    rows = []
    for levels, group in chosen.groupby(factors, sort=False, dropna=False):
        values = group["value"].dropna().to_numpy()
        reach = float("nan")
        if len(values) > 1:
            reach = stats.t.ppf((1 + level) / 2, len(values) - 1) * stats.sem(values)
        mean = float(values.mean()) if len(values) else float("nan")
        rows.append([*levels, mean, mean - reach, mean + reach, len(values), group["unit"].iloc[0]])
    return pd.DataFrame(rows, columns=[*factors, "mean", "low", "high", "seeds", "unit"])


def effects(table: pd.DataFrame, response: str) -> pd.DataFrame:
    """How much of the variance of a response each factor, each pair of factors and the seeds explain.

    Sums of squares of an analysis of variance of the cell means, exact for full designs.

    Returns
    -------
    DataFrame
        source (a factor, ``a x b``, or ``seeds``), share (0..1 of the whole), range (of the means of the
        levels; NaN for interactions and seeds).
    """
    chosen = _of(table, response).dropna(subset=["value"])
    factors = [f for f in factors_of(table) if chosen[f].nunique() > 1]
    values = chosen["value"].to_numpy()
    total = float(((values - values.mean()) ** 2).sum())
    rows: list[tuple[str, float, float]] = []
    main = {}
    for factor in factors:
        group = chosen.groupby(factor)["value"].transform("mean").to_numpy()
        main[factor] = group - values.mean()
        of_levels = chosen.groupby(factor)["value"].mean()
        rows.append((factor, float((main[factor] ** 2).sum()), float(np.ptp(of_levels))))
    for a, b in itertools.combinations(factors, 2):
        both = chosen.groupby([a, b])["value"].transform("mean").to_numpy() - values.mean()
        rows.append((f"{a} x {b}", float(((both - main[a] - main[b]) ** 2).sum()), float("nan")))
    cell = chosen.groupby(factors)["value"].transform("mean").to_numpy() if factors else values.mean()
    rows.append(("seeds", float(((values - cell) ** 2).sum()), float("nan")))
    return pd.DataFrame(
        [(name, square / total if total else 0.0, span) for name, square, span in rows],
        columns=["source", "share", "range"],
    )


def optimum(
    table: pd.DataFrame,
    response: str,
    *,
    best: Literal["lowest", "highest"],
    samples: int = 1000,
    seed: int = 1,
) -> pd.DataFrame:
    """Which combination is best, and how sure that is: the share of bootstrap samples it wins.

    Seeds are drawn with replacement; with one seed every combination wins or loses for sure, and the
    share says nothing.

    Returns
    -------
    DataFrame
        Factors, mean, wins (0..1), best first.
    """
    chosen = _of(table, response)
    factors = factors_of(table)
    wide = chosen.pivot_table(index=factors, columns="seed", values="value", sort=False, dropna=False)
    values = wide.to_numpy() * (1 if best == "lowest" else -1)
    rng = np.random.default_rng(seed)
    wins = np.zeros(len(wide))
    for _ in range(samples):
        drawn = values[:, rng.integers(0, values.shape[1], values.shape[1])]
        with np.errstate(invalid="ignore"):
            score = np.where(np.isnan(drawn).all(axis=1), np.inf, np.nan_to_num(drawn).mean(axis=1))
        wins[int(np.argmin(score))] += 1
    result = wide.mean(axis=1).rename("mean").reset_index().assign(wins=wins / samples)
    return result.sort_values("mean", ascending=best == "lowest", ignore_index=True)


def beside_published(
    ours: pd.DataFrame, published: pd.DataFrame, keys: Sequence[str], value: str
) -> tuple[pd.DataFrame, float, float]:
    """Simulated and published values side by side, with the agreement of their ranks.

    Parameters
    ----------
    ours
        Columns ``keys`` and ``mean``.
    published
        Columns ``keys`` and ``value``.
    keys
        What identifies a row in both.
    value
        Column of the published value.

    Returns
    -------
    table
        keys, published, simulated.
    rho
        Spearman's rank correlation, NaN below three rows.
    p
        Its two-sided probability without a relation.
    """
    merged = published[[*keys, value]].merge(ours[[*keys, "mean"]], on=list(keys), how="inner")
    merged = merged.rename(columns={value: "published", "mean": "simulated"})
    if len(merged) < 3:
        return merged, float("nan"), float("nan")
    rho, p = stats.spearmanr(merged["published"], merged["simulated"])
    return merged, float(rho), float(p)


def _of(table: pd.DataFrame, response: str) -> pd.DataFrame:
    chosen = table[table["response"] == response]
    if chosen.empty:
        names = ", ".join(sorted(table["response"].unique())[:40])
        raise StudyError(f"The table has no response {response!r}, but {names}.")
    return chosen
