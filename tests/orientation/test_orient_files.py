"""Products read back, predictions, candidate pairs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flown_block import OFFSET  # type: ignore[import-not-found]

from workbench.errors import OrientationError
from workbench.orientation import predict_observation, read_block
from workbench.orientation.features import candidate_pairs
from workbench.orientation.files import round_model, write_model
from workbench.orientation.georeference import georeference
from workbench.orientation.quality import deformation, shape_warnings
from workbench.orientation.strayed import far_from_recorded
from workbench.params import OrientParameters
from workbench.site import Observation, Photograph

OPTIONS = OrientParameters(threads=1)


@pytest.fixture
def oriented(virtual_block, tmp_path):
    """A block written and read, at its true poses."""
    virtual = virtual_block(noise=0.0)
    round_model(virtual.model)
    write_model(virtual.model, tmp_path / "sparse")
    (tmp_path / "metrics.json").write_text(json.dumps({"offset": OFFSET.tolist()}), encoding="utf-8")
    return virtual, read_block(tmp_path, virtual.site)


def test_read_block_has_the_poses_in_the_site_crs(oriented):
    virtual, block = oriented
    assert [photograph.name for photograph in block] == sorted(virtual.poses)
    for photograph in block:
        pose = virtual.poses[photograph.name]
        np.testing.assert_allclose(photograph.pose.centre, pose.centre, atol=1e-5)
        np.testing.assert_allclose(photograph.pose.rotation, pose.rotation, atol=1e-8)
    assert len(block.tie_points) == virtual.model.num_points3D()
    assert np.abs(block.tie_points - virtual.points.mean(axis=0)).max() < 200


def test_rounding_hides_what_threads_disturb(virtual_block, tmp_path):
    """Models that differ by 1e-10 m are written alike."""
    written = []
    for name, noise in (("a", 0.0), ("b", 1e-10)):
        virtual = virtual_block(noise=0.0)
        for point in virtual.model.points3D.values():
            point.xyz = np.round(point.xyz, 4) + noise
        round_model(virtual.model)
        write_model(virtual.model, tmp_path / name)
        written.append((tmp_path / name / "points3D.bin").read_bytes())
    assert written[0] == written[1]


def test_prediction_from_two_measurements(oriented):
    virtual, block = oriented
    point = virtual.truth["P3"]
    seen = [p for p in block if p.sees(point[None])[0]]
    measured = [Observation("P3", p.name, *p.project(point[None])[0]) for p in (seen[0], seen[-1])]
    predicted = predict_observation(block, measured)
    assert set(predicted) == {p.name for p in seen}
    for photograph in seen:
        np.testing.assert_allclose(predicted[photograph.name], photograph.project(point[None])[0], atol=0.01)


def test_prediction_needs_two_photographs_of_one_point(oriented):
    _, block = oriented
    one = Observation("P", "0_0.jpg", 2000.0, 1500.0)
    with pytest.raises(OrientationError, match="measure it in two"):
        predict_observation(block, [one, Observation("P", "unknown.jpg", 1.0, 1.0)])
    with pytest.raises(OrientationError, match="several points"):
        predict_observation(block, [one, replace(one, name="Q")])


def test_missing_orientation_names_the_verb(virtual_block, tmp_path):
    from workbench.errors import SiteError

    folder = tmp_path / "products" / "virtual" / "orientation"
    folder.mkdir(parents=True)
    with pytest.raises(SiteError, match="workbench orient"):
        read_block(folder, virtual_block().site)


def test_candidates_are_neighbours_or_everything():
    row = tuple(Photograph(f"{k}", Path(f"{k}"), "cam", (10.0 * k, 0.0, 50.0)) for k in range(6))
    assert candidate_pairs(row, 2) == [(0, 1), (0, 2), (1, 2), (2, 3), (3, 4), (3, 5), (4, 5)]
    unplaced = tuple(replace(p, position=None) for p in row)
    assert len(candidate_pairs(unplaced, 2)) == 15


def test_doming_is_found_and_flat_residuals_are_not_accused(virtual_block):
    virtual = virtual_block(surveyed=20, control=4)
    fixed = georeference(virtual.model, virtual.site, OFFSET, OPTIONS)
    rows = fixed.residuals(virtual.model)
    assert not any("doming" in warning for warning in shape_warnings(rows, virtual.site.control))
    centre = np.mean([(p.x, p.y) for p in virtual.site.control], axis=0)
    place = {p.name: (p.x, p.y) for p in virtual.site.control}
    bowl = [replace(row, dz=row.dz + 1e-4 * float(np.sum((place[row.name] - centre) ** 2))) for row in rows]
    assert any("doming" in warning for warning in shape_warnings(bowl, virtual.site.control))


def test_tilt_and_scale_are_found_with_their_sizes(virtual_block):
    virtual = virtual_block(surveyed=20, control=4)
    fixed = georeference(virtual.model, virtual.site, OFFSET, OPTIONS)
    rows, points = fixed.residuals(virtual.model), virtual.site.control
    assert shape_warnings(rows, points) == []
    middle = np.mean([(p.x, p.y) for p in points], axis=0)
    place = {p.name: np.array([p.x, p.y]) - middle for p in points}
    tilted = [
        replace(row, dz=row.dz + 1e-3 * (0.6 * place[row.name][0] - 0.8 * place[row.name][1])) for row in rows
    ]
    found = deformation(tilted, points)
    assert (found.tilt_mrad, found.tilt_azimuth) == (pytest.approx(1.0, abs=0.3), pytest.approx(143, abs=15))
    assert any("tilt by" in warning and "rising to" in warning for warning in shape_warnings(tilted, points))
    long = [
        replace(row, dx=row.dx + 6e-4 * place[row.name][0], dy=row.dy + 6e-4 * place[row.name][1])
        for row in rows
    ]
    assert deformation(long, points).scale_ppm == pytest.approx(600, abs=120)
    assert any("parts in a million too long" in warning for warning in shape_warnings(long, points))


def test_a_photograph_far_from_its_record_is_named(virtual_block):
    virtual = virtual_block()
    assert far_from_recorded(virtual.model, virtual.site, OFFSET)[0] == {}
    moved = [
        replace(p, position=(p.position[0] + 30, *p.position[1:])) if p.name == "1_2.jpg" else p
        for p in virtual.site.photographs
    ]
    far, limit = far_from_recorded(virtual.model, replace(virtual.site, photographs=tuple(moved)), OFFSET)
    assert list(far) == ["1_2.jpg"]
    assert far["1_2.jpg"] == pytest.approx(30, abs=0.5)
    assert 1 <= limit < 5
