"""Wind between exposures, resolution, tiles and threads of virtual photographs."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numba
import numpy as np
import pytest

from workbench.cameras import Camera, Pose
from workbench.errors import SceneError
from workbench.virtual.composition import SceneSpec
from workbench.virtual.render import render
from workbench.virtual.scene import build_scene
from workbench.virtual.wind import Wind, displacement, own_sway, wind_field
from workbench.virtual.world import Cover

NOON = datetime(2020, 6, 21, 11, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def grove():
    """A lake with reed, a meadow and a few trees of both groups on 24 m x 24 m."""
    square = [(0, 0), (24, 0), (24, 10), (0, 10)]
    spec = SceneSpec(
        name="grove",
        seed=5,
        crs="EPSG:25832",
        vertical_datum="DHHN2016",
        origin=(600000.0, 5300000.0),
        size=(24.0, 24.0),
        terrain={"base": 101.0, "relief": 0.1, "longest": 15.0},
        lake={"level": 100.0, "outline": [(-20, 16), (50, 16), (50, 60), (-20, 60)]},
        reed=[{"along": (25, 38), "width": 5.0}],
        stands=[
            {
                "area": square,
                "species_group": "broadleaf",
                "age": "young",
                "admixture": 0.4,
                "height": (7.0, 0.5),
            }
        ],
    )
    return build_scene(spec)


def _camera(gsd: float, edge: int) -> Camera:
    return Camera("plain", edge, edge, 100 / gsd, 100 / gsd, edge / 2, edge / 2, (0.02, -0.01))


def _pose() -> Pose:
    return Pose.from_omega_phi_kappa((600012.0, 5300010.0, 201.0), 1.0, 2.0, 10.0)


def test_tiles_and_threads_change_nothing(grove):
    camera = _camera(0.1, 200)
    whole = render(grove, camera, _pose(), time=NOON, tile=256, threads=1)
    parts = render(grove, camera, _pose(), time=NOON, tile=52, threads=2)
    for name in ("radiance", "depth", "cover", "tree_id"):
        np.testing.assert_array_equal(whole[name].values, parts[name].values)


def test_calm_air_repeats_and_wind_does_not(grove):
    camera = _camera(0.1, 160)
    calm = [render(grove, camera, _pose(), time=NOON, exposure=k, wind=Wind.calm()) for k in (0, 9)]
    np.testing.assert_array_equal(calm[0].radiance.values, calm[1].radiance.values)
    windy = [
        render(grove, camera, _pose(), time=NOON + timedelta(seconds=2 * k), exposure=k) for k in (0, 1, 0)
    ]
    np.testing.assert_array_equal(windy[0].radiance.values, windy[2].radiance.values)
    change = np.abs(windy[0].radiance.values - windy[1].radiance.values).mean(axis=0)
    cover = windy[0].cover.values
    assert change[np.isin(cover, [Cover.BROADLEAF, Cover.CONIFER])].mean() > 0.02
    assert change[cover == Cover.REED].mean() > 0.01
    assert change[cover == Cover.WATER].mean() > 0.001
    # Sunlit meadow does not move; only the shadows on it do.
    assert (change[cover == Cover.MEADOW] < 0.002).mean() > 0.3


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_wind_has_the_amplitude_and_correlation_asked_for(seed):
    wind = Wind(crown_amplitude=0.3, seed=seed)
    axis = np.arange(0, 600, 3.0)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))
    moved = displacement(wind, 4, x, y, np.full(x.size, 20.0), 20.0)
    assert moved.std(axis=0) == pytest.approx([0.3, 0.3], rel=0.15)
    half = displacement(wind, 4, x[:50], y[:50], np.full(50, 10.0), 20.0)
    np.testing.assert_allclose(half, moved[:50] * 0.5**1.5, rtol=1e-4, atol=1e-6)
    field = moved[:, 0].reshape(axis.size, axis.size)
    field = field - field.mean()
    for lag in (3.0, 9.0, 24.0):
        step = int(lag / 3)
        found = (field[:, step:] * field[:, :-step]).mean() / field.var()
        expected = 0.6 * np.exp(-(lag**2) / (2 * 25**2)) + 0.4 * np.exp(-(lag**2) / (2 * 9**2))
        assert found == pytest.approx(expected, abs=0.12)


@pytest.mark.parametrize("seed", [1, 2])
def test_gusts_drift_with_the_wind_and_die_as_eddies_do(seed):
    wind = Wind(speed=4.0, direction=270.0, seed=seed)
    axis = np.arange(0, 900, 6.0)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))

    def east(seconds, drift=0.0):
        return displacement(wind, seconds, x + drift, y, np.full(x.size, 20.0), 20.0)[:, 0]

    now = east(1e9)
    # Life L / (0.4 speed): 15.6 s and 5.6 s; the air of a west wind goes 4 m east in a second.
    for seconds in (1.5, 6.0):
        carried = np.corrcoef(now, east(1e9 + seconds, drift=4.0 * seconds))[0, 1]
        expected = 0.6 * np.exp(-((seconds / 15.6) ** 2) / 2) + 0.4 * np.exp(-((seconds / 5.6) ** 2) / 2)
        assert carried == pytest.approx(expected, abs=0.08)
    stayed = np.corrcoef(now, east(1e9 + 6.0))[0, 1]
    assert stayed < carried - 0.2
    assert abs(np.corrcoef(now, east(1e9 + 60.0))[0, 1]) < 0.2


def test_trees_swing_near_their_natural_frequency():
    wind = Wind(sway_amplitude=0.1, seed=3)
    trees, height = 3000, 26.0

    def sway(seconds):
        return sway_of(wind_field(wind, 0, (0, 0, 1, 1), seconds=1e9 + seconds), trees, height)

    start = sway(0.0)
    assert start.std(axis=0) == pytest.approx([0.1, 0.1], rel=0.05)
    assert abs(start.mean()) < 0.01
    # A period is four seconds: back after one, on the other side after half of it, forgotten after a minute.
    alike = {t: np.corrcoef(start.ravel(), sway(t).ravel())[0, 1] for t in (2.0, 4.0, 60.0)}
    assert alike[2.0] < -0.8 and 0.6 < alike[4.0] < 0.95 and abs(alike[60.0]) < 0.1


@numba.njit
def sway_of(field, trees, height):
    found = np.empty((trees, 2))
    for plant in range(trees):
        found[plant] = own_sway(field, np.uint64(plant), height)
    return found


def test_displacement_does_not_depend_on_what_else_is_asked():
    wind = Wind()
    x, y, z = np.array([40.0, 200.0]), np.array([30.0, 90.0]), np.array([10.0, 10.0])
    both = displacement(wind, 1, x, y, z, 10.0)
    one = displacement(wind, 1, x[:1], y[:1], z[:1], 10.0)
    np.testing.assert_allclose(both[:1], one, atol=1e-6)


def test_a_coarse_photograph_is_the_average_of_a_fine_one(grove):
    fine = render(grove, _camera(0.05, 320), _pose(), time=NOON, wind=Wind.calm())
    coarse = render(grove, _camera(0.20, 80), _pose(), time=NOON, wind=Wind.calm())
    averaged = fine.radiance.values.reshape(4, 80, 4, 80, 4).mean(axis=(2, 4))
    difference = coarse.radiance.values - averaged
    # Lit meadow; what is lit is told from both, or the choice itself would make one the brighter.
    shady = (averaged[3] + coarse.radiance.values[3]) / 2 < 0.3
    cover = np.where(shady & (coarse.cover == Cover.MEADOW), 0, coarse.cover.values)
    assert abs(difference.mean()) < 0.05 * averaged.mean()
    for code, bias, spread in (
        (Cover.MEADOW, 0.03, 0.15),
        (Cover.WATER, 0.03, 0.10),
        (Cover.REED, 0.10, 0.30),
        (Cover.BROADLEAF, 0.10, 0.35),
    ):
        level = averaged[:, cover == code].mean()
        assert abs(difference[:, cover == code].mean()) < bias * level, code.name
        assert difference[:, cover == code].std() < spread * level, code.name


def test_vegetation_has_plausible_indices(grove):
    photograph = render(grove, _camera(0.1, 200), _pose(), time=NOON)
    red, green, blue, nir = photograph.radiance.values
    cover = photograph.cover.values
    ndvi, gli = (nir - red) / (nir + red), (2 * green - red - blue) / (2 * green + red + blue)
    for code, low, high in (
        (Cover.MEADOW, 0.45, 0.85),
        (Cover.BROADLEAF, 0.65, 0.95),
        (Cover.CONIFER, 0.65, 0.95),
        (Cover.REED, 0.25, 0.75),
    ):
        assert low < np.median(ndvi[cover == code]) < high, code.name
        assert np.median(gli[cover == code]) > 0.03, code.name
    assert np.median(ndvi[cover == Cover.WATER]) < 0.1


def test_water_glints_towards_the_sun_and_not_away_from_it(grove):
    east, north, _ = _sun(grove)
    light_azimuth = np.degrees(np.arctan2(east, north))
    lake = np.array([600000.0, 5300026.0, 100.0])
    levels = []
    for azimuth in (light_azimuth, light_azimuth + 180):
        # The camera stands opposite to where it looks, as high above the horizon as the sun.
        towards = np.radians(azimuth)
        slant = np.arcsin(_sun(grove)[2])
        back = np.array([np.sin(towards), np.cos(towards), 0]) * np.cos(slant)
        centre = lake - 60 * back + [0, 0, 60 * np.sin(slant)]
        camera = Camera("narrow", 40, 40, 800, 800, 20, 20)
        pose = Pose.from_roll_pitch_heading(centre, 0, 0, azimuth, tilt_forward=90 - np.degrees(slant))
        photograph = render(grove, camera, pose, time=NOON)
        water = photograph.cover.values == Cover.WATER
        assert water.mean() > 0.5
        levels.append(photograph.radiance.sel(band="nir").values[water].mean())
    assert levels[0] > 5 * levels[1]


def _sun(scene):
    from workbench.virtual.light import sun_direction

    return sun_direction(NOON, *scene.longitude_latitude)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bands": ("red", "thermal")}, "Bands"),
        ({"supersampling": 0}, "Supersampling"),
        ({"tile": 50}, "tile"),
        ({"time": datetime(2020, 6, 21, 0, 0, tzinfo=UTC)}, "sun stands"),
        ({"cloudiness": 2.0}, "Cloudiness"),
        ({"pose": Pose.from_omega_phi_kappa((600012.0, 5300005.0, 106.0), 0, 0, 0)}, "not above"),
        ({"pose": Pose.from_omega_phi_kappa((600012.0, 5300010.0, 201.0), 88, 0, 0)}, "horizon"),
    ],
)
def test_impossible_photographs_are_refused(grove, change, message):
    asked = {"pose": _pose(), "time": NOON} | change
    with pytest.raises(SceneError, match=message):
        render(grove, _camera(0.1, 40), **asked)


def test_impossible_wind_is_refused():
    with pytest.raises(SceneError, match="negative"):
        Wind(speed=-1)
