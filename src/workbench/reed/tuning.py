"""Thresholds that agree best with references of some areas, to be tested on the others.

The authors expect that thresholds must be adjusted to other sensors, lakes and seasons [reed 2.5.3, 2.5.5].
Scores on the samples that chose a threshold say little: keep areas apart with :func:`of_areas`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from itertools import product

import numpy as np
import pandas as pd

from workbench.errors import ReedError
from workbench.params import ReedParameters
from workbench.reed.accuracy import References, agreements
from workbench.reed.measure import ReedModel
from workbench.reed.status import HEALTHY, STRESSED

MIN_HEIGHTS = tuple(np.round(np.arange(0.1, 1.51, 0.1), 2))
VARIANCE_CUTS = (0.002, 0.003, 0.005, 0.007, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5)
MEAN_CUTS = (1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0, 3.5)


def of_areas(references: References, areas: Collection[str]) -> References:
    """References of some areas of interest."""
    tables = (references.points, references.plots, references.status)
    return References(*(None if t is None else t[t.aoi.astype(str).isin(set(areas))] for t in tables))


def tune_thresholds(
    model: ReedModel,
    references: References,
    options: ReedParameters | None = None,
    *,
    min_heights: Sequence[float] = MIN_HEIGHTS,
    variance_cuts: Sequence[float] = VARIANCE_CUTS,
    mean_cuts: Sequence[float] = MEAN_CUTS,
) -> ReedParameters:
    """Best minimum height for the extent, then density cuts, then the aRSI cut.

    By overall accuracy; the aRSI cut by the mean of the producer's accuracies of healthy and stressed, so
    that areas with few stressed sections do not choose a cut that finds none elsewhere. Of equally good
    values the one nearest to that of ``options`` is taken; the aRSI cut lies in the middle between the two
    sections that it parts.

    Parameters
    ----------
    model
        Surface, water level and shoreline.
    references
        That choose; a step without its reference keeps the value of the options.
    options
        Values to begin with.
    min_heights, variance_cuts, mean_cuts
        That are tried.

    Raises
    ------
    ReedError
        If there is no reference at all.
    """
    o = options or ReedParameters()
    if references.points is None and references.plots is None and references.status is None:
        raise ReedError("There is no reference to tune thresholds with.")

    def score(name: str, **values: float) -> float:
        tried = ReedParameters(**(o.model_dump() | values))
        found = agreements(model.measure(tried), references, dense_stems=o.plot_dense_stems)
        return found[name].matrix.overall_accuracy

    if references.points is not None:
        best = _best([(h,) for h in min_heights], (o.min_height,), lambda h: score("extent", min_height=h))
        o = o.model_copy(update={"min_height": best[0]})
    if references.plots is not None:
        pairs = list(product(variance_cuts, mean_cuts))
        best = _best(
            pairs,
            (o.variance_cut, o.mean_cut),
            lambda v, m: score("density", variance_cut=v, mean_cut=m),
        )
        o = o.model_copy(update={"variance_cut": best[0], "mean_cut": best[1]})
    if references.status is not None:
        o = o.model_copy(update={"arsi_cut": _arsi_cut(model, references.status, o)})
    return o


def _best(
    tried: Sequence[tuple[float, ...]], start: tuple[float, ...], score: Callable[..., float]
) -> tuple[float, ...]:
    """Highest score; of ties the nearest to the start, by ratio."""
    scores = np.array([score(*values) for values in tried])
    ratios = np.abs(np.log(np.array(tried) / np.array(start))).sum(axis=1)
    ties = np.flatnonzero(scores >= scores.max() - 1e-12)
    return tried[int(ties[np.argmin(ratios[ties])])]


def _arsi_cut(model: ReedModel, status: pd.DataFrame, o: ReedParameters) -> float:
    sections = model.measure(o).sections
    left, right = (
        pd.DataFrame(frame[columns]).astype({"aoi": str, "section": int})
        for frame, columns in ((sections, ["aoi", "section", "arsi"]), (status, ["aoi", "section", "status"]))
    )
    both = left.merge(right, on=["aoi", "section"]).dropna(subset="arsi")
    values = np.unique(both.arsi[np.isfinite(both.arsi)])
    if len(values) < 2:
        return o.arsi_cut
    cuts = (values[1:] + values[:-1]) / 2
    said = both.arsi.to_numpy()[None, :] < cuts[:, None]
    classes = [(both.status == HEALTHY, said), (both.status == STRESSED, ~said)]
    found = [right[:, which.to_numpy()].mean(axis=1) for which, right in classes if which.any()]
    scores = dict(zip(cuts, np.mean(found, axis=0), strict=True))
    return float(_best([(c,) for c in cuts], (o.arsi_cut,), scores.__getitem__)[0])
