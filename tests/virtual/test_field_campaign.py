"""The field campaign of a belt whose depth, density and height are known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from workbench.virtual.campaign import survey_reed
from workbench.virtual.composition import LakeSpec, ReedSpec, SceneSpec, TerrainSpec
from workbench.virtual.particles import stem_table
from workbench.virtual.scene import build_scene
from workbench.virtual.survey import scan_stems, survey_targets

LEVEL = 500.0


def shore(reed: tuple[ReedSpec, ...], **parts):
    lake = LakeSpec(
        level=LEVEL, outline=((-40, 20), (300, 20), (300, 90), (-40, 90)), bed_slope=0.08, deepest=3
    )
    return SceneSpec(
        name="belt",
        seed=7,
        crs="EPSG:25832",
        vertical_datum="DHHN2016",
        origin=(690000.0, 5300000.0),
        size=(220.0, 60.0),
        terrain=TerrainSpec(base=501.0, relief=0.1, step=0.5),
        lake=lake,
        reed=reed,
        **parts,
    )


@pytest.fixture(scope="module")
def scene():
    healthy = ReedSpec(aoi="1", along=(50, 150), width=14, fray=0.05, density=60, height=3.5)
    declining = ReedSpec(
        aoi="7", along=(160, 230), width=11, fray=0.9, density=30, height=3.0, islets=8, holes=8
    )
    targets = [{"name": f"T{i}", "x": 10.0 * i, "y": 8.0} for i in range(1, 10)]
    singles = [{"number": 25, "area": [[5, 1], [215, 1], [215, 14], [5, 14]], "height": [10, 18], "apart": 5}]
    return build_scene(
        SceneSpec(
            **(shore((healthy, declining)).model_dump() | {"targets": targets, "single_trees": singles})
        )
    )


@pytest.fixture(scope="module")
def campaign(scene):
    return survey_reed(scene, rng=np.random.default_rng(1))


def test_design_is_that_of_the_paper(scene, campaign):
    lines = campaign.true_transects
    assert lines.groupby("aoi").size().to_dict() == {"1": 11, "7": 8}
    assert campaign.true_sections.groupby("aoi").size().to_dict() == {"1": 10, "7": 7}
    of_first = lines[lines.aoi == "1"].geometry.tolist()
    gaps = [a.distance(b) for a, b in pairwise(of_first)]
    assert gaps == pytest.approx([10.0] * 10, abs=1e-6)
    for line in lines.geometry:
        water, shore_end = line.coords[0], line.coords[-1]
        assert scene.shoreline.buffer(0.01).covers(line)
        assert scene.ground_z(*np.array([water]).T)[0] < LEVEL - 0.5
        # At a right angle to the shore, which runs east.
        assert abs(shore_end[0] - water[0]) < 1e-6 and shore_end[1] < water[1]
    points = campaign.points
    first = points[(points.aoi == "1") & (points.transect == 1)]
    assert np.hypot(first.x.diff(), first.y.diff()).dropna().to_numpy() == pytest.approx(1.0, abs=0.002)
    # Belts taper off at their ends, where a transect may meet no reed.
    with_reed = points[points.n_stems > 0].groupby(["aoi", "transect"]).size()
    assert len(campaign.plots) == 2 * (with_reed >= 2).sum() >= 2 * 16


def test_readings_are_to_the_centimetre_and_true_to_the_stems(scene, campaign):
    points = campaign.points
    for column in ("stem_height_m", "water_depth_m"):
        values = points[column].dropna().to_numpy() * 100
        assert values == pytest.approx(values.round(), abs=1e-6)
    # At the place where it was measured, not where it was recorded, the stem stands.
    lines = campaign.true_transects.set_index(["aoi", "transect"]).geometry
    table = stem_table(scene.reed.fields, (0, 0, 220, 60))
    for row in points.iloc[::7].itertuples():
        line = lines[row.aoi, row.transect]
        place = np.array(line.interpolate(row.point - 1).coords[0])
        depth = max(LEVEL - float(scene.ground_z(place[:1], place[1:])[0]), 0)
        assert row.water_depth_m == pytest.approx(depth, abs=0.0051)
        away = np.hypot(*(table[:, :2] + scene.origin[:2] - place).T)
        assert row.n_stems == (away <= 0.5).sum()
        if row.n_stems:
            assert row.stem_height_m == pytest.approx(table[away.argmin(), 3] + depth, abs=0.0051)
        else:
            assert np.isnan(row.stem_height_m)


def test_stems_become_shorter_above_water_and_fewer_towards_the_deep(campaign):
    reed = campaign.points[(campaign.points.aoi == "1") & (campaign.points.n_stems > 0)]
    above = reed.stem_height_m - reed.water_depth_m
    shallow, deep = reed.water_depth_m < 0.3, reed.water_depth_m > 0.8
    assert above[shallow].mean() > above[deep].mean() + 0.5
    assert reed.n_stems[shallow].mean() > 1.3 * reed.n_stems[deep].mean()
    plots = campaign.plots[campaign.plots.aoi == "1"]
    assert (plots.green + plots.dead == plots.stems_per_m2).all()
    zones = plots.groupby("zone").stems_per_m2.mean()
    assert zones["inner"] > zones["outer"] > 5


def test_the_error_of_the_receiver_is_in_the_places_alone(scene):
    moved = []
    for seed in range(16):
        again = survey_reed(scene, rng=np.random.default_rng(seed))
        for true, recorded in zip(again.true_transects.geometry, again.transects.geometry, strict=True):
            moved.append(np.subtract(recorded.coords[0], true.coords[0]))
        if seed == 0:
            first = again
    # 304 transects: the root mean square is known to 4 %.
    assert np.sqrt((np.array(moved) ** 2).sum(axis=1).mean()) == pytest.approx(0.465, rel=0.12)
    assert again.points.stem_height_m.equals(first.points.stem_height_m)
    assert not again.points.x.equals(first.points.x)


def test_status_tells_a_vital_belt_from_a_declining_one(campaign):
    sections = campaign.true_sections.set_index("aoi")
    assert (sections.loc["1"].status == "healthy").mean() > 0.8
    assert (sections.loc["7"].status == "stressed").mean() > 0.8
    assert sections.loc["7"].sinuosity.median() > sections.loc["1"].sinuosity.median() >= 1
    assert (sections.loc["1"].islets == 0).all()


def test_targets_are_surveyed_with_the_stated_error(scene):
    off, roles = [], []
    for seed in range(60):
        points = survey_targets(scene, rng=np.random.default_rng(seed), sd_xy=0.02, sd_z=0.05)
        off += [
            (p.x - t.x, p.y - t.y, p.z - t.z) for p, t in zip(points, scene.targets.itertuples(), strict=True)
        ]
        roles = [p.role for p in points]
    assert np.std(off, axis=0) == pytest.approx([0.02, 0.02, 0.05], rel=0.1)
    assert roles.count("check") == 3 and roles.count("control") == 6


def test_scanned_stems_lead_to_the_tops(scene):
    trees = scan_stems(scene, rng=np.random.default_rng(2), sd=0.0)
    truth = scene.trees.set_index("tree_id").loc[trees.tree_id]
    assert (trees.dbh_m >= 0.2).all() and len(trees) > 3
    a = (truth.top_z.to_numpy() - trees.z1) / (trees.z2 - trees.z1)
    assert (trees.x1 + a * (trees.x2 - trees.x1)).to_numpy() == pytest.approx(
        truth.top_x.to_numpy(), abs=0.02
    )
    assert (trees.y1 + a * (trees.y2 - trees.y1)).to_numpy() == pytest.approx(
        truth.top_y.to_numpy(), abs=0.02
    )
    noisy = scan_stems(scene, rng=np.random.default_rng(2), sd=0.05)
    assert np.std(noisy.x1 - trees.x1) == pytest.approx(0.05, rel=0.5)


def test_a_scene_without_reed_has_an_empty_campaign():
    campaign = survey_reed(build_scene(shore(())), rng=np.random.default_rng(1))
    assert len(campaign.points) == len(campaign.transects) == len(campaign.status) == 0
