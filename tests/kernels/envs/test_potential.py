"""What shaping is made of: a field of velocities, and how far a lander is off it."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest

from lunarsim_envs.descent._reward_kernels import reference_velocity
from lunarsim_envs.descent.rewards import DescentWeights
from tests.low_descents import IDS, batch
from tests.reference import descent as reference


@pytest.fixture(scope="module")
def descents():
    """Return descents with lanes anywhere, some below their target, shaping at a weight of 2."""
    vector = batch(IDS[0], 64, weights=DescentWeights(shaping=2.0))
    vector.reset(seed=1)
    found = vector.unwrapped.descents
    rng = np.random.default_rng(2)
    found.lanes.y[:, :3] = rng.normal(0.0, 300.0, (64, 3))
    found.lanes.y[:, 3:6] = rng.normal(0.0, 20.0, (64, 3))
    found.lanes.target[:] = rng.normal(0.0, 10.0, (64, 3))
    return found


@numba.njit
def _velocities(y, target, params):
    out = np.empty((len(y), 3))
    for i in range(len(y)):
        out[i, 0], out[i, 1], out[i, 2] = reference_velocity(y[i], target[i], params)
    return out


def velocities(descents):
    """Return the reference velocities of all lanes (n, 3)."""
    return _velocities(descents.lanes.y, descents.lanes.target, descents.rewards.params)


def test_the_field_is_that_of_the_plain_reference(descents):
    lanes, d = descents.lanes, descents.lanes.craft.dynamics
    before = lanes.y.copy()
    for y, target, velocity in zip(lanes.y, lanes.target, velocities(descents), strict=True):
        wanted = reference.wanted_velocity(y[:3], target, d.lander, d.gravity)
        assert velocity == pytest.approx(wanted, rel=1e-12)
    assert np.array_equal(lanes.y, before)


def test_the_potential_is_the_logarithm_of_the_difference(descents):
    lanes, d = descents.lanes, descents.lanes.craft.dynamics
    potential = descents.rewards.potential()
    for y, target, told in zip(lanes.y, lanes.target, potential, strict=True):
        wanted = reference.wanted_velocity(y[:3], target, d.lander, d.gravity)
        error = math.dist(y[3:6], wanted)
        assert told == pytest.approx(-2.0 * math.log(1.0 + error / 1.0), rel=1e-12)


def test_who_flies_along_the_field_comes_down_safe_on_the_target(descents):
    """Followed exactly it ends at the target within the limits, braking by no more than it may."""
    lanes = descents.lanes
    lander, gravity = lanes.craft.dynamics.lander, lanes.craft.dynamics.gravity
    lanes.target[:] = 0.0
    lanes.y[:, :3] = np.random.default_rng(3).uniform([-600, -600, 200], [600, 600, 600], (64, 3))
    up = np.ones(64, bool)
    end, before = np.full((64, 6), np.nan), velocities(descents)
    most = lander.thrust_max / lander.wet_mass - gravity
    for _ in range(4000):
        lanes.y[up, :3] += 0.05 * before[up]
        now = velocities(descents)
        assert np.linalg.norm(now - before, axis=1)[up].max(initial=0.0) < 0.05 * most
        landed = up & (lanes.y[:, 2] <= lander.com_height)
        end[landed, :3], end[landed, 3:] = lanes.y[landed, :3], now[landed]
        up &= ~landed
        before = now
    assert not up.any()
    assert np.hypot(end[:, 0], end[:, 1]).max() < 2.0
    assert np.hypot(end[:, 3], end[:, 4]).max() < lander.horizontal_speed_limit
    assert (-end[:, 5]).max() < 0.5 * lander.vertical_speed_limit
