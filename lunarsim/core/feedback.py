# mypy: allow-untyped-defs, no-check-untyped-defs
"""Feedback formulas of guidance laws, compiled with one signature.

Kernels receive a formula as an argument of this signature, so that a further formula compiles in a
fraction of a second and no kernel is compiled again.
"""

from __future__ import annotations

from functools import lru_cache

import numba
from numba import types
from numba.core.ccallback import CFunc

from lunarsim._jit import kernel

_ROW, _ROWS = types.float64[::1], types.float64[:, ::1]
# Arguments: state (2, 3), end position (3,), final velocity and acceleration (2, 3), time-to-go,
# downward gravity, gains, and the result (3,), all SI.
SIGNATURE = types.void(_ROWS, _ROW, _ROWS, types.float64, types.float64, _ROW, _ROW)


class _Formula(CFunc):
    """Compiled formula that can be copied and pickled: its source is compiled again."""

    def __reduce__(self):
        return compile_formula, (self._pyfunc,)


@lru_cache
def compile_formula(function):
    """Compile a feedback formula, a function with the arguments of `SIGNATURE`."""
    if numba.config.DISABLE_JIT:
        return function
    compiled = numba.cfunc(SIGNATURE, error_model="numpy")(function)
    compiled.__class__ = _Formula
    return compiled


def follow_path(state, target, final, time_to_go, gravity, gains, out):
    """Leave `out` unchanged: the formula of a law that only follows its paths."""


@kernel()
def evaluate_formula(formula, state, target, final, time_to_go, gravity, gains, out):
    """Evaluate a compiled formula; `out` (3,) receives its result, m/s^2.

    The result is an acceleration, gravity included. `state` (2, 3) is position and velocity,
    `target` (3,) the end position, `final` (2, 3) final velocity and acceleration, `time_to_go` the
    time to the end, `gravity` the downward acceleration; `gains` are those of the law. All are in
    SI units.
    """
    formula(state, target, final, time_to_go, gravity, gains, out)


def zem_zev(state, target, final, time_to_go, gravity, gains, out):
    """Write the acceleration of ZEM/ZEV feedback to `out` (3,), m/s^2.

    It includes gravity; the thrust acceleration is ``6 ZEM / T^2 - 2 ZEV / T`` (Guo 2013, Eq. 15).
    ZEM and ZEV are the errors of position and velocity at the end if no thrust is applied. The
    final acceleration and `gains` are not used. The other arguments are those of
    `evaluate_formula`.
    """
    for k in range(3):
        g = -gravity if k == 2 else 0.0
        unpowered = state[0, k] + time_to_go * state[1, k] + 0.5 * time_to_go**2 * g
        miss = target[k] - unpowered
        velocity_error = final[0, k] - (state[1, k] + time_to_go * g)
        thrust = 6.0 * miss / time_to_go**2 - 2.0 * velocity_error / time_to_go
        out[k] = thrust + g


def fractional_polynomial(state, target, final, time_to_go, gravity, gains, out):
    """Write the acceleration of Lu's feedback law to `out` (3,), m/s^2.

    It includes gravity. The thrust acceleration is ``gamma (k / (2 (gamma + 2)) - 1) a_Tf + (gamma
    k / (2 (gamma + 2)) - gamma - 1) g + (gamma + 1) / T (1 - k / (gamma + 2)) (V_f - V) + k / T^2
    (r_f - r - V T)`` (Lu 2020); a_Tf is the thrust acceleration at the end. `gains` (2,) are gamma
    and k; the other arguments are those of `evaluate_formula`.
    """
    gamma, gain = gains[0], gains[1]
    half = 0.5 * gain / (gamma + 2.0)
    for k in range(3):
        g = -gravity if k == 2 else 0.0
        velocity_gain = (gamma + 1.0) / time_to_go * (1.0 - 2.0 * half)
        velocity_error = velocity_gain * (final[0, k] - state[1, k])
        miss = gain / time_to_go**2 * (target[k] - state[0, k] - time_to_go * state[1, k])
        thrust = gamma * (half - 1.0) * (final[1, k] - g)
        out[k] = thrust + (gamma * half - gamma - 1.0) * g + velocity_error + miss + g
