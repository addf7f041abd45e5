"""Numbers, sizes and spacings in virtual scenes follow what was asked for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from workbench.virtual.composition import ReedSpec, StandSpec, TerrainSpec
from workbench.virtual.forest import plant_stand
from workbench.virtual.light import light_at, sun_direction
from workbench.virtual.noise import fractal_field, gaussian_field
from workbench.virtual.particles import REED_CELL, ReedFields, stem_table
from workbench.virtual.reed_belt import density_at, height_above_water
from workbench.virtual.terrain import land_heights, level_border
from workbench.virtual.texture import NOISE, TILE, textures
from workbench.virtual.trees3d import COUNT, KIND, LINE, RA, RB, RC, Z, crown_radius, grow_tree

SQUARE = ((0.0, 0.0), (80.0, 0.0), (80.0, 80.0), (0.0, 80.0))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("density", "height"), [(2.0, 1.2), (60.0, 2.8)])
def test_stems_are_poisson_numbers_of_the_asked_density_and_height(seed, density, height):
    size = (160, 160)
    fields = ReedFields(
        np.full(size, density, dtype=np.float32),
        np.full(size, height, dtype=np.float32),
        np.full(size, 0.7, dtype=np.float32),
        np.zeros(size, dtype=np.float32),
        np.float32(0),
        np.float32(0),
        np.float32(REED_CELL),
        np.uint64(seed),
    )
    edge = size[0] * REED_CELL
    stems = stem_table(fields, (0, 0, edge, edge))
    expected = density * edge**2
    assert abs(len(stems) - expected) < 4 * np.sqrt(expected)
    per_plot = np.histogram2d(stems[:, 0], stems[:, 1], bins=int(edge), range=[[0, edge]] * 2)[0]
    # For Poisson numbers the variance equals the mean.
    assert per_plot.var() / per_plot.mean() == pytest.approx(1, abs=0.15)
    assert stems[:, 3].mean() == pytest.approx(height, rel=0.01)
    assert stems[:, 3].std() / height == pytest.approx(0.09, abs=0.01)
    assert stems[:, 4].mean() == pytest.approx(0.7, abs=0.03)


def test_part_of_a_reed_bed_has_the_same_stems_as_the_whole():
    size = (80, 80)
    fields = ReedFields(
        *(np.full(size, v, dtype=np.float32) for v in (40, 2.5, 0.5, 0)),
        np.float32(0),
        np.float32(0),
        np.float32(REED_CELL),
        np.uint64(9),
    )
    whole = stem_table(fields, (0, 0, 20, 20))
    part = stem_table(fields, (5, 5, 9, 12))
    inside = (whole[:, 0] >= 5) & (whole[:, 0] < 9) & (whole[:, 1] >= 5) & (whole[:, 1] < 12)
    np.testing.assert_array_equal(part, whole[inside])


def test_reed_is_tall_and_dense_in_shallow_and_low_and_sparse_in_deep_water():
    belt = ReedSpec(along=(0, 10), density=60, height=3.4, deepest=1.4)
    depth = np.linspace(-0.5, 1.39, 30)
    assert np.all(np.diff(density_at(belt, depth)) <= 0)
    assert np.all(np.diff(height_above_water(belt, depth)) <= 1e-12)
    assert density_at(belt, np.array([0.0, 1.3999, 1.41])) == pytest.approx([60, 15, 0], abs=0.01)
    assert height_above_water(belt, np.array([0.0, 1.4])) == pytest.approx([3.4, 0.75 * 3.4 - 1.4])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_stand_has_the_asked_numbers_heights_crowns_and_spacing(seed):
    stand = StandSpec(
        area=SQUARE,
        species_group="conifer",
        height=(22.0, 1.5),
        crown=(4.4, 0.4),
        spacing=4.0,
        clumping=0,
        admixture=0,
        understorey=100,
    )
    stems = plant_stand(stand, seed)
    canopy = [stem for stem in stems if not stem.understorey]
    expected = 80 * 80 * 2 / (np.sqrt(3) * 4.0**2)
    assert len(canopy) == pytest.approx(expected, rel=0.06)
    heights = np.array([stem.height for stem in canopy])
    assert heights.mean() == pytest.approx(22, abs=0.35)
    assert heights.std() == pytest.approx(1.5, rel=0.2)
    assert np.mean([stem.crown for stem in canopy]) == pytest.approx(4.4, abs=0.15)
    places = np.array([(stem.x, stem.y) for stem in canopy])
    nearest = cKDTree(places).query(places, k=2)[0][:, 1]
    assert 2.4 < nearest.mean() < 3.4
    assert 30 < len(stems) - len(canopy) < 100


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_tops_of_broadleaf_trees_stand_more_evenly_than_their_stems(seed):
    stand = StandSpec(area=SQUARE, species_group="broadleaf", age="middle", clumping=0.2, understorey=0)
    stems = plant_stand(stand, seed)
    places = np.array([(stem.x, stem.y) for stem in stems])
    shifts = np.array([stem.lean for stem in stems])
    inner = np.all((places > 8) & (places < 72), axis=1)
    stem_gaps, top_gaps = (
        cKDTree(points).query(points, k=2)[0][inner, 1] for points in (places, places + shifts)
    )
    # Clark and Evans compare the mean with that of random places, 1.87 at most on a triangular grid.
    random = 0.5 / np.sqrt(inner.sum() / 64**2)
    assert stem_gaps.mean() / random + 0.1 < top_gaps.mean() / random < 1.75
    assert np.hypot(*shifts.T).max() < 0.4 * 4.7 * 0.75 + 5 * 0.02 * 17.0


def test_hills_fade_into_the_plane_beyond_the_scene_and_nowhere_else():
    spec = TerrainSpec(base=50.0, relief=3.0, longest=20.0, slope=(0.1, 0.0))
    x, y = np.arange(-28.0, 88.5, 0.5), np.arange(-28.0, 68.5, 0.5)
    hills = land_heights(spec, x, y, 3)
    levelled = level_border(hills, spec, x, y, (60.0, 40.0))
    inside = np.ix_((y >= 0) & (y <= 40), (x >= 0) & (x <= 60))
    np.testing.assert_array_equal(levelled[inside], hills[inside])
    np.testing.assert_allclose(levelled[0], 50 + 0.1 * (x - x.mean()), atol=1e-9)
    assert np.ptp(levelled[:, 0]) < 1e-9 and np.ptp(levelled[:, -1]) < 1e-9


def test_clumping_opens_gaps():
    even, clumped = (
        len(plant_stand(StandSpec(area=SQUARE, species_group="broadleaf", clumping=c, understorey=0), 4))
        for c in (0, 1)
    )
    assert clumped / even == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize("group", ["broadleaf", "conifer"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_tree_has_its_height_its_crown_and_the_leaf_area(group, seed):
    form = grow_tree(group, 20.0, 6.0, np.random.default_rng(seed))
    leaves = form.clumps[form.clumps[:, KIND] != LINE]
    rise = np.abs(leaves[:, 5]) * leaves[:, RA] + np.sqrt(1 - leaves[:, 5] ** 2) * leaves[:, RC]
    assert np.max(leaves[:, Z] + rise) == pytest.approx(20.0, abs=1e-3)
    x, y = form.outline.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area == pytest.approx(np.pi * 9, rel=0.1)
    assert leaves[:, COUNT].min() > 0 and leaves[:, RB].min() > 0


def test_crown_model_is_a_cone_at_n_1_and_an_ellipsoid_at_n_2():
    t = np.linspace(0, 1, 11)
    np.testing.assert_allclose(crown_radius(t, 3.0, 1.0), 3 * (1 - t))
    np.testing.assert_allclose(crown_radius(t, 3.0, 2.0) ** 2 / 9 + t**2, 1, atol=1e-12)


def test_dead_tree_has_no_leaves():
    form = grow_tree("conifer", 15.0, 4.0, np.random.default_rng(1), dead=True)
    assert np.all(form.clumps[:, KIND] == LINE)


@pytest.mark.parametrize("seed", [1, 2])
def test_terrain_has_the_asked_mean_relief_and_slope(seed):
    axis = np.arange(0, 400, 2.0)
    spec = TerrainSpec(base=100.0, relief=1.5, longest=30.0, slope=(0.05, -0.02))
    heights = land_heights(spec, axis, axis, seed)
    assert heights.mean() == pytest.approx(100.0, abs=1e-6)
    x, y = np.meshgrid(axis, axis)
    basis = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    fit, *_ = np.linalg.lstsq(basis, heights.ravel(), rcond=None)
    assert fit[:2] == pytest.approx([0.05, -0.02], abs=0.006)
    assert (heights.ravel() - basis @ fit).std() == pytest.approx(1.5, rel=0.1)


def test_fields_have_unit_variance_and_do_not_depend_on_the_window():
    axis = np.arange(0, 500, 2.5)
    field = gaussian_field(axis[None, :], axis[:, None], 10.0, np.random.default_rng(3))
    assert field.std() == pytest.approx(1, abs=0.15)
    part = gaussian_field(axis[None, 40:60], axis[10:20, None], 10.0, np.random.default_rng(3))
    np.testing.assert_allclose(part, field[10:20, 40:60], atol=1e-9)
    rough = fractal_field(axis[None, :], axis[:, None], 40.0, 5.0, np.random.default_rng(3))
    assert rough.std() == pytest.approx(1, abs=0.25)


def test_every_texture_level_is_the_average_of_the_one_below():
    levels = textures()
    assert levels.values.shape[0] == 7
    for level in range(4):
        size = TILE >> level
        start = levels.starts[level]
        fine = levels.values[NOISE, start : start + size**2].reshape(size, size)
        start = levels.starts[level + 1]
        coarse = levels.values[NOISE, start : start + size**2 // 4].reshape(size // 2, size // 2)
        mean = fine.reshape(size // 2, 2, size // 2, 2).mean(axis=(1, 3))
        np.testing.assert_allclose(coarse, mean, atol=1e-5)


def test_sun_stands_where_almanacs_put_it():
    from datetime import UTC, datetime

    # Solstice noon on the meridian of Greenwich at 50 N: 90 - 50 + 23.44 degrees; equinox at the equator.
    east, north, up = sun_direction(datetime(2020, 6, 21, 12, 2, tzinfo=UTC), 0.0, 50.0)
    assert np.degrees(np.arcsin(up)) == pytest.approx(63.44, abs=0.05)
    assert north < 0 and abs(east) < 0.01
    east, _, up = sun_direction(datetime(2020, 3, 20, 6, 7, tzinfo=UTC), 0.0, 0.0)
    assert east == pytest.approx(1, abs=0.001) and abs(up) < 0.01
    light = light_at(datetime(2020, 6, 21, 12, 2, tzinfo=UTC), 0.0, 50.0)
    assert light.elevation == pytest.approx(63.44, abs=0.05)
    # White paper in full light: sun and sky add up to 1 in the green band.
    assert light.direct[1] * light.sun[2] + light.diffuse[1] == pytest.approx(1, abs=0.02)
