"""Parts of the report: numbers as text, error matrices, warnings with their remedy."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from workbench.figures.advice import advice
from workbench.figures.maps import hillshade
from workbench.figures.sections import Picture, facts, matrix_table, percent, written


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (float("nan"), "-"),
        (True, "yes"),
        (0.123456, "0.1235"),
        (123456.7, "123,457"),
        (12, "12"),
        ((1, 2.5), "1, 2.5"),
        ({"ds1": 0.5}, "ds1: 0.5"),
    ],
)
def test_numbers_as_a_reader_wants_them(value, text):
    assert written(value) == text


def test_facts_leave_out_what_is_not_known():
    table = facts({"a": 1, "b": None}, {"b": "second", "a": "first", "c": "third"}, title="T")
    assert list(table.rows) == [("first", "1")]
    assert table.title == "T"


def test_error_matrix_as_the_papers_print_it():
    scores = {
        "classes": ["reed", "water"],
        "counts": [[90, 10], [5, 95]],
        "user_accuracy": {"reed": 0.9, "water": 0.95},
        "producer_accuracy": {"reed": 90 / 95, "water": 95 / 105},
        "overall_accuracy": 0.925,
        "kappa": 0.85,
    }
    table = matrix_table(scores, "Extent")
    assert table.rows[0] == ["reed", "90", "10", "90.0 %"]
    assert table.rows[-1] == ["producer accuracy", "94.7 %", "90.5 %", ""]
    assert table.title == "Extent: overall accuracy 92.5 %, kappa 0.85."
    assert percent(float("nan")) == "-"


def test_warnings_come_with_a_remedy_and_only_where_they_apply():
    good = {"surface": {"coverage_ge1": 0.97, "coverage_ge2": 0.9}, "match": {"angle_median_deg": 8.0}}
    assert advice(good) == []
    bad = {
        "surface": {"coverage_ge1": 0.6, "coverage_ge2": 0.3, "ground_seen_share": 0.1},
        "match": {"angle_median_deg": 21.0},
        "trees": {"trees": 12},
    }
    found = advice(bad)
    assert len(found) == 4
    assert all("overlap" in text or "dtm" in text for text in found)
    assert advice({}) == []


def test_the_same_figure_gives_the_same_bytes():
    def draw():
        figure = Figure()
        figure.add_subplot().plot([1, 2], [3, 4])
        return Picture.of(figure, "a line").png

    assert draw() == draw()


def test_a_slope_to_the_light_is_bright():
    x, y = np.arange(5.0), np.arange(5.0)[::-1]
    rising_south_east = xr.DataArray(x[None, :] - y[:, None], dims=("y", "x"), coords={"y": y, "x": x})
    light = hillshade(rising_south_east)
    assert light.min() > 0.9 > hillshade(-rising_south_east).max()
