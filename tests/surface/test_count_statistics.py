import numpy as np
import pytest
from rasterio.crs import CRS

from workbench.errors import RasterError, SurfaceError
from workbench.rasters import Grid, new_raster
from workbench.surface.statistics import NO_CLASS, count_ratio_classes, count_statistics, ratio_classes


def raster(values, west=0.0):
    values = np.asarray(values)
    grid = Grid(CRS.from_epsg(32633), west, 10.0, 1.0, values.shape[1], values.shape[0])
    return new_raster(values, grid, name="count", units="1")


@pytest.mark.parametrize(
    ("count", "possible", "expected"),
    [(0, 7, 0), (1, 100, 1), (1, 10, 1), (11, 100, 2), (3, 10, 3), (7, 10, 7), (9, 10, 9), (91, 100, 10)]
    + [(5, 5, 10), (6, 5, 10), (0, 0, NO_CLASS), (2, 0, NO_CLASS), (1, 3, 4), (2, 3, 7), (29, 100, 3)],
)
def test_classes_of_v_are_exact_at_their_limits(count, possible, expected):
    assert ratio_classes(np.array([[count]]), np.array([[possible]]))[0, 0] == expected


def test_statistics_of_a_hand_made_case():
    count = raster([[0, 1, 2, 3], [4, 4, 0, 9]])
    possible = raster([[4, 4, 4, 4], [4, 4, 2, 0]])
    mask = raster([[1, 1, 0, 0], [0, 0, 1, 1]])
    result = count_statistics(count, possible, mask)
    summary = result.summary.set_index(["scope", "statistic"])
    assert summary.loc[("area", "count"), "cells"] == 7
    assert summary.loc[("area", "count"), "mean"] == pytest.approx(2.0)
    assert summary.loc[("area", "ratio"), "mean"] == pytest.approx((0.25 + 0.5 + 0.75 + 2) / 7)
    assert summary.loc[("area", "shortfall"), "range"] == 4
    assert summary.loc[("area", "shortfall"), "standard_deviation"] == pytest.approx(
        np.std([4, 3, 2, 1, 0, 0, 2])
    )
    assert summary.loc[("mask", "count"), "cells"] == 3
    histogram = result.histogram.set_index(["scope", "statistic", "value"])["cells"]
    assert histogram["area", "count", "0"] == 2 and histogram["area", "count", "4"] == 2
    assert histogram["area", "ratio", "(90,100]"] == 2 and histogram["mask", "ratio", "0"] == 2
    percent = result.histogram.groupby(["scope", "statistic"])["percent"].sum()
    assert percent.to_numpy() == pytest.approx(100)
    assert count_ratio_classes(count, possible).values.tolist() == [[0, 3, 5, 8], [10, 10, 0, NO_CLASS]]


def test_bad_counts_are_refused():
    good = raster([[1, 2]])
    with pytest.raises(SurfaceError, match="count layer"):
        count_statistics(raster([[-1, 2]]), good)
    with pytest.raises(SurfaceError, match="whole numbers"):
        count_statistics(raster([[0.5, 2]]), good)
    with pytest.raises(SurfaceError, match="No cell"):
        count_statistics(good, raster([[0, 0]]))
    with pytest.raises(RasterError, match="different grids"):
        count_statistics(good, raster([[1, 2]], west=5.0))
