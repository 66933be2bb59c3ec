"""The Doppler velocimeter and the star tracker against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_rotation_vector,
)
from lunarsim.sensors.star_tracker import StarTracker
from lunarsim.sensors.velocimeter import DopplerVelocimeter
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.worlds import flat_terrain

LEVEL = World(flat_terrain(400.0, 4.0), 1.622)
VELOCITY = np.array([3.0, -2.0, -9.0])


def state(height=100.0, turn=(0.1, 0.2, 0.3), rate=(0.0, 0.0, 0.0)):
    attitude = quat_from_rotation_vector(turn)
    return State(np.array([0.0, 0.0, height]), VELOCITY, attitude, np.array(rate), 1000.0)


def test_beams_see_their_share_of_the_velocity():
    sensor, here = DopplerVelocimeter(), state()
    rng = np.random.default_rng(0)
    readings = [sensor.measure(LEVEL, here, 0.0, rng) for _ in range(3000)]
    speed = np.array([r.speed for r in readings])
    # By hand: the body's axes in ENU, one after the other.
    angle, axis = np.linalg.norm((0.1, 0.2, 0.3)), np.array([0.1, 0.2, 0.3])
    k = axis / angle
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    for n in range(3):
        azimuth = 2.0 * np.pi * n / 3.0
        beam = [np.sin(np.pi / 8) * np.cos(azimuth), np.sin(np.pi / 8) * np.sin(azimuth),
                -np.cos(np.pi / 8)]  # fmt: skip
        seen = rotation @ beam
        assert speed[:, n].mean() == pytest.approx(seen @ VELOCITY, abs=0.003)
        assert speed[:, n].std() == pytest.approx(0.03, rel=0.05)
        slant = np.array([r.range[n] for r in readings])
        assert slant.mean() == pytest.approx(-100.0 / seen[2], abs=0.2)
        assert slant.std() == pytest.approx(2.0, rel=0.05)


def test_what_beams_are_off_by_is_drawn_for_a_flight_and_wanders():
    noiseless = DopplerVelocimeter(speed_noise=1e-9)
    calibration = noiseless.calibration()
    assert (calibration.speed_bias_sigma, calibration.speed_bias_walk) == (0.02, 0.005)
    here, rng = state(), np.random.default_rng(5)
    truth = noiseless.measure(LEVEL, here, 0.0, rng).speed
    off = np.empty((400, 3, 3))
    for flight in range(len(off)):
        sensor = noiseless.build(rng, 0.01)
        for n, time in enumerate((0.0, 0.1, 40.0)):
            off[flight, n] = sensor.measure(LEVEL, here, time, rng).speed - truth
    assert off[:, 0].std() == pytest.approx(0.02, rel=0.08)
    assert (off[:, 1] - off[:, 0]).std() == pytest.approx(0.005 * np.sqrt(0.1), rel=0.08)
    assert (off[:, 2] - off[:, 1]).std() == pytest.approx(0.005 * np.sqrt(39.9), rel=0.08)
    # Each beam by itself.
    assert np.abs(np.corrcoef(off[:, 0].T)[np.triu_indices(3, 1)]).max() < 0.2
    perfect = DopplerVelocimeter(speed_bias=0.0, speed_random_walk=0.0).build(rng, 0.01)
    for time in (0.0, 5.0):
        perfect.measure(LEVEL, here, time, rng)
        assert not perfect.bias.any()


def test_beams_without_a_return_are_nan():
    rng = np.random.default_rng(1)
    far = DopplerVelocimeter(max_range=50.0).measure(LEVEL, state(), 0.0, rng)
    for values in (far.speed, far.range, far.speed_sigma, far.range_sigma):
        assert np.isnan(values).all()
    tilted = DopplerVelocimeter().measure(LEVEL, state(turn=(0.0, 1.0, 0.0)), 0.0, rng)
    assert np.isnan(tilted.speed).any()
    assert np.isfinite(tilted.speed).any()


def test_stars_give_the_attitude_apart_from_noise_and_mount():
    figures = StarTracker(misalignment=1e-3, cross_boresight_noise=1e-4, roll_noise=1e-3)
    here, offsets = state(turn=(0.0, 0.0, 0.4)), []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        tracker = figures.build(rng, 0.01)
        readings = [tracker.measure(LEVEL, here, 0.0, rng) for _ in range(30)]
        turns = np.array(
            [quat_to_rotation_vector(quat_multiply(quat_conjugate(here.attitude), r.attitude))
             for r in readings]
        )  # fmt: skip
        offsets.append(turns.mean(axis=0))
        if seed == 0:
            b = np.asarray(figures.boresight)
            across = np.array([1.0, 0.0, 0.0])
            p = readings[0].covariance
            assert b @ p @ b == pytest.approx(1e-6)
            assert across @ p @ across == pytest.approx(1e-8)
    assert np.std(offsets, axis=0) == pytest.approx(1e-3, rel=0.2)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({}, {"rate": (0.1, 0.0, 0.0)}),  # turns too fast
        ({}, {"turn": (-1.2, 0.0, 0.0)}),  # looks at the ground
        ({"boresight": tuple(LEVEL.light.direction), "min_elevation": 0.0}, {"turn": (0, 0, 0)}),
    ],
)
def test_it_sees_no_stars_while_it_turns_looks_down_or_at_the_sun(changes, where):
    figures = StarTracker(**changes)
    rng = np.random.default_rng(2)
    reading = figures.build(rng, 0.01).measure(LEVEL, state(**where), 0.0, rng)
    assert np.isnan(reading.attitude).all()


def test_bad_figures_are_refused():
    with pytest.raises(InputError, match="boresight"):
        StarTracker(boresight=(0.0, 0.0, 2.0))
    for odd in ((1.0,), (0.0, 0.0, 1.0, 0.0)):
        with pytest.raises(InputError, match="boresight"):
            StarTracker(boresight=odd)
    with pytest.raises(InputError, match="cone"):
        DopplerVelocimeter(cone=0.0)
    with pytest.raises(InputError, match="beams"):
        DopplerVelocimeter(beams=2)
