# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled strapdown propagation of state and error covariance."""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotate_quaternion
from lunarsim._jit import kernel


@kernel()
def _rotation(quaternion, matrix):
    """Write the matrix of a unit quaternion (4,), scalar last, to `matrix` (3, 3)."""
    x, y, z, w = quaternion
    matrix[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrix[0, 1] = 2.0 * (x * y - w * z)
    matrix[0, 2] = 2.0 * (x * z + w * y)
    matrix[1, 0] = 2.0 * (x * y + w * z)
    matrix[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrix[1, 2] = 2.0 * (y * z - w * x)
    matrix[2, 0] = 2.0 * (x * z - w * y)
    matrix[2, 1] = 2.0 * (y * z + w * x)
    matrix[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@kernel(inline=True)
def _read_sample(angle, velocity, n, step, last_sample):
    """Write rate and specific force of sample n to `last_sample` (6,), unless missing.

    The return value states whether the sample is present. `angle`, rad, and `velocity`, m/s, both
    (samples, 3), are increments over `step`, s; a sample that is not finite is missing, and
    `last_sample` then stays unchanged.
    """
    good = True
    for k in range(3):
        good = good and np.isfinite(angle[n, k]) and np.isfinite(velocity[n, k])
    if good:
        for k in range(3):
            last_sample[k] = angle[n, k] / step
            last_sample[3 + k] = velocity[n, k] / step
    return good


@kernel(inline=True)
def _write_transition(rotation, rotated_force, rate, step, phi):
    """Write the state-transition matrix of the errors over a step to `phi` (15, 15).

    The errors are position, velocity, accelerometer bias, attitude and gyroscope bias. `phi` must
    be the identity or the result of an earlier call; only the other elements are written.
    `rotation` is the attitude matrix (3, 3) in the middle of the step, `rotated_force` (3, 3) its
    product with the cross-product matrix of the specific force, `rate` (3,) the body rate, rad/s,
    and `step` is in s.
    """
    for i in range(3):
        phi[i, 3 + i] = step
        phi[9 + i, 12 + i] = -step
        for j in range(3):
            phi[i, 6 + j] = -0.5 * step * step * rotation[i, j]
            phi[3 + i, 6 + j] = -step * rotation[i, j]
            phi[i, 9 + j] = -0.5 * step * step * rotated_force[i, j]
            phi[3 + i, 9 + j] = -step * rotated_force[i, j]
            phi[3 + i, 12 + j] = 0.5 * step * step * rotated_force[i, j]
    phi[9, 10], phi[9, 11] = step * rate[2], -step * rate[1]
    phi[10, 9], phi[10, 11] = -step * rate[2], step * rate[0]
    phi[11, 9], phi[11, 10] = step * rate[1], -step * rate[0]


@kernel()
def _random_walks(step, velocity, angle, accelerometer, gyroscope):
    """Return the variances that random walks of given densities add in one step.

    `step` is its length, s. The densities are those of velocity, angle, accelerometer bias and
    gyroscope bias. The results are the variance of position, covariance of position and velocity,
    and variances of velocity, attitude, accelerometer bias and gyroscope bias.
    """
    return (
        velocity**2 * step**3 / 3.0,
        velocity**2 * step**2 / 2.0,
        velocity**2 * step,
        angle**2 * step,
        accelerometer**2 * step,
        gyroscope**2 * step,
    )


@kernel(inline=True)
def _add_noise(variances, covariance):
    """Add the random walks of an interval to `covariance` (15, 15), in place.

    `variances` (6,) from `_random_walks` are five variances, and at index 1 the covariance of
    attitude and gyroscope bias. Each applies to the three axes of its error.
    """
    for i in range(3):
        covariance[i, i] += variances[0]
        covariance[i, 3 + i] += variances[1]
        covariance[3 + i, i] += variances[1]
        covariance[3 + i, 3 + i] += variances[2]
        covariance[9 + i, 9 + i] += variances[3]
        covariance[6 + i, 6 + i] += variances[4]
        covariance[12 + i, 12 + i] += variances[5]


@kernel()
def propagate(state, last_sample, angle, velocity, step, gravity, density, density_without_samples):
    """Propagate state and errors with inertial samples (shadow EKF paper, Eqs. 2-6).

    `state` (16,) is position, velocity, accelerometer bias, quaternion, gyroscope bias. `angle`,
    rad, and `velocity`, m/s (n, 3), are increments, `step` (s) the time between samples, and
    `gravity` (3,) is in ENU, m/s^2. `last_sample` (6,) is the last valid rate (rad/s) and specific
    force (m/s^2); it is updated in place and used while samples are NaN. `density` (4,) are the
    random-walk densities of velocity, angle, accelerometer bias and gyroscope bias, and
    `density_without_samples` (2,) those of velocity and angle while samples are missing. The
    results are the new state (16,), and transition (15, 15) and noise (15, 15) over all samples.
    The errors are position, velocity, accelerometer bias, attitude (a small rotation in body axes)
    and gyroscope bias, as in Eq. 1 of the paper.
    """
    x = state.copy()
    total = np.eye(15)
    noise = np.zeros((15, 15))
    phi = np.eye(15)
    r = np.empty((3, 3))
    ra = np.empty((3, 3))
    half = np.empty(4)
    accel = np.empty(3)
    for n in range(angle.shape[0]):
        good = _read_sample(angle, velocity, n, step, last_sample)
        w = last_sample[:3] - x[13:16]
        a = last_sample[3:] - x[6:9]
        half[:] = x[9:13]
        rotate_quaternion(half, 0.5 * step * w)
        _rotation(half, r)
        for i in range(3):
            accel[i] = r[i, 0] * a[0] + r[i, 1] * a[1] + r[i, 2] * a[2] + gravity[i]
            # R [a x]
            ra[i, 0] = r[i, 1] * a[2] - r[i, 2] * a[1]
            ra[i, 1] = r[i, 2] * a[0] - r[i, 0] * a[2]
            ra[i, 2] = r[i, 0] * a[1] - r[i, 1] * a[0]
        x[0:3] += step * (x[3:6] + 0.5 * step * accel)
        x[3:6] += step * accel
        rotate_quaternion(x[9:13], step * w)
        _write_transition(r, ra, w, step, phi)
        total = phi @ total
        noise = phi @ noise @ phi.T
        white_v = density[0] if good else density_without_samples[0]
        white_a = density[1] if good else density_without_samples[1]
        _add_noise(_random_walks(step, white_v, white_a, density[2], density[3]), noise)
    return x, total, noise
