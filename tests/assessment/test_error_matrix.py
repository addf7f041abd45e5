"""Error matrices against the published scores, hand-made cases and a second tool."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from workbench.assessment import ErrorMatrix, error_matrix, verbal_agreement
from workbench.errors import AssessmentError

PUBLISHED = Path(__file__).parents[2] / "data" / "published"
MATRICES = pd.read_csv(PUBLISHED / "error_matrices.csv")
SCORES = pd.read_csv(PUBLISHED / "error_matrix_scores.csv")


def published(table: str) -> ErrorMatrix:
    rows = MATRICES[MATRICES.table == table]
    classes = list(dict.fromkeys(rows.classified))
    wide = rows.pivot(index="classified", columns="reference", values="count").loc[classes, classes]
    return ErrorMatrix(wide.to_numpy(), classes)


@pytest.mark.parametrize("row", SCORES.itertuples(), ids=lambda row: row.table)
def test_published_scores_follow_from_published_counts(row):
    matrix = published(row.table)
    accuracy_digits = len(str(row.overall_accuracy_pct).partition(".")[2])
    assert matrix.overall_accuracy * 100 == pytest.approx(
        row.overall_accuracy_pct, abs=0.5001 * 10**-accuracy_digits
    )
    assert round(matrix.kappa, 2) == row.kappa


@pytest.mark.parametrize(
    ("table", "kappa"), [("4.14 Baruth", 0.95), ("4.15 Muenchen", 0.93), ("4.17 Murnau", 1.0)]
)
def test_published_conditional_kappa_of_the_forest(table, kappa):
    assert round(published(table).conditional_kappa["forest"], 2) == kappa


def test_published_producer_and_user_accuracies():
    density = published("3 density")
    # The table gives 78 % for dense reed where the text says 73; the counts decide.
    assert round(density.producer_accuracy["dense"] * 100, 1) == 77.6
    baruth = published("4.14 Baruth")
    assert round(baruth.producer_accuracy["forest"] * 100, 1) == 89.7
    assert round(baruth.user_accuracy["forest"] * 100, 1) == 96.3
    assert round(baruth.user_accuracy["not forest"] * 100, 1) == 97.6


def test_verbal_scale_is_the_published_one():
    scale = pd.read_csv(PUBLISHED / "tree_kappa_scale.csv")
    for row in scale.itertuples():
        assert verbal_agreement((row.kappa_from + row.kappa_to) / 2) == row.agreement
        assert verbal_agreement(row.kappa_from) == row.agreement
    assert verbal_agreement(1.0) == "perfect"
    assert verbal_agreement(-0.2) == "none"
    assert verbal_agreement(float("nan")) == "not defined"


@pytest.mark.parametrize("table", SCORES.table)
def test_deviation_of_kappa_agrees_with_the_four_sums_of_congalton_and_green(table):
    matrix = published(table)
    n, p = matrix.total, matrix.counts / matrix.total
    row, column = p.sum(axis=1), p.sum(axis=0)
    t1, t2 = np.trace(p), row @ column
    t3 = np.diag(p) @ (row + column)
    t4 = sum(p[i, j] * (row[j] + column[i]) ** 2 for i in range(len(p)) for j in range(len(p)))
    variance = (
        t1 * (1 - t1) / (1 - t2) ** 2
        + 2 * (1 - t1) * (2 * t1 * t2 - t3) / (1 - t2) ** 3
        + (1 - t1) ** 2 * (t4 - 4 * t2**2) / (1 - t2) ** 4
    ) / n
    assert matrix.kappa_sd == pytest.approx(np.sqrt(variance), rel=1e-9, abs=1e-12)


def test_intervals_contain_the_score_as_often_as_they_say():
    rng = np.random.default_rng(1)
    truth = np.array([[0.45, 0.05], [0.1, 0.4]])
    population = ErrorMatrix(truth, "ab")
    inside = np.zeros(3)
    for _ in range(600):
        drawn = ErrorMatrix(rng.multinomial(300, truth.ravel()).reshape(2, 2), "ab").intervals(0.9)
        values = drawn.set_index(["score", "class"])
        for place, (score, name, value) in enumerate(
            [
                ("overall_accuracy", "", population.overall_accuracy),
                ("producer_accuracy", "b", population.producer_accuracy["b"]),
                ("kappa", "", population.kappa),
            ]
        ):
            row = values.loc[(score, name)]
            inside[place] += row.low <= value <= row.high
    # 600 draws: a right interval of 90 % is within 4 standard deviations (4.9 points) of it.
    assert np.all(np.abs(inside / 600 - 0.9) < 0.049)


def test_measures_of_the_thesis_by_hand():
    matrix = ErrorMatrix([[8, 2], [4, 6]], ["tree", "other"])
    assert matrix.in_class_accuracy["tree"] == pytest.approx(8 / (8 + 2 + 4))
    assert matrix.average_accuracy == pytest.approx((0.8 + 0.6) / 2)
    assert matrix.mean_accuracy == pytest.approx((0.7 + 0.7) / 2)


def test_samples_are_counted_by_rows_of_the_classified():
    matrix = error_matrix(["a", "a", "b"], ["a", "b", "b"], ["a", "b"])
    np.testing.assert_array_equal(matrix.counts, [[1, 1], [0, 1]])
    assert matrix.to_frame().index.name == "classified"


def test_classes_that_never_occur_have_no_accuracy_and_spoil_nothing():
    matrix = ErrorMatrix([[5, 0, 0], [1, 4, 0], [0, 0, 0]], ["a", "b", "c"])
    assert np.isnan(matrix.user_accuracy["c"])
    assert matrix.average_accuracy == pytest.approx((1 + 0.8) / 2)
    empty = ErrorMatrix(np.zeros((2, 2)), "ab")
    assert np.isnan(empty.kappa)
    assert np.isnan(empty.overall_accuracy)
    assert empty.intervals().value.isna().all()


@pytest.mark.parametrize(
    ("counts", "classes", "words"),
    [
        ([[1, 2]], ["a", "b"], "needs 2 x 2"),
        ([[1, 2], [3, -4]], ["a", "b"], "not negative"),
        ([[1, np.nan], [3, 4]], ["a", "b"], "finite"),
        ([[1, 2], [3, 4]], ["a", "a"], "repeat"),
    ],
)
def test_impossible_matrices_are_refused(counts, classes, words):
    with pytest.raises(AssessmentError, match=words):
        ErrorMatrix(counts, classes)


def test_samples_of_unknown_class_or_unequal_number_are_refused():
    with pytest.raises(AssessmentError, match="water"):
        error_matrix(["a", "water"], ["a", "a"], ["a"])
    with pytest.raises(AssessmentError, match="2 classified"):
        error_matrix(["a", "a"], ["a"], ["a"])
