"""Contact forces of legs and their motion at rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.frames import attitude_from_thrust
from lunarsim.models.lander import Lander
from lunarsim.vehicle import Dynamics
from lunarsim.vehicle import _leg_kernels as kernels
from lunarsim.vehicle.dynamics import PLAIN_RIG
from lunarsim.vehicle.legs import Legs

G, MASS = 1.622, 1300.0
LANDER, LEGS = Lander(), Legs()
UP = attitude_from_thrust([0.0, 0.0, 1.0], np.pi / 2)


def stepped(y, legs, law, dt=0.001):
    """Move a lander by one step on its legs over level ground, east and north from 0 to 20 m."""
    dynamics = Dynamics(LANDER, G)
    kernels.settle(
        y, 1, dt, LANDER.pads, legs, law, np.zeros((401, 401)), np.array([0.0, 0.0, 0.05]),
        dynamics.params, dynamics.inertia, PLAIN_RIG.copy(),
    )  # fmt: skip


def test_in_the_air_the_attitude_alone_is_brought_to_its_norm():
    y = np.concatenate(([10.0, 10.0, 9.0, 0.0, 0.0, -1.0], 1.01 * UP, [0.1, 0.0, 0.0, MASS, 0.0]))
    legs = np.full((4, 5), np.nan)
    legs[:, :2] = 0.0
    stepped(y, legs, np.array([2e5, 5e3, 1.2e4, 0.5, 0.15, 0.2]))
    assert np.linalg.norm(y[6:10]) == pytest.approx(1.0, abs=1e-15)
    assert y[10:13] == pytest.approx([0.1, 0.0, 0.0], abs=1e-15)
    assert np.isnan(legs[:, 2:]).all()


def test_a_pad_that_leaves_the_terrain_lets_go_of_where_it_held():
    y = np.concatenate(([10.0, 10.0, 9.0, 0.0, 0.0, -1.0], UP, np.zeros(3), [MASS, 0.0]))
    legs = np.tile([0.05, 0.02, 9.0, 11.0, 0.0], (4, 1))
    stepped(y, legs, np.array([2e5, 5e3, 1.2e4, 0.5, 0.15, 0.2]))
    assert np.isnan(legs[:, 2:]).all()
    assert (legs[:, 1] == 0.0).all()
    assert (legs[:, 0] == 0.05).all()  # what has crushed stays


def test_a_leg_at_its_crush_force_gives_what_its_spring_cannot_hold():
    """Spring and damper relax to the level of the crush force by exp(-k dt / c)."""
    k, c, crush, dt, before = 2e5, 5e3, 2e3, 0.001, 0.03
    height = LANDER.com_height - 0.05
    y = np.concatenate(([10.0, 10.0, height, 0.0, 0.0, -1.0], UP, np.zeros(3), [MASS, 0.0]))
    legs = np.full((4, 5), np.nan)
    legs[:, 0], legs[:, 1] = 0.01, before
    stepped(y, legs, np.array([k, c, crush, 0.5, 0.15, 0.2]), dt)
    pressed = LANDER.com_height - y[2] - 0.01  # what spring and honeycomb share
    level = crush / k
    left = level + (before - level) * np.exp(-dt * k / c)
    assert legs[:, 0] == pytest.approx(0.01 + pressed - left, rel=1e-9)
    assert legs[:, 1] == pytest.approx(left, rel=1e-9)


def test_terrain_begins_at_its_first_post():
    law, out = np.array([2e5, 5e3, 1.2e4, 0.5, 0.15, 0.2]), np.empty(12)
    pad, leg = np.array([0.0, 0.0, -LANDER.com_height]), np.zeros(5)
    for east, north, known in ((0.16, 5.0, True), (5.0, 0.16, True), (0.14, 5.0, False)):
        y = np.concatenate(([east, north, 1.59, 0.0, 0.0, -1.0], UP, np.zeros(3), [MASS, 0.0]))
        ground, frame = np.zeros((201, 201)), np.array([0.0, 0.0, 0.05])
        assert kernels.compute_contact(y, pad, leg, law, ground, frame, out) == known


@pytest.mark.parametrize("seed", range(4))
def test_a_pad_against_a_plain_reference(seed):
    """Normal force, friction cone and velocity of one pad on a plane, with SciPy's rotations."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.2, 3))
    gradient = rng.normal(0.0, 0.1, 2)
    pad, rate = LANDER.pads[seed % 4], rng.normal(0.0, 0.2, 3)
    velocity = np.array([*rng.normal(0.0, 1.0, 2), -1.0])
    arm = turn.apply(pad)
    sunk = 0.03
    where = np.array([0.4, -0.3, 0.0]) + [0.0, 0.0, gradient @ [0.4, -0.3] - sunk]
    y = np.concatenate((where - arm, velocity, turn.as_quat(), rate, [MASS, 0.0]))
    axis = 0.05 * np.arange(-100, 101)
    ground = gradient[0] * axis[None, :] + gradient[1] * axis[:, None]
    frame = np.array([axis[0], axis[0], 0.05])
    law = np.array([2e5, 5e3, 1.2e4, 0.5, 0.15, 0.2])
    hold = where + rng.normal(0.0, 0.01, 3)
    leg = np.array([0.004, 0.0, *hold])
    out = np.empty(12)
    assert kernels.compute_contact(y, pad, leg, law, ground, frame, out)
    n = np.array([-gradient[0], -gradient[1], 1.0])
    n /= np.linalg.norm(n)
    moving = velocity + turn.apply(np.cross(rate, pad))
    normal = np.clip(2e5 * (sunk * n[2] - 0.004) - 5e3 * moving @ n, 0.0, 1.2e4)
    pull = -(2e5 * (where - hold) + 5e3 * moving)
    pull -= (pull @ n) * n
    pull *= min(1.0, 0.5 * normal / np.linalg.norm(pull))
    assert out[6:9] == pytest.approx(moving, abs=1e-12)
    assert out[:3] == pytest.approx(normal * n + pull, rel=1e-9, abs=1e-6)
