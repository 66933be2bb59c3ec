from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector
from lunarsim.sensors.altimeter import RadarAltimeter
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.worlds import flat_terrain, sloped_terrain


def state(height, tilt=0.0):
    attitude = quat_from_rotation_vector([0.0, tilt, 0.0])
    return State(np.array([0.0, 0.0, height]), np.zeros(3), attitude, np.zeros(3), 1000.0)


def test_altimeter_reads_the_slant_range_with_its_noise():
    world = World(flat_terrain(400.0, 4.0), 1.622)
    altimeter = RadarAltimeter()
    rng = np.random.default_rng(0)
    slant = 100.0 / np.cos(0.3)
    readings = [altimeter.measure(world, state(100.0, 0.3), 0.0, rng) for _ in range(4000)]
    sigma = np.hypot(0.1, 0.01 * slant)
    # What it states goes by what it measured: the true range is not to be had from it.
    stated = np.hypot(0.1, 0.01 * readings[0].range)
    assert readings[0].sigma == pytest.approx(stated)
    assert abs(readings[0].range - slant) > 0.01
    values = np.array([r.range for r in readings])
    assert values.mean() == pytest.approx(slant, abs=4.0 * sigma / np.sqrt(4000))
    assert values.std() == pytest.approx(sigma, rel=0.05)


def test_altimeter_is_blind_too_far_too_slanted_and_off_the_map():
    rng = np.random.default_rng(0)
    world = World(flat_terrain(400.0, 4.0), 1.622)
    altimeter = RadarAltimeter(max_range=150.0, max_incidence=np.radians(30.0))
    assert np.isnan(altimeter.measure(world, state(151.0), 0.0, rng).range)
    assert np.isfinite(altimeter.measure(world, state(149.0), 0.0, rng).range)
    assert np.isnan(altimeter.measure(world, state(50.0, np.radians(31.0)), 0.0, rng).range)
    assert np.isfinite(altimeter.measure(world, state(50.0, np.radians(29.0)), 0.0, rng).range)
    # The angle is that with the slope, not with the vertical.
    slope = World(sloped_terrain((np.tan(np.radians(31.0)), 0.0)), 1.622)
    assert np.isnan(altimeter.measure(slope, state(10.0), 0.0, rng).range)


def test_bad_altimeters_are_refused():
    with pytest.raises(InputError, match=r"altimeter\.boresight"):
        RadarAltimeter(boresight=(0.0, 0.0, -2.0))
    with pytest.raises(InputError, match=r"altimeter\.max_incidence"):
        RadarAltimeter(max_incidence=2.0)
