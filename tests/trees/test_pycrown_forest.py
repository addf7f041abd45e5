"""A real forest from laser scanning (pycrown's example): tops and crowns end to end, where the data are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from workbench.figures import draw_surface, figure
from workbench.rasters import read_raster
from workbench.trees import crown_labels, find_tops, grow_crowns

ROOT = Path(__file__).parents[2]
FOREST = Path(os.environ.get("WORKBENCH_DATA", ROOT.parent / "shared" / "data")) / "pycrown_nz"
pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not FOREST.exists(), reason=f"the pycrown forest is not at {FOREST}"),
]


@pytest.fixture(scope="module")
def height():
    return read_raster(FOREST / "CHM.tif")


def test_tops_are_trees_of_this_forest(height):
    tops = find_tops(height)
    hectares = height.size * 1e-4
    # A closed stand of tall trees, with understorey in its gaps.
    assert 40 < len(tops) / hectares < 1250
    assert tops["height_m"].between(3, float(height.max())).all()
    assert float(height.max()) == pytest.approx(tops["height_m"].max())
    values = height.values[tops["row"], tops["column"]]
    np.testing.assert_allclose(values, tops["height_m"], rtol=1e-6)


def test_crowns_cover_what_is_high_enough_and_hold_their_tops(height):
    tops = find_tops(height)
    crowns = grow_crowns(tops, height)
    assert len(crowns) == len(tops)
    labels = crown_labels(tops, height).values
    np.testing.assert_array_equal(labels[tops["row"], tops["column"]], tops["tree_id"])
    assert np.mean(labels[height.values >= 3] > 0) > 0.9
    assert (labels[height.values < 3] == 0).all()
    for size in (64, 100):
        np.testing.assert_array_equal(crown_labels(tops, height, tile_size=size).values, labels)


def test_a_picture_of_them(height, tmp_path):
    tops = find_tops(height)
    made, axes = figure()
    draw_surface(axes, height)
    grow_crowns(tops, height).boundary.plot(ax=axes, color="white", linewidth=0.4)
    axes.plot(tops.geometry.x, tops.geometry.y, "r.", markersize=2)
    made.savefig(tmp_path / "forest.png")
    assert imread(tmp_path / "forest.png").std() > 0.05
