"""Compiled attitudes and inertial samples against SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim import _frame_kernels as kernels
from lunarsim.frames import attitude_from_thrust
from lunarsim.sensors import _imu_kernels as imu
from tests.reference import attitude as reference


def same_attitude(a, b):
    return abs(abs(np.dot(a, b)) - 1.0) < 1e-12


@pytest.mark.parametrize("seed", range(40))
def test_attitudes_along_a_thrust(seed):
    rng = np.random.default_rng(seed)
    direction, heading = rng.standard_normal(3) * 10.0 ** rng.uniform(-3, 3), rng.uniform(-7, 7)
    found = attitude_from_thrust(direction, heading)
    assert same_attitude(found, reference.along_thrust(direction, heading))
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)


def test_thrust_along_the_heading_and_none_at_all():
    found = attitude_from_thrust([0.0, 2.0, 0.0], 0.0)
    assert Rotation.from_quat(found).apply([0.0, 0.0, 1.0]) == pytest.approx([0.0, 1.0, 0.0])
    with pytest.raises(ValueError, match="zero length"):
        attitude_from_thrust([0.0, 0.0, 0.0], 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_turns_and_vectors(seed):
    rng = np.random.default_rng(seed)
    p, q = Rotation.random(2, rng=rng).as_quat()
    out = np.empty(3)
    angle = kernels.rotation_vector_between(p, q, out)
    assert out == pytest.approx(reference.rotation_between(p, q), abs=1e-12)
    assert angle == pytest.approx(np.linalg.norm(out))
    v = rng.standard_normal(3)
    kernels.rotate_to_body(p, v, out)
    assert out == pytest.approx(Rotation.from_quat(p).inv().apply(v), abs=1e-14)
    phi = rng.standard_normal(3) * 10.0 ** rng.uniform(-10, 0)
    turned = p.copy()
    kernels.rotate_quaternion(turned, phi)
    wanted = Rotation.from_quat(p) * Rotation.from_rotvec(phi)
    assert same_attitude(turned, wanted.as_quat())


@pytest.mark.parametrize("seed", range(60))
def test_what_a_perfect_unit_gives(seed):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((7, 15))
    turns = Rotation.from_rotvec(0.05 * rng.standard_normal((7, 3)))
    attitude = Rotation.random(rng=rng)
    for row, turn in zip(rows, turns, strict=True):
        attitude = attitude * turn
        row[6:10] = attitude.as_quat() * rng.choice([-1.0, 1.0])  # both signs are one attitude
    angle, gained = np.empty((2, 6, 3))
    imu.ideal_increments(rows, 0.0162, angle, gained)
    wanted_angle, wanted_gained = reference.ideal_samples(rows, 0.0162)
    assert angle == pytest.approx(wanted_angle, abs=1e-13)
    assert gained == pytest.approx(wanted_gained, abs=1e-13)


@pytest.mark.parametrize("quantum", [0.0, 1e-3])
def test_increments_of_a_triad(quantum):
    rng = np.random.default_rng(7)
    truth, offsets = 0.01 * rng.standard_normal((2, 50, 3))
    matrix = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
    found = imu.sample_increments(truth, matrix, offsets, quantum, np.zeros(3))
    assert found == pytest.approx(reference.triad(truth, matrix, offsets, quantum), abs=1e-12)
