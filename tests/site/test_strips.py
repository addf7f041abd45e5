"""Flight strips: each pattern's strips are known because the pattern was drawn."""

import numpy as np
import pytest

from workbench.site import find_strips


def lawnmower(strips, per_strip, along=20.0, across=35.0, angle=0.0):
    """Positions flown back and forth, and the strip of each."""
    places, numbers = [], []
    for number in range(strips):
        steps = range(per_strip) if number % 2 == 0 else reversed(range(per_strip))
        places += [(step * along, number * across) for step in steps]
        numbers += [number] * per_strip
    turn = np.radians(angle)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.array(places) @ matrix.T, numbers


@pytest.mark.parametrize("angle", [0, 37, 90, 223])
@pytest.mark.parametrize("noise", [0.0, 1.5])
def test_flown_back_and_forth(angle, noise):
    places, expected = lawnmower(4, 8, angle=angle)
    places = places + np.random.default_rng(1).normal(0, noise, places.shape)
    strip, order = find_strips(places)
    assert strip == expected
    assert order == list(range(8)) * 4


def test_strips_of_two_photographs_along_one_axis():
    places, expected = lawnmower(5, 2, along=60, across=25)
    assert find_strips(places)[0] == expected
    assert find_strips([(0, 0), (20, 0)]) == ([0, 0], [0, 1])


def test_corner_begins_a_strip_and_the_corner_photograph_stays_in_the_first():
    places = [(0, 0), (20, 0), (40, 0), (60, 0), (60, 20), (60, 40), (60, 60)]
    assert find_strips(places) == ([0, 0, 0, 0, 1, 1, 1], [0, 1, 2, 3, 0, 1, 2])


def test_crossing_flights():
    first, numbers = lawnmower(3, 6)
    second, more = lawnmower(3, 6, angle=90)
    strip, _ = find_strips(np.vstack([first, second + (70, -15)]))
    assert strip == numbers + [number + 3 for number in more]


def test_a_pause_divides_a_strip():
    places = [(x, 0) for x in (0, 20, 40, 60, 200, 220, 240)]
    assert find_strips(places)[0] == [0, 0, 0, 0, 1, 1, 1]


def test_hovering_stays_in_the_strip():
    places = [(0, 0), (20, 0), (20.3, 0.4), (19.9, 0.2), (40, 0), (60, 0)]
    assert find_strips(places)[0] == [0] * 6


def test_a_single_photograph_between_strips():
    places = [(0, 0), (20, 0), (40, 0), (60, 0), (60, 90), (0, 300), (-20, 300), (-40, 300)]
    assert find_strips(places)[0] == [0, 0, 0, 0, 1, 2, 2, 2]


@pytest.mark.parametrize("count", [0, 1])
def test_few(count):
    assert find_strips([(1.0, 2.0)] * count) == ([0] * count, [0] * count)


def test_all_at_one_place():
    assert find_strips([(5.0, 5.0)] * 3)[0] == [0, 0, 0]
