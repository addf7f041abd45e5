"""Published tables beside what our studies measured in the same cells, with rank correlations.

The counts of the thesis go as high as the number of photographs that see a place (5 at 80 %, 10 at 90 %),
ours as high as the number of their pairs, which is one less. So a published count of n >= 2 stands beside our
n - 1; a published count of 1, a photograph without a partner, has no counterpart and is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from workbench.studies.findings import Evidence, NotTestable

_THIN = {90: 1, 80: 2, 70: 3, 60: 4}
_Row = tuple[str, str, dict[str, Any], float]
"""Cell in words, our response, our levels, published value."""


@dataclass(frozen=True, eq=False)
class SideBySide:
    """One published table and our study of it."""

    table: str
    """As the paper numbers it."""
    study: str
    """Study that repeats it."""
    cells: pd.DataFrame
    """cell, published, simulated (mean over seeds); cells that the study left out are missing."""

    @property
    def rho(self) -> float:
        """Spearman's rank correlation over the cells; NaN below three or without any variation."""
        if len(self.cells) < 3 or self.cells[["published", "simulated"]].nunique().min() < 2:
            return float("nan")
        return float(stats.spearmanr(self.cells["published"], self.cells["simulated"]).statistic)

    @property
    def p(self) -> float:
        """Two-sided probability of such ranks without a relation."""
        if len(self.cells) < 3 or self.cells[["published", "simulated"]].nunique().min() < 2:
            return float("nan")
        return float(stats.spearmanr(self.cells["published"], self.cells["simulated"]).pvalue)


def side_by_side(root: Path = Path()) -> tuple[SideBySide, ...]:
    """Every published table whose study has been run below a root."""
    evidence = Evidence(root)
    found = []
    for table, study, rows in _TABLES:
        cells = []
        for cell, response, levels, published in rows(evidence):
            try:
                simulated = float(evidence.values(study, response, **levels).mean())
            except NotTestable:
                continue
            if np.isfinite(simulated):  # Correctness of no tops is not a number.
                cells.append((cell, published, simulated))
        if cells:
            frame = pd.DataFrame(cells, columns=["cell", "published", "simulated"])
            found.append(SideBySide(table, study, frame))
    return tuple(found)


def side_by_side_table(tables: Iterable[SideBySide]) -> pd.DataFrame:
    """All cells of all tables: table, study, cell, published, simulated."""
    parts = [part.cells.assign(table=part.table, study=part.study) for part in tables]
    columns = ["table", "study", "cell", "published", "simulated"]
    return pd.concat(parts)[columns] if parts else pd.DataFrame(columns=columns)


def _gsd_and_overlap(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_01_unmatched_gsd").to_dict("records"):
        levels = {"gsd_cm": row["gsd_cm"], "thin": _THIN[row["overlap_pct"]]}
        name = f"{row['gsd_cm']} cm, {row['overlap_pct']} %"
        yield name, "count_0_area", levels, row["count_zero_pct"]


def _strip_counts(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_02_counts_muenchen_strip").to_dict("records"):
        for overlap, thin in ((80, 1), (60, 2)):
            for title, scope, column in (("area", "area", "area"), ("trees", "mask", "treemask")):
                value = row[f"o{overlap}_{column}"]
                if value == value and row["count"] != 1:
                    name = f"count {row['count']}, {overlap} %, {title}"
                    yield name, f"count_{_pairs(row['count'])}_{scope}", {"thin": thin}, value


def _pairs(count: int) -> int:
    """Our count, of pairs, for a published count, of photographs."""
    return max(count - 1, 0)


def _across_munich(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_03_04_across_muenchen").to_dict("records"):
        levels = {
            "thin": {80: 1, 60: 2}[row["forward_pct"]],
            "strips": {80: 1, 60: 2, 40: 3}[row["side_pct"]],
            "match__across": row["across"],
        }
        name = f"{row['forward_pct']}/{row['side_pct']}{' across' if row['across'] else ''}"
        yield f"{name}, area", "count_0_area", levels, row["count_zero_area"]
        yield f"{name}, trees", "count_0_mask", levels, row["count_zero_treemask"]


def _focal_counts(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_05_06_counts_gleisdorf_strip").to_dict("records"):
        for flight in ("f210_o70", "f80_o80", "f80_o60"):
            for title, scope, column in (("area", "area", "area"), ("trees", "mask", "tree")):
                value = row[f"{column}_{flight}"]
                if value == value and row["count"] != 1:
                    levels = {"flight": flight, "place": "centre"}
                    name = f"count {row['count']}, {flight}, {title}"
                    yield name, f"count_{_pairs(row['count'])}_{scope}", levels, value


def _centre_and_edge(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_07_centre_edge").to_dict("records"):
        for focal, flight in ((210, "f210_o70"), (80, "f80_o80")):
            for place in ("centre", "edge"):
                value = row[f"f{focal}_{place}"]
                if value == value and row["count"] != 1:
                    levels = {"flight": flight, "place": place}
                    name = f"count {row['count']}, {focal} mm, {place}"
                    yield name, f"count_{_pairs(row['count'])}_mask", levels, value


def _across_gleisdorf(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_08_across_gleisdorf").to_dict("records"):
        flight = f"f{row['focal_mm']}_o{row['forward_pct']}"
        levels = {"flight": flight, "place": "block across" if row["across"] else "block"}
        name = f"{flight}{' across' if row['across'] else ''}"
        yield f"{name}, area", "count_0_area", levels, row["count_zero_area"]
        yield f"{name}, trees", "count_0_mask", levels, row["count_zero_treemask"]


def _direction(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_09_flight_direction_area").to_dict("records"):
        for direction in ("NS", "EW"):
            for overlap, thin in _THIN.items():
                value = row[f"{direction.lower()}{overlap}"]
                if value == value and row["count"] != 1:
                    levels = {"direction": direction, "thin": thin}
                    name = f"count {row['count']}, {direction} {overlap} %"
                    yield name, f"count_{_pairs(row['count'])}_area", levels, value


def _downscale(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_11_downscale").to_dict("records"):
        flight = f"f{row['focal_mm']}_o{row['forward_pct']}"
        levels = {"flight": flight, "match__downscales": str(row["downscale"])}
        name = f"{flight}, downscale {row['downscale']}"
        yield f"{name}, area", "count_0_area", levels, row["count_zero_area"]
        yield f"{name}, trees", "count_0_mask", levels, row["count_zero_treemask"]


def _inflight(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_12_inflight").to_dict("records"):
        levels = {"match__inflight": row["inflight"]}
        for title, scope, column in (("area", "area", "area"), ("trees", "mask", "treemask")):
            name = f"inflight {row['inflight']}, {title}"
            yield name, f"count_0_{scope}", levels, row[f"count_zero_{column}"]


def _stands(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_18_habichtswald").to_dict("records"):
        levels = {
            "stand": row["stand"],
            "parameters": "conifer" if row["stand"] == "conifer" else "broadleaf",
            "trees__max_slope": None,
            "trees__aspect": "never",
        }
        yield from _scores(row, row["stand"], levels)


def _tops_overlap(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_19_baruth").to_dict("records"):
        levels = {"gsd_cm": row["gsd_cm"], "thin": _THIN[row["overlap_pct"]]}
        yield from _scores(row, f"{row['gsd_cm']} cm, {row['overlap_pct']} %", levels)


def _tops_direction(e: Evidence) -> Iterator[_Row]:
    for row in e.published("tree_table4_20_murnau").to_dict("records"):
        levels = {
            "direction": row["direction"],
            "thin": _THIN[row["overlap_pct"]],
            "match__downscales": str(row["downscale"]),
        }
        name = f"{row['direction']} {row['overlap_pct']} %, downscale {row['downscale']}"
        yield from _scores(row, name, levels)


def _scores(row: Mapping[Any, Any], name: str, levels: dict[str, Any]) -> Iterator[_Row]:
    for score in ("completeness", "correctness"):
        yield f"{name}, {score}", f"{score}_visible", levels, row[f"{score}_pct"]


def _reed_matrices(e: Evidence) -> Iterator[_Row]:
    scores = e.published("error_matrix_scores")
    for row in scores[scores["source"] == "reed"].to_dict("records"):
        name = row["table"].split()[1]
        levels = {"flight": "nadir 3 m/s"}
        accuracy = row["overall_accuracy_pct"] / 100
        yield f"{name}, overall accuracy", f"{name}_matrix.overall_accuracy", levels, accuracy
        yield f"{name}, kappa", f"{name}_matrix.kappa", levels, row["kappa"]


_TABLES: tuple[tuple[str, str, Callable[[Evidence], Iterator[_Row]]], ...] = (
    ("thesis 4.1", "angle-gsd", _gsd_and_overlap),
    ("thesis 4.2", "overlap-strip", _strip_counts),
    ("thesis 4.3, 4.4", "side-overlap-across", _across_munich),
    ("thesis 4.5, 4.6", "focal-length", _focal_counts),
    ("thesis 4.7", "focal-length", _centre_and_edge),
    ("thesis 4.8", "focal-length", _across_gleisdorf),
    ("thesis 4.9", "direction", _direction),
    ("thesis 4.11", "downscale", _downscale),
    ("thesis 4.12", "inflight", _inflight),
    ("thesis 4.18", "tops", _stands),
    ("thesis 4.19", "tops-overlap", _tops_overlap),
    ("thesis 4.20", "tops-direction", _tops_direction),
    ("reed 2-4", "reed", _reed_matrices),
)
