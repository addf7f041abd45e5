"""Error matrix: a classification against its reference, with every score and its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.stats import norm

from workbench.errors import AssessmentError


@dataclass(frozen=True, eq=False)
class ErrorMatrix:
    """Counts of classified against reference classes, and the scores that follow from them.

    Scores are fractions, NaN where their denominator is zero. Worked example, the extent of reed
    [reed paper, table 2]:

    >>> matrix = ErrorMatrix([[1150, 107], [208, 1239]], ["aquatic reed", "water"])
    >>> round(matrix.overall_accuracy, 4), round(matrix.kappa, 2)
    (0.8835, 0.77)
    """

    counts: np.ndarray
    """(classes, classes), rows classified, columns reference; counts or area-weighted counts, >= 0."""
    classes: tuple[str, ...]
    """Name of each class, in the order of rows and columns."""

    def __init__(self, counts: np.ndarray | Sequence[Sequence[float]], classes: Sequence[str]) -> None:
        values = np.asarray(counts, dtype=np.float64)
        names = tuple(str(name) for name in classes)
        if values.shape != (len(names), len(names)):
            raise AssessmentError(
                f"An error matrix of {len(names)} classes needs {len(names)} x {len(names)} counts, "
                f"not {' x '.join(map(str, values.shape))}."
            )
        if len(set(names)) != len(names):
            raise AssessmentError(f"Classes {names} repeat a name: give each class once.")
        if not np.all(np.isfinite(values)) or np.any(values < 0):
            raise AssessmentError(
                "Counts of an error matrix must be finite and not negative: "
                "leave unknown samples out before counting."
            )
        object.__setattr__(self, "counts", values)
        object.__setattr__(self, "classes", names)

    @property
    def total(self) -> float:
        """Number of samples."""
        return float(self.counts.sum())

    @property
    def overall_accuracy(self) -> float:
        """Share of samples on the diagonal [thesis 3.4.2]."""
        return _ratio(np.trace(self.counts), self.total)

    @cached_property
    def producer_accuracy(self) -> pd.Series:
        """Per class, share of the reference that was classified so: 1 - omission [thesis 3.4.2]."""
        return self._by_class(np.diag(self.counts), self._reference)

    @cached_property
    def user_accuracy(self) -> pd.Series:
        """Per class, share of the classified that is so in the reference: 1 - commission [thesis 3.4.2]."""
        return self._by_class(np.diag(self.counts), self._classified)

    @cached_property
    def in_class_accuracy(self) -> pd.Series:
        """Per class, right ones over right, missed and false ones together, 0..1.

        The formula printed in the thesis [3.4.2] leaves the right ones out of the denominator and so has
        no upper bound; with them the score is a share, as its name and the sentence before it say.
        """
        right = np.diag(self.counts)
        return self._by_class(right, self._classified + self._reference - right)

    @property
    def average_accuracy(self) -> float:
        """Mean of the user accuracies of all classes [thesis 3.4.2]; a class never classified is left out."""
        return float(self.user_accuracy.mean(skipna=True))

    @property
    def mean_accuracy(self) -> float:
        """Mean of overall and average accuracy [thesis 3.4.2]."""
        return (self.overall_accuracy + self.average_accuracy) / 2

    @property
    def kappa(self) -> float:
        """Agreement beyond chance: (overall - chance) / (1 - chance) [thesis 3.4.2].

        Where chance alone gives full agreement (one class only) the score is not defined: NaN.
        """
        chance = _ratio(float(self._classified @ self._reference), self.total**2)
        return _ratio(self.overall_accuracy - chance, 1 - chance)

    @cached_property
    def conditional_kappa(self) -> pd.Series:
        """Per class, agreement beyond chance among the samples classified so [thesis 4.4].

        With the user accuracy u and the share r of the class in the reference: (u - r) / (1 - r).
        """
        share = self._reference / self.total if self.total else np.full(len(self.classes), np.nan)
        return self._by_class(self.user_accuracy.to_numpy() - share, 1 - share)

    @property
    def kappa_sd(self) -> float:
        """Standard deviation of kappa over samples, by the delta method for multinomial counts."""
        n = self.total
        if n == 0 or np.isnan(self.kappa):
            return float("nan")
        p = self.counts / n
        rows, columns = p.sum(axis=1), p.sum(axis=0)
        agreement, chance = np.trace(p), float(rows @ columns)
        # Gradient of kappa with respect to every cell probability, then its variance over cells.
        gradient = np.eye(len(p)) / (1 - chance) - (1 - agreement) / (1 - chance) ** 2 * (
            columns[:, None] + rows[None, :]
        )
        mean = float((p * gradient).sum())
        variance = (float((p * gradient**2).sum()) - mean**2) / n
        return float(np.sqrt(max(variance, 0.0)))

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """All scores with confidence intervals, one a row.

        Accuracies: Wilson's interval of a binomial share; kappa: normal, with :attr:`kappa_sd`, cut at
        -1 and 1. Samples are taken as independent.

        Parameters
        ----------
        level
            Confidence, 0..1.

        Returns
        -------
        DataFrame
            Columns score, class (empty for a score of the whole), value, low, high.
        """
        right = np.diag(self.counts)
        rows = [("overall_accuracy", "", *_wilson(right.sum(), self.total, level))]
        for score, denominator in (("producer", self._reference), ("user", self._classified)):
            rows += [
                (f"{score}_accuracy", name, *_wilson(hit, of, level))
                for name, hit, of in zip(self.classes, right, denominator, strict=True)
            ]
        reach = norm.ppf((1 + level) / 2) * self.kappa_sd
        low, high = np.clip([self.kappa - reach, self.kappa + reach], -1, 1)
        rows.append(("kappa", "", self.kappa, float(low), float(high)))
        return pd.DataFrame(rows, columns=["score", "class", "value", "low", "high"])

    @property
    def scores(self) -> dict[str, object]:
        """Every score under its name, for a metrics file."""
        return {
            "samples": self.total,
            "overall_accuracy": self.overall_accuracy,
            "kappa": self.kappa,
            "agreement": verbal_agreement(self.kappa),
            "average_accuracy": self.average_accuracy,
            "mean_accuracy": self.mean_accuracy,
            "producer_accuracy": self.producer_accuracy.to_dict(),
            "user_accuracy": self.user_accuracy.to_dict(),
            "in_class_accuracy": self.in_class_accuracy.to_dict(),
            "conditional_kappa": self.conditional_kappa.to_dict(),
        }

    def to_frame(self) -> pd.DataFrame:
        """The counts as a table: rows classified, columns reference."""
        index = pd.Index(self.classes, name="classified")
        return pd.DataFrame(self.counts, index=index, columns=pd.Index(self.classes, name="reference"))

    def _repr_html_(self) -> str:
        summary = f"overall accuracy {self.overall_accuracy:.1%}, kappa {self.kappa:.2f}"
        return f"{self.to_frame().to_html()}<p>{summary}, {self.total:g} samples</p>"

    @property
    def _classified(self) -> np.ndarray:
        return self.counts.sum(axis=1)

    @property
    def _reference(self) -> np.ndarray:
        return self.counts.sum(axis=0)

    def _by_class(self, numerator: np.ndarray, denominator: np.ndarray) -> pd.Series:
        values = [_ratio(n, d) for n, d in zip(numerator, denominator, strict=True)]
        return pd.Series(values, index=pd.Index(self.classes, name="class"), dtype=float)


def error_matrix(
    classified: Sequence[object] | np.ndarray,
    reference: Sequence[object] | np.ndarray,
    classes: Sequence[object],
) -> ErrorMatrix:
    """Count samples by their classified and their reference class.

    Parameters
    ----------
    classified, reference
        (samples,) class of each sample; the same length.
    classes
        All classes, in the order of the matrix.

    Raises
    ------
    AssessmentError
        If lengths differ or a sample has a class that is not listed.
    """
    if len(classified) != len(reference):
        raise AssessmentError(
            f"{len(classified)} classified samples and {len(reference)} references: give one for each."
        )
    place = {name: index for index, name in enumerate(classes)}
    unknown = sorted({str(c) for c in (*classified, *reference) if c not in place})
    if unknown:
        raise AssessmentError(f"Samples of class {', '.join(unknown)}, but the classes are {list(classes)}.")
    counts = np.zeros((len(place), len(place)))
    np.add.at(counts, ([place[c] for c in classified], [place[r] for r in reference]), 1)
    return ErrorMatrix(counts, [str(name) for name in classes])


def verbal_agreement(kappa: float) -> str:
    """What a kappa is called [thesis table 3.1, after Monserud and Leemans 1992].

    A value on a border belongs to the better word; below zero there is no agreement.
    """
    if np.isnan(kappa):
        return "not defined"
    words = [word for start, word in _AGREEMENT if kappa >= start]
    return words[-1] if words else _AGREEMENT[0][1]


_AGREEMENT = (
    (0.0, "none"),
    (0.05, "very poor"),
    (0.2, "poor"),
    (0.4, "fair"),
    (0.55, "good"),
    (0.7, "very good"),
    (0.85, "excellent"),
    (0.99, "perfect"),
)


def _ratio(numerator: float, denominator: float) -> float:
    return float(numerator / denominator) if denominator > 0 else float("nan")


def _wilson(hits: float, of: float, level: float) -> tuple[float, float, float]:
    """Share with Wilson's interval: it stays within 0..1 and is not empty at 0 or 1."""
    if of == 0:
        return float("nan"), float("nan"), float("nan")
    z, share = norm.ppf((1 + level) / 2), hits / of
    centre = (share + z**2 / (2 * of)) / (1 + z**2 / of)
    reach = z / (1 + z**2 / of) * np.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    return float(share), float(max(centre - reach, 0.0)), float(min(centre + reach, 1.0))
