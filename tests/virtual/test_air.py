"""Air between ground and camera against its laws."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from workbench.virtual.air import VISIBILITY, air_of
from workbench.virtual.light import light_at

DOWN = np.array([0.0, 0.0, -1.0])
RED, GREEN, BLUE, NIR = range(4)


@pytest.fixture(scope="module")
def light():
    return light_at(datetime(2021, 6, 21, 11, tzinfo=UTC), 11.0, 48.0)


def test_contrast_falls_to_two_per_cent_at_the_visibility(light):
    extinction, _ = air_of(light, DOWN, 1.0)  # Near the ground.
    assert np.exp(-extinction[GREEN] * VISIBILITY) == pytest.approx(0.02, rel=0.01)


def test_whole_atmosphere_has_the_known_optical_depth(light):
    extinction, _ = air_of(light, DOWN, 1e6)
    # Molecules: 0.097 at 550 nm [Bodhaine et al. 1999, 288 K, sea level], aerosol of 1.2 km scale height.
    aerosol = (3.912 / VISIBILITY - 0.097 / 8000) * 1200
    assert extinction[GREEN] * 1e6 == pytest.approx(0.097 + aerosol, rel=0.05)


def test_veil_is_blue_grows_with_height_and_spares_drones(light):
    _, veil = air_of(light, DOWN, 1000.0)
    assert veil[BLUE] > veil[GREEN] > veil[RED] > 0
    reflectance = {height: air_of(light, DOWN, height)[1] * height for height in (50.0, 1000.0, 2000.0)}
    assert np.all(reflectance[50.0][:NIR] < 0.0025)
    assert 0.01 < reflectance[1000.0][BLUE] < 0.04
    assert np.all(reflectance[2000.0] > 1.3 * reflectance[1000.0])


def test_veil_is_brighter_with_a_low_sun_before_the_camera():
    light = light_at(datetime(2021, 6, 21, 16, 30, tzinfo=UTC), 11.0, 48.0)
    sun = np.array(light.sun)
    flat = np.array([sun[0], sun[1], 0.0]) / np.hypot(sun[0], sun[1])
    towards, away = (np.array([*(0.57 * s * flat[:2]), -0.82]) for s in (1, -1))
    assert np.all(air_of(light, towards, 1000.0)[1] > air_of(light, away, 1000.0)[1])
