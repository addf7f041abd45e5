"""Rules of the findings of the reed paper."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy import stats

from workbench.studies.findings import Criterion, Evidence, rule

_USUAL = {"flight": "nadir 3 m/s"}
_REED = "aquatic reed"


@rule(
    "R01",
    "total RMSE between 0.35 and 1.05 m (the range of the 14 areas), total R2 above 0.4",
    "RMSE 0.70 m (0.39-1.04), R2 0.60",
)
def r01(e: Evidence) -> Iterator[Criterion]:
    rmse = e.values("reed", "heights.total.rmse", **_USUAL)
    yield Criterion("RMSE", rmse, ">", 0.35, "m")
    yield Criterion("RMSE", rmse, "<", 1.05, "m")
    yield Criterion("R2", e.values("reed", "heights.total.r2", **_USUAL), ">", 0.4)


@rule("R02", "slope of surface on field height below 1 and intercept above 0", "figure 8 of the paper")
def r02(e: Evidence) -> Iterator[Criterion]:
    yield Criterion("slope", e.values("reed", "heights.total.slope", **_USUAL), "<", 1.0)
    yield Criterion("intercept", e.values("reed", "heights.total.intercept", **_USUAL), ">", 0.0, "m")


@rule(
    "R03",
    "rank correlation of water depth with field height, surface height and stems per m2 below -0.3",
    "stated in words",
)
def r03(e: Evidence) -> Iterator[Criterion]:
    for name, what in (("field", "field height"), ("surface", "surface height"), ("stems", "stems")):
        yield Criterion(f"depth and {what}", e.values("reed", f"depth_rank_{name}", **_USUAL), "<", -0.3)


@rule(
    "R04",
    "kappa of extent above 0.6, user accuracy of reed above its producer accuracy",
    "overall 88.35 %, kappa 0.77, producer 85 %, user 91 %",
)
def r04(e: Evidence) -> Iterator[Criterion]:
    yield Criterion("kappa", e.values("reed", "extent_matrix.kappa", **_USUAL), ">", 0.6)
    user = e.values("reed", f"extent_matrix.user_accuracy.{_REED}", **_USUAL)
    producer = e.values("reed", f"extent_matrix.producer_accuracy.{_REED}", **_USUAL)
    yield Criterion("user minus producer accuracy", 100 * (user - producer), ">", 0.0, "points")


@rule(
    "R05",
    "density is classified worse than extent, and sparse reed has the lowest producer accuracy",
    "overall 60.61 %, kappa 0.41, producer accuracy of sparse 34 %",
)
def r05(e: Evidence) -> Iterator[Criterion]:
    extent = e.values("reed", "extent_matrix.overall_accuracy", **_USUAL)
    density = e.values("reed", "density_matrix.overall_accuracy", **_USUAL)
    yield Criterion("overall accuracy, extent minus density", 100 * (extent - density), ">", 0.0, "points")
    accuracy = {
        name: e.values("reed", f"density_matrix.producer_accuracy.{name}", **_USUAL)
        for name in ("sparse reed", "dense reed", "water")
    }
    others = pd.concat([accuracy["dense reed"], accuracy["water"]], axis=1).min(axis=1)
    worst = 100 * (others - accuracy["sparse reed"])
    yield Criterion("producer accuracy, lower of the others minus sparse", worst, ">", 0.0, "points")


@rule(
    "R06",
    "overall accuracy of status above 70 %, producer accuracy of healthy above that of stressed",
    "overall 81.20 %, kappa 0.61, producer 92 % healthy, 67 % stressed",
)
def r06(e: Evidence) -> Iterator[Criterion]:
    overall = e.values("reed", "status_matrix.overall_accuracy", **_USUAL)
    yield Criterion("overall accuracy", 100 * overall, ">", 70.0, "%")
    healthy = e.values("reed", "status_matrix.producer_accuracy.healthy", **_USUAL)
    stressed = e.values("reed", "status_matrix.producer_accuracy.stressed", **_USUAL)
    yield Criterion(
        "producer accuracy, healthy minus stressed", 100 * (healthy - stressed), ">", 0.0, "points"
    )


@rule("R07", "RMSE at 6 m/s above RMSE in calm air", "stated in words")
def r07(e: Evidence) -> Iterator[Criterion]:
    windy = e.values("reed", "heights.total.rmse", flight="nadir 6 m/s")
    calm = e.values("reed", "heights.total.rmse", flight="nadir calm")
    yield Criterion("RMSE, 6 m/s minus calm", windy - calm, ">", 0.0, "m")


@rule(
    "R08", "rank correlation of mapped sinuosity with the fray of the true front above 0.5", "stated in words"
)
def r08(e: Evidence) -> Iterator[Criterion]:
    scenes = e.design("reed")["study"]["scenes"]
    fray = {belt["aoi"]: belt["fray"] for scene in scenes.values() for belt in scene["reed"]}
    mapped = pd.DataFrame({aoi: e.values("reed", f"sinuosity.{aoi}", **_USUAL) for aoi in fray})
    ranks = [stats.spearmanr(row, [fray[aoi] for aoi in mapped]).statistic for row in mapped.to_numpy()]
    yield Criterion("sinuosity and fray over areas", np.array(ranks), ">", 0.5)


@rule(
    "R09",
    "with three cameras more of the reed is covered, and the RMSE of its heights is smaller",
    "stated in words",
)
def r09(e: Evidence) -> Iterator[Criterion]:
    three, one = {"flight": "3K 3 m/s"}, _USUAL
    covered = e.values("reed", "coverage_reed", **three) - e.values("reed", "coverage_reed", **one)
    yield Criterion("coverage of reed, three cameras minus nadir", covered, ">", 0.0, "points")
    rmse = e.values("reed", "heights.total.rmse", **one) - e.values("reed", "heights.total.rmse", **three)
    yield Criterion("RMSE, nadir minus three cameras", rmse, ">", 0.0, "m")


@rule(
    "R10",
    "over the three ground resolutions the best cut of variance or of aRSI takes more than one value "
    "(mean over seeds above 1.5 values)",
    "stated in words",
)
def r10(e: Evidence) -> Iterator[Criterion]:
    different = [
        _different_optima(e, "reed.variance_cut", "reed.arsi_cut", "density_matrix.overall_accuracy"),
        _different_optima(e, "reed.arsi_cut", "reed.variance_cut", "status_matrix.overall_accuracy"),
    ]
    most = pd.concat(different, axis=1).max(axis=1)
    yield Criterion("different best cuts over ground resolution", most, ">", 1.5)


def _different_optima(e: Evidence, cut: str, other: str, response: str) -> pd.Series:
    """By seed: how many different values of a cut are best at some ground resolution."""
    table = e.table("thresholds")
    chosen = table[(table["response"] == response) & (table[other] == _published_cut(table, other))]
    best = chosen.loc[chosen.groupby(["seed", "gsd_cm"])["value"].idxmax()]
    return best.groupby("seed")[cut].nunique()


def _published_cut(table: pd.DataFrame, cut: str) -> float:
    """The authors' cut, 0.1 m² and 8."""
    return {"reed.variance_cut": 0.1, "reed.arsi_cut": 8.0}[cut]


RULES = (r01, r02, r03, r04, r05, r06, r07, r08, r09, r10)
