# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled sampling of three inertial sensor axes."""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotate_to_body, rotation_vector_between
from lunarsim._jit import kernel


@kernel()
def quantize_increment(truth, matrix, offset, quantum, remainder, out):
    """Write one measured increment (3,) = matrix @ truth + offset, quantized.

    `truth` is the true increment (3,), `matrix` (3, 3) holds scale factors and misalignments,
    `offset` (3,) is the additive error, and `quantum` the quantization step (0: none). The
    quantization `remainder` (3,) is updated for the next call; `out` (3,) is the result.
    The running sum is rounded, not each increment, so that no angle or velocity is lost.
    """
    for i in range(3):
        x = offset[i]
        for j in range(3):
            x += matrix[i, j] * truth[j]
        if quantum > 0.0:
            total = remainder[i] + x
            x = quantum * np.rint(total / quantum)
            remainder[i] = total - x
        out[i] = x


@kernel()
def ideal_increments(states, gravity_increment, angle_increments, velocity_increments):
    """Compute the increments that an error-free IMU measures along a trajectory.

    `states` (n + 1, 15) are state vectors one time step apart; the first is the state before the
    first sample. `gravity_increment` is gravity times the time step, m/s. The angle and velocity
    increments (n, 3), rad and m/s, body axes, are written into the last two arrays.
    """
    middle = np.empty(4)
    change = np.empty(3)
    for n in range(states.shape[0] - 1):
        p, q = states[n, 6:10], states[n + 1, 6:10]
        rotation_vector_between(p, q, angle_increments[n])
        dot = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
        sign = -1.0 if dot < 0.0 else 1.0
        size = 0.0
        for k in range(4):
            middle[k] = p[k] + sign * q[k]
            size += middle[k] * middle[k]
        for k in range(4):
            middle[k] /= np.sqrt(size)
        for k in range(3):
            change[k] = states[n + 1, 3 + k] - states[n, 3 + k]
        change[2] += gravity_increment
        rotate_to_body(middle, change, velocity_increments[n])


@kernel()
def sample_increments(truth, matrix, offsets, quantum, remainder):
    """Return the measured increments (n, 3) for true increments `truth` (n, 3).

    `matrix` (3, 3) holds scale factors and misalignments, `offsets` (n, 3) are additive errors and
    `quantum` is the quantization step (0: none). The quantization remainder `remainder` (3,) is
    updated in place for the next call.
    """
    out = np.empty_like(truth)
    for n in range(truth.shape[0]):
        quantize_increment(truth[n], matrix, offsets[n], quantum, remainder, out[n])
    return out
