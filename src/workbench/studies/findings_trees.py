"""Rules of the findings of the thesis on single trees."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from workbench.cameras import intersection_angle
from workbench.studies.findings import Criterion, Evidence, Relation, rule

_GSDS = (9, 15, 20)
_THIN = {90: 1, 80: 2, 70: 3, 60: 4}
_AREA, _TREES = "count_0_area", "count_0_mask"
_POINTS = "points"


@rule("T01", "the formula gives every published angle within 0.1 degree", "Tables of angles, 10 rows")
def t01(e: Evidence) -> Iterator[Criterion]:
    cameras = {row["camera"]: row for row in e.published("cameras").to_dict("records")}
    worst = []
    for row in e.published("intersection_angles").to_dict("records"):
        camera = cameras["MACS Hale" if row["camera"].startswith("MACS") else row["camera"]]
        angle = intersection_angle(
            row["forward_overlap_pct"] / 100,
            camera["pixels_along"],
            camera["pixel_um"] * 1e-3,
            camera["focal_mm"],
        )
        worst.append(abs(angle - row["angle_deg"]))
    yield Criterion("largest difference", np.array([max(worst)]), "<", 0.1, "degree")


@rule(
    "T02",
    "rank correlation of the unmatched share with the angle above 0.8 at 9, 15 and 20 cm, and with the 12 "
    "cells of Table 4.1 above 0.8",
    "Table 4.1: 1.02 to 38.4 % at 9 cm, 0.02 to 3.7 % at 20 cm",
)
def t02(e: Evidence) -> Iterator[Criterion]:
    shares = {g: _over_overlap(e, "angle-gsd", _AREA, gsd_cm=g) for g in _GSDS}
    for gsd, table in shares.items():
        ranks = [_rank(row, range(len(row))) for row in table.to_numpy()]
        yield Criterion(f"rank correlation with the angle, {gsd} cm", np.array(ranks), ">", 0.8)
    published = e.published("tree_table4_01_unmatched_gsd").set_index(["gsd_cm", "overlap_pct"])
    known = [published["count_zero_pct"][g, overlap] for g in _GSDS for overlap in _THIN]
    ours = pd.concat([shares[g] for g in _GSDS], axis=1).to_numpy()
    ranks = [_rank(row, known) for row in ours]
    yield Criterion("rank correlation with the table", np.array(ranks), ">", 0.8)


@rule(
    "T03",
    "at every overlap the unmatched share falls (or stays) from 9 to 15 and from 15 to 20 cm, and falls at "
    "60 %",
    "Table 4.1, 60 %: 38.4, 10.2, 3.7 %",
)
def t03(e: Evidence) -> Iterator[Criterion]:
    for overlap, thin in _THIN.items():
        nine, fifteen, twenty = (e.values("angle-gsd", _AREA, gsd_cm=g, thin=thin) for g in _GSDS)
        relation: Any = ">" if overlap == 60 else ">="
        yield Criterion(f"{overlap} %, 9 minus 15 cm", nine - fifteen, relation, 0.0, _POINTS)
        yield Criterion(f"{overlap} %, 15 minus 20 cm", fifteen - twenty, relation, 0.0, _POINTS)


@rule(
    "T04",
    "slope of the unmatched share over the angle greater at 9 than at 15 and at 15 than at 20 cm",
    "Table 4.1: 4.7, 1.2, 0.46 points per degree",
)
def t04(e: Evidence) -> Iterator[Criterion]:
    slopes = {}
    for gsd in _GSDS:
        share = _over_overlap(e, "angle-gsd", _AREA, gsd_cm=gsd).to_numpy()
        angle = _over_overlap(e, "angle-gsd", "angle", gsd_cm=gsd).to_numpy()
        slopes[gsd] = np.array([np.polyfit(a, s, 1)[0] for a, s in zip(angle, share, strict=True)])
    unit = "points per degree"
    yield Criterion("slope, 9 minus 15 cm", slopes[9] - slopes[15], ">", 0.0, unit)
    yield Criterion("slope, 15 minus 20 cm", slopes[15] - slopes[20], ">", 0.0, unit)


@rule(
    "T05",
    "unmatched share in trees above that of the area at 80 and at 60 %",
    "Table 4.2: 6.4 against 6.0 %, 64 against 38 %",
)
def t05(e: Evidence) -> Iterator[Criterion]:
    for overlap, thin in ((80, 1), (60, 2)):
        trees, area = (e.values("overlap-strip", name, thin=thin) for name in (_TREES, _AREA))
        yield Criterion(f"{overlap} %, trees minus area", trees - area, ">", 0.0, _POINTS)


@rule(
    "T06",
    "unmatched share in trees at 19 degrees over that at 9.8 degrees above 5 (at least 0.1 % counts below)",
    "Table 4.2: 64.2 over 6.4 %",
)
def t06(e: Evidence) -> Iterator[Criterion]:
    near, far = (e.values("overlap-strip", _TREES, thin=thin) for thin in (1, 2))
    yield Criterion("ratio", far / near.clip(lower=0.1), ">", 5.0)


@rule(
    "T07",
    "at 80 % forward overlap the range over side overlaps is below a fifth of the jump of T06",
    "Table 4.3: 2.8 points, jump 57.8 points",
)
def t07(e: Evidence) -> Iterator[Criterion]:
    side = [_across(e, forward=1, strips=n, across=False) for n in (1, 2, 3)]
    span = pd.concat(side, axis=1).max(axis=1) - pd.concat(side, axis=1).min(axis=1)
    jump = (e.values("overlap-strip", _TREES, thin=2) - e.values("overlap-strip", _TREES, thin=1)).mean()
    yield Criterion("range over side overlaps over the jump", span / max(jump, 0.1), "<", 0.2)


@rule(
    "T08",
    "at 60 % forward overlap matching across leaves more than half of the unmatched share in trees",
    "Table 4.4: 51.1 of 45.9 %, 53.0 of 57.2 %",
)
def t08(e: Evidence) -> Iterator[Criterion]:
    for overlap, strips in ((60, 2), (40, 3)):
        with_, without = (_across(e, forward=2, strips=strips, across=flag) for flag in (True, False))
        yield Criterion(f"side {overlap} %, across over without", with_ / without.clip(lower=0.1), ">", 0.5)


@rule(
    "T09",
    "at 80 % forward overlap matching across changes the unmatched share in trees by less than 2 points",
    "Table 4.3: +0.4, -0.3, -0.6 points",
)
def t09(e: Evidence) -> Iterator[Criterion]:
    for overlap, strips in ((80, 1), (60, 2), (40, 3)):
        with_, without = (_across(e, forward=1, strips=strips, across=flag) for flag in (True, False))
        yield Criterion(f"side {overlap} %, change", (with_ - without).abs(), "<", 2.0, _POINTS)


@rule(
    "T10",
    "at the image edge the longer focal length leaves fewer unmatched in trees, and its edge loses less "
    "against its centre",
    "Table 4.7: edge minus centre 2.2 points (210 mm), 4.7 points (80 mm)",
)
def t10(e: Evidence) -> Iterator[Criterion]:
    short, long = (
        {place: e.values("focal-length", _TREES, flight=flight, place=place) for place in ("centre", "edge")}
        for flight in ("f80_o80", "f210_o70")
    )
    yield Criterion("edge, 80 minus 210 mm", short["edge"] - long["edge"], ">", 0.0, _POINTS)
    loss = (short["edge"] - short["centre"]) - (long["edge"] - long["centre"])
    yield Criterion("edge minus centre, 80 minus 210 mm", loss, ">", 0.0, _POINTS)


@rule(
    "T11",
    "unmatched share of the area differs by less than 1 point between the directions at every overlap",
    "Table 4.9: 0.4, 0.8, 0.9, 0.4 points",
)
def t11(e: Evidence) -> Iterator[Criterion]:
    for overlap, thin in _THIN.items():
        north, east = (e.values("direction", _AREA, direction=d, thin=thin) for d in ("NS", "EW"))
        difference = abs((north - east).mean())
        yield Criterion(f"{overlap} %, difference", np.array([difference]), "<", 1.0, _POINTS)


@rule(
    "T12",
    "in trees the unmatched share falls from downscale 1 to 2 and from 2 to 3 (or stays) at every flight, "
    "and the gain is greater at 60 than at 80 %",
    "Table 4.11: 17.6, 8.2, 4.8 % at 18.8 degrees; 1.4, 0.2, 0.1 % at 9.7",
)
def t12(e: Evidence) -> Iterator[Criterion]:
    gain = {}
    for flight in ("f80_o80", "f80_o60", "f210_o70"):
        one, two, three = (
            e.values("downscale", _TREES, flight=flight, match__downscales=d) for d in ("1", "2", "3")
        )
        gain[flight] = one - three
        yield Criterion(f"{flight}, downscale 1 minus 2", one - two, ">", 0.0, _POINTS)
        yield Criterion(f"{flight}, downscale 2 minus 3", two - three, ">=", 0.0, _POINTS)
    yield Criterion("gain, 60 minus 80 %", gain["f80_o60"] - gain["f80_o80"], ">", 0.0, _POINTS)


@rule(
    "T13",
    "in cells that downscale 1 left empty and 2 or 3 measured, interpolation has the larger RMSE, at every "
    "flight",
    "stated in words and profiles",
)
def t13(e: Evidence) -> Iterator[Criterion]:
    for flight in ("f80_o80", "f80_o60", "f210_o70"):
        fused, interpolated = (
            e.values("downscale", f"rmse_{name}", flight=flight, match__downscales="1 2 3")
            for name in ("fused", "interpolated")
        )
        yield Criterion(f"{flight}, interpolated minus fused", interpolated - fused, ">", 0.0, "m")


@rule(
    "T14",
    "with inflight 2 the unmatched share falls by less than 1 point, in the area and in trees",
    "Table 4.12: it rises by 1.4 and 3.7 points",
)
def t14(e: Evidence) -> Iterator[Criterion]:
    for name, response in (("area", _AREA), ("trees", _TREES)):
        one, two = (e.values("inflight", response, match__inflight=n) for n in (1, 2))
        yield Criterion(f"{name}, inflight 2 minus 1", two - one, ">", -1.0, _POINTS)


@rule(
    "T15",
    "the share of tree cells measured within 0.5 m of the truth is largest at 5.3 or 7.9 degrees, not at "
    "2.65 or 10.5, at more than half of 9, 15 and 20 cm",
    "optimum about 5 degrees, 5-10 usable",
)
def t15(e: Evidence) -> Iterator[Criterion]:
    best = [_over_overlap(e, "angle-gsd", "right_trees", gsd_cm=g).to_numpy().argmax(axis=1) for g in _GSDS]
    interior = np.isin(np.stack(best), (1, 2)).mean(axis=0)
    yield Criterion("share of ground resolutions with an interior optimum", interior, ">", 0.5)


@rule(
    "T16",
    "at 80 % fewer tree cells are unmatched at 15 than at 9 cm, and F1 of the tops is highest at 15 or "
    "20 cm, not at 9 or 30",
    "15-20 cm best; 30-50 cm loses heights",
)
def t16(e: Evidence) -> Iterator[Criterion]:
    nine, fifteen = (e.values("angle-gsd", _TREES, gsd_cm=g, thin=2) for g in (9, 15))
    yield Criterion("unmatched in trees, 9 minus 15 cm", nine - fifteen, ">", 0.0, _POINTS)
    f1 = {g: e.values("tops-overlap", "f1_visible", gsd_cm=g, thin=2) for g in (9, 15, 20, 30)}
    middle = pd.concat([f1[15], f1[20]], axis=1).max(axis=1)
    outer = pd.concat([f1[9], f1[30]], axis=1).max(axis=1)
    yield Criterion("F1, best of 15 and 20 minus best of 9 and 30 cm", middle - outer, ">", 0.0, _POINTS)


@rule(
    "T17",
    "each stand with its own parameters: conifer tops more complete and more correct than old and than young "
    "broadleaf",
    "90.0/98.3 % conifer, 80.8/84.7 % old, 82.0/79.2 % young broadleaf",
)
def t17(e: Evidence) -> Iterator[Criterion]:
    for score in ("completeness", "correctness"):
        conifer = _tops(e, "conifer", "conifer", f"{score}_visible")
        for stand in ("broadleaf old", "broadleaf young"):
            other = _tops(e, stand, "broadleaf", f"{score}_visible")
            yield Criterion(f"{score}, conifer minus {stand}", conifer - other, ">", 0.0, _POINTS)


@rule(
    "T18",
    "from 90 to 60 % completeness falls by more than 5 points at 9 cm, by less than 5 at 20 cm",
    "Table 4.19: 13.1 points at 9 cm, -3.5 at 20 cm",
)
def t18(e: Evidence) -> Iterator[Criterion]:
    relations: dict[int, Relation] = {9: ">", 20: "<"}
    for gsd, relation in relations.items():
        most, least = (
            e.values("tops-overlap", "completeness_visible", gsd_cm=gsd, thin=thin) for thin in (1, 4)
        )
        yield Criterion(f"{gsd} cm, 90 minus 60 %", most - least, relation, 5.0, _POINTS)


@rule(
    "T19",
    "range of correctness over the four overlaps below 3 points at 9, 15 and 20 cm",
    "Table 4.19: ranges 1.0, 0.3, 0.3 points",
)
def t19(e: Evidence) -> Iterator[Criterion]:
    for gsd in _GSDS:
        mean = _over_overlap(e, "tops-overlap", "correctness_visible", gsd_cm=gsd).mean()
        span = np.array([mean.max() - mean.min()])
        yield Criterion(f"{gsd} cm, range of the means", span, "<", 3.0, _POINTS)


@rule(
    "T20",
    "at 19 degrees completeness below 30 % with downscale 1, and more than 20 points higher with 2",
    "below 30 %, then 71-80 %",
)
def t20(e: Evidence) -> Iterator[Criterion]:
    one, two = (
        e.values(
            "tops-wide", "completeness_visible", thin=2, match__downscales=d, surface__interpolate="none"
        )
        for d in ("1", "2")
    )
    yield Criterion("completeness, downscale 1", one, "<", 30.0, "%")
    yield Criterion("completeness, downscale 2 minus 1", two - one, ">", 20.0, _POINTS)


@rule(
    "T21",
    "conifer parameters cost old broadleaf more than 10 points of correctness, broadleaf parameters cost "
    "conifers more than 10 points of completeness",
    "stated in words",
)
def t21(e: Evidence) -> Iterator[Criterion]:
    own, swapped = (_tops(e, "broadleaf old", p, "correctness_visible") for p in ("broadleaf", "conifer"))
    yield Criterion("correctness of old broadleaf, own minus conifer's", own - swapped, ">", 10.0, _POINTS)
    own, swapped = (_tops(e, "conifer", p, "completeness_visible") for p in ("conifer", "broadleaf"))
    yield Criterion("completeness of conifers, own minus broadleaf's", own - swapped, ">", 10.0, _POINTS)


@rule(
    "T22",
    "mean over the stands: completeness of tops from the unfiltered surface above that from the filtered",
    "stated in words",
)
def t22(e: Evidence) -> Iterator[Criterion]:
    gains = [
        _tops(e, stand, own, "completeness_visible") - _tops(e, stand, own, "completeness_filtered")
        for stand, own in _OWN.items()
    ]
    yield Criterion("unfiltered minus filtered", pd.concat(gains, axis=1).mean(axis=1), ">", 0.0, _POINTS)


@rule(
    "T23",
    "crown IoU: greater with the slope limit of 60 degrees (mean over stands); with aspect greater for "
    "conifers, smaller for broadleaf (mean of old and young)",
    "figures 4.37-4.41, no numbers",
)
def t23(e: Evidence) -> Iterator[Criterion]:
    slope = [_iou(e, stand, 60.0, "never") - _iou(e, stand, None, "never") for stand in _OWN]
    yield Criterion("slope minus none", pd.concat(slope, axis=1).mean(axis=1), ">", 0.0, _POINTS)
    aspect = {stand: _iou(e, stand, 60.0, "always") - _iou(e, stand, 60.0, "never") for stand in _OWN}
    yield Criterion("aspect minus none, conifer", aspect["conifer"], ">", 0.0, _POINTS)
    broadleaf = (aspect["broadleaf old"] + aspect["broadleaf young"]) / 2
    yield Criterion("aspect minus none, broadleaf", broadleaf, "<", 0.0, _POINTS)


@rule(
    "T24",
    "completeness of free-standing trees above that of the others, in both broadleaf scenes",
    "stated in words",
)
def t24(e: Evidence) -> Iterator[Criterion]:
    for stand in ("broadleaf old", "broadleaf young"):
        free, closed = (_tops(e, stand, "broadleaf", f"completeness_{part}") for part in ("free", "closed"))
        yield Criterion(f"{stand}, free minus closed", free - closed, ">", 0.0, _POINTS)


@rule(
    "T25",
    "downscale 1 at 19 degrees, holes interpolated: completeness where the true top lies in an interpolated "
    "cell below half of that where it was measured",
    "stated in words",
)
def t25(e: Evidence) -> Iterator[Criterion]:
    cell = {"thin": 2, "match__downscales": "1", "surface__interpolate": "linear"}
    inside, measured = (
        e.values("tops-wide", f"completeness_{part}", **cell) for part in ("interpolated", "measured")
    )
    # Where no top was found in measured cells either there is nothing to compare with.
    yield Criterion("interpolated over measured", inside / measured.where(measured > 0), "<", 0.5)


_OWN = {"conifer": "conifer", "broadleaf old": "broadleaf", "broadleaf young": "broadleaf"}
"""Stand of study ``tops`` and the parameters made for it."""


def _over_overlap(e: Evidence, study: str, response: str, **levels: Any) -> pd.DataFrame:
    """A row per seed, a column per overlap, 90 to 60 %: from the smallest angle to the largest."""
    columns = {overlap: e.values(study, response, thin=thin, **levels) for overlap, thin in _THIN.items()}
    return pd.DataFrame(columns)


def _across(e: Evidence, *, forward: int, strips: int, across: bool) -> pd.Series:
    cell = {"thin": forward, "strips": strips, "match__across": across}
    return e.values("side-overlap-across", _TREES, **cell)


def _tops(e: Evidence, stand: str, parameters: str, response: str) -> pd.Series:
    cell = {"stand": stand, "parameters": parameters, "trees__max_slope": None, "trees__aspect": "never"}
    return e.values("tops", response, **cell)


def _iou(e: Evidence, stand: str, slope: float | None, aspect: str) -> pd.Series:
    cell = {"stand": stand, "parameters": _OWN[stand], "trees__max_slope": slope, "trees__aspect": aspect}
    return e.values("tops", "crown_iou", **cell)


def _rank(values: Any, other: Any) -> float:
    """Spearman's correlation; 0 where all values are equal, because then they follow nothing."""
    values = np.asarray(values, dtype=float)
    return 0.0 if np.ptp(values) == 0 else float(stats.spearmanr(values, list(other)).statistic)


RULES = (
    *(t01, t02, t03, t04, t05, t06, t07, t08, t09, t10, t11, t12, t13),
    *(t14, t15, t16, t17, t18, t19, t20, t21, t22, t23, t24, t25),
)
