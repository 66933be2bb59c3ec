"""Propagation of the state and its covariance by inertial samples."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_rotation_vector,
)
from lunarsim.onboard.navigation import _inertial_kernels as kernels
from tests.reference.shadows import inertial

GRAVITY = np.array([0.0, 0.0, -1.622])
STEP = 0.01


def samples(rng, n=50):
    return 0.01 * rng.standard_normal((n, 3)), 0.02 + 0.01 * rng.standard_normal((n, 3))


def start(rng):
    q = quat_from_rotation_vector(rng.standard_normal(3))
    small = 1e-3 * rng.standard_normal((2, 3))
    return np.concatenate((10.0 * rng.standard_normal(6), small[0], q, small[1]))


def carry(state, angle, velocity):
    return kernels.propagate(
        state, np.zeros(6), angle, velocity, STEP, GRAVITY, np.full(4, 1e-3), np.ones(2)
    )


def test_state_follows_the_reference():
    rng = np.random.default_rng(1)
    for _ in range(10):
        state, (angle, velocity) = start(rng), samples(rng)
        found, _, _ = carry(state, angle, velocity)
        r, v, q = inertial(state, angle, velocity, STEP, GRAVITY)
        assert found[0:3] == pytest.approx(r, abs=1e-10)
        assert found[3:6] == pytest.approx(v, abs=1e-10)
        assert abs(found[9:13] @ q) == pytest.approx(1.0, abs=1e-12)


def error_between(a, b):
    turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(b[9:13]), a[9:13]))
    return np.concatenate((a[0:9] - b[0:9], turn, a[13:16] - b[13:16]))


def displaced(state, error):
    out = state.copy()
    out[0:9] += error[0:9]
    out[9:13] = quat_multiply(state[9:13], quat_from_rotation_vector(error[9:12]))
    out[13:16] += error[12:15]
    return out


def test_transition_equals_finite_differences():
    rng = np.random.default_rng(2)
    state, (angle, velocity) = start(rng), samples(rng)
    _, transition, _ = carry(state, angle, velocity)
    slope = np.empty((15, 15))
    for k in range(15):
        e = np.zeros(15)
        e[k] = 1e-5
        ahead, _, _ = carry(displaced(state, e), angle, velocity)
        behind, _, _ = carry(displaced(state, -e), angle, velocity)
        slope[:, k] = error_between(ahead, behind) / 2e-5
    # First order in the step: the error is the rotation of a sample times its duration.
    assert transition == pytest.approx(slope, abs=3e-3, rel=5e-3)


def test_noise_of_many_samples_is_that_of_a_random_walk():
    rng = np.random.default_rng(3)
    state = start(rng)
    state[9:13] = [0.0, 0.0, 0.0, 1.0]
    n = 1000
    _, _, noise = carry(state, np.zeros((n, 3)), np.zeros((n, 3)))
    seconds = n * STEP
    # White noise integrated once, and the random walk of the bias twice.
    walks = 1e-6 * (seconds + seconds**3 / 3.0)
    assert noise[3, 3] == pytest.approx(walks, rel=2e-3)
    assert noise[6, 6] == pytest.approx(1e-6 * seconds)
    assert noise[14, 14] == pytest.approx(1e-6 * seconds)
    assert np.linalg.eigvalsh(noise).min() > -1e-12
    assert noise == pytest.approx(noise.T, rel=1e-12, abs=1e-18)


def test_velocity_noise_reaches_the_position_as_the_integral_of_a_random_walk():
    """Covariance of a random walk and its integral after T: T, T^2 / 2, T^3 / 3."""
    state = start(np.random.default_rng(3))
    for n in (1, 200):
        still, seconds = np.zeros((n, 3)), n * STEP
        noise = kernels.propagate(
            state, np.zeros(6), still, still, STEP, GRAVITY, np.array([1e-3, 0.0, 0.0, 0.0]),
            np.ones(2),
        )[2]  # fmt: skip
        for axis in range(3):
            velocity = 3 + axis
            assert noise[velocity, velocity] == pytest.approx(1e-6 * seconds)
            assert noise[axis, velocity] == pytest.approx(1e-6 * seconds**2 / 2.0)
            assert noise[axis, axis] == pytest.approx(1e-6 * seconds**3 / 3.0)


@pytest.mark.parametrize("missing", ["angle", "velocity"])
@pytest.mark.parametrize("axis", range(3))
def test_a_sample_of_which_one_number_is_missing_is_missing(missing, axis):
    rng = np.random.default_rng(5)
    state, (angle, velocity) = start(rng), samples(rng)
    incomplete = angle.copy(), velocity.copy()
    incomplete[0][7] = incomplete[1][7] = np.nan
    (angle if missing == "angle" else velocity)[7, axis] = np.nan
    for found, wanted in zip(carry(state, angle, velocity), carry(state, *incomplete), strict=True):
        assert np.isfinite(found).all() and np.array_equal(found, wanted)
