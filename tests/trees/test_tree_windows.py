"""Search windows: values, limits, and what is refused."""

from __future__ import annotations

import geopandas as gpd
import numpy as np
import pytest
from shapely.geometry import box
from tree_shapes import CRS, cones

from workbench.errors import TreesError
from workbench.trees import (
    CombinedWindow,
    ConstantWindow,
    FunctionWindow,
    GrowingWindow,
    StandWindow,
    find_tops,
)

HEIGHTS = np.array([3.0, 10.0, 20.0, 40.0])
NOWHERE = np.zeros(4)


@pytest.mark.parametrize(
    ("window", "radii"),
    [
        (ConstantWindow(1.5), [1.5, 1.5, 1.5, 1.5]),
        (GrowingWindow(0.5, 0.1, 1.0, 4.0), [1.0, 1.5, 2.5, 4.0]),
        (GrowingWindow(-1.0, 0.1, 0.5, 9.0), [0.5, 0.5, 1.0, 3.0]),
        (CombinedWindow((0.5, 2.0, 3.0), (0.0, 10.0, 25.0)), [0.5, 2.0, 2.0, 3.0]),
        (FunctionWindow(lambda h: 0.3 + 0.01 * h**1.5), 0.3 + 0.01 * HEIGHTS**1.5),
    ],
)
def test_radii_follow_the_stated_rule_and_stay_below_the_largest(window, radii):
    np.testing.assert_allclose(window.radii(HEIGHTS, NOWHERE, NOWHERE), radii)
    assert window.largest(40.0) >= max(radii)


def test_stands_have_windows_of_their_own():
    stands = gpd.GeoDataFrame(
        {"stand_type": ["conifer", "broadleaf", "heath"]},
        geometry=[box(0, 0, 10, 10), box(10, 0, 20, 10), box(20, 0, 30, 10)],
        crs=CRS,
    )
    window = StandWindow(
        stands, {"conifer": ConstantWindow(1.0), "broadleaf": ConstantWindow(3.0)}, ConstantWindow(2.0)
    )
    x = np.array([5.0, 15.0, 25.0, 99.0])
    np.testing.assert_array_equal(window.radii(HEIGHTS, x, np.full(4, 5.0)), [1, 3, 2, 2])
    assert window.largest(40.0) == 3.0


def test_conifer_window_on_a_broad_crown_gives_many_tops_and_the_broad_window_one():
    # A crown of 5 m radius whose branches end 2.5 m from the stem, a metre below the top.
    branches = [(12 + 2.5 * np.cos(a), 12 + 2.5 * np.sin(a), 19.0, 1.4) for a in np.arange(6) * np.pi / 3]
    surface = cones([(12.0, 12.0, 20.0, 2.0), *branches], 24)
    assert len(find_tops(surface, radius=1.0)) == 7
    assert len(find_tops(surface, radius=3.0)) == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda: ConstantWindow(0.0),
        lambda: ConstantWindow(float("nan")),
        lambda: GrowingWindow(growth=-0.1),
        lambda: GrowingWindow(smallest=3.0, limit=2.0),
        lambda: CombinedWindow((1.0, 2.0), (0.0,)),
        lambda: CombinedWindow((1.0, 2.0), (5.0, 5.0)),
        lambda: CombinedWindow((), ()),
        lambda: FunctionWindow(lambda h: h - 100).radii(HEIGHTS, NOWHERE, NOWHERE),
    ],
)
def test_impossible_windows_are_refused(make):
    with pytest.raises(TreesError):
        make()


def test_what_is_no_window_is_refused():
    surface = cones([(5.0, 5.0, 10.0, 2.0)], 10)
    with pytest.raises(TreesError, match="no search window"):
        find_tops(surface, radius="wide")
    with pytest.raises(TreesError, match="not both"):
        find_tops(surface, radius=1.0, window=ConstantWindow(1.0))
