# mypy: allow-untyped-defs, no-check-untyped-defs
"""Guidance: response model, vertical descent, and limits of commands.

In all functions, `state` (2, 3) is the estimated position and velocity, ENU, SI.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel

# Indices of `response`: lagged acceleration, commanded acceleration, time of the command.
LAGGED, COMMANDED, COMMAND_TIME = 0, 3, 6
# Tolerated duration, s, and relative size of a violation of the limits of tilt and thrust.
MAX_VIOLATION_S, VIOLATION_SLACK = 0.5, 0.02
# Maximum speed of a climb during the vertical descent, m/s.
MAX_CLIMB_SPEED_M_S = 0.5
# Time-to-go where no path is admissible: this multiple of distance over speed, at least this time
# (s); the speed is taken as at least the last value (m/s).
_FALLBACK_TIME_FACTOR, _MIN_FALLBACK_TIME_S, _MIN_SPEED_M_S = 2.0, 5.0, 1.0


class VerticalDescentParams(NamedTuple):
    """Parameters of the vertical descent, the fields of `VerticalDescent`, SI and rad."""

    gravity: float
    frequency: float
    damping: float
    speed_gain: float
    max_tilt: float
    max_tilt_at_touchdown: float
    full_tilt_height: float
    low_height: float
    tolerated_speed: float
    tolerated_offset: float
    max_offset: float
    upright_time: float
    min_speed_fraction: float
    hold_propellant: float
    dry_mass: float
    exhaust_velocity: float


@kernel(exact=True)
def fallback_time(distance, speed):
    """Return a time-to-go from distance (m) and speed (m/s) only, without limits, s."""
    return max(_FALLBACK_TIME_FACTOR * distance / max(speed, _MIN_SPEED_M_S), _MIN_FALLBACK_TIME_S)


@kernel(exact=True)
def advance_response(response, time, lag):
    """Propagate the lagged acceleration of the vehicle to `time`, s, in place.

    It approaches the command with the time constant `lag`, s. `response` (7,) is the lagged and the
    commanded acceleration, gravity included, m/s^2, and the time of the command, s (NaN: none yet),
    which becomes `time`.
    """
    if lag > 0.0 and not np.isnan(response[COMMAND_TIME]):
        keep = np.exp(-(time - response[COMMAND_TIME]) / lag)
        for k in range(3):
            commanded = response[COMMANDED + k]
            response[LAGGED + k] = commanded + keep * (response[LAGGED + k] - commanded)
    response[COMMAND_TIME] = time


@kernel(exact=True)
def predict_response(state, response, lag, ahead):
    """Predict position and velocity one lag (s) ahead, into `ahead` (2, 3).

    The lagged acceleration in `response` (7,), that of `advance_response`, is held constant.
    `state` (2, 3) is position and velocity.
    """
    for k in range(3):
        a = response[LAGGED + k]
        ahead[0, k] = state[0, k] + lag * (state[1, k] + 0.5 * lag * a)
        ahead[1, k] = state[1, k] + lag * a


@kernel(exact=True)
def _tan_max_tilt(height, full_tilt_height, law):
    """Return the tangent of the maximum tilt at a height (m) above touchdown.

    It decreases linearly below `full_tilt_height`, m, and is constant above.
    """
    fraction = min(max(height / full_tilt_height, 0.0), 1.0)
    at_touchdown = law.max_tilt_at_touchdown
    return np.tan(at_touchdown + fraction * (law.max_tilt - at_touchdown))


@kernel(exact=True)
def _planned_deceleration(height, law):
    """Return the horizontal deceleration with which the vertical descent plans, m/s^2.

    The maximum tilt decreases with `height`, m; half of its value at this height is planned.
    """
    return 0.5 * law.gravity * _tan_max_tilt(height, law.full_tilt_height, law)


@kernel(exact=True)
def _position_gain(offset, height, planned, law):
    """Return the fraction of the position loop's gain used at an `offset`, m.

    The loop moves the lander towards the site at the speed ``frequency / (2 damping) offset``. This
    speed is limited to that from which the lander can slow down to half of the tolerated speed
    during the descent from `height`, m, so that the loop itself never slows the descent. `planned`
    is the vertical velocity of this descent, m/s (negative), and `law` is a
    `VerticalDescentParams`.
    """
    speed = law.frequency / (2.0 * law.damping) * offset
    slowing = _planned_deceleration(height, law) * max(height, 0.0) / -planned
    return min((0.5 * law.tolerated_speed + slowing) / speed, 1.0) if speed > 0.0 else 1.0


@kernel(exact=True)
def _return_time(offset, height, nominal, mass, law):
    """Return the time (s) of a return to the tolerated offset; 0: no return.

    By the position loop, the offset decreases exponentially at the rate
    ``frequency / (2 damping)``, 1/s. The lander does not return from beyond twice the maximum
    offset, nor if the propellant above that for holding is needed to descend from `height`, m, at
    the nominal speed. The other arguments are those of `_limit_descent_speed`.
    """
    left = mass - law.dry_mass - law.hold_propellant
    descent = mass * law.gravity * max(height, 0.0) / (-nominal * law.exhaust_velocity)
    if left <= descent or not law.tolerated_offset < offset <= 2.0 * law.max_offset:
        return 0.0
    return np.log(offset / law.tolerated_offset) * 2.0 * law.damping / law.frequency


@kernel(exact=True)
def _closing_fraction(closing, offset, height, nominal, law):
    """Return the fraction of the position loop's speed reached by a lander.

    `closing` is the speed towards the site, m/s. The result is within 0 to 1; it is 0 if a steady
    error of the tilt keeps the lander beside its site. The other arguments are those of
    `_limit_descent_speed`.
    """
    speed = law.frequency / (2.0 * law.damping) * offset
    speed *= _position_gain(offset, height, law.min_speed_fraction * nominal, law)
    return min(max(closing / speed, 0.0), 1.0)


@kernel(exact=True)
def _limit_descent_speed(state, height, offset, closing, nominal, mass, law):
    """Return the vertical velocity, m/s, and whether the drift is too fast to land.

    The velocity is `nominal`, the nominal vertical velocity, m/s (negative), if the lander can stop
    its drift and return from an `offset`, m, within `height`, m, above touchdown. Otherwise it
    falls to zero at a height where the lander can tilt, which is higher for a faster drift and a
    larger offset. With a fast drift, a lander below that height climbs slowly. For a return, the
    lander descends at a fraction of `nominal` or faster; the fraction falls to zero as the speed
    towards the site, `closing`, m/s, rises to that of the position loop. At a `mass` (kg) with
    little propellant left, it descends at this fraction or faster even if it drifts. `state` (2, 3)
    is position and velocity; `law` is a `VerticalDescentParams`.
    """
    excess = max(np.hypot(state[1, 0], state[1, 1]) - law.tolerated_speed, 0.0)
    stopping = excess / _planned_deceleration(height, law)
    drifts = stopping > 0.0 and -nominal * stopping > height
    returning = _return_time(offset, height, nominal, mass, law)
    needed = max(stopping, returning)
    if not drifts and (returning == 0.0 or -nominal * needed <= height):
        return nominal, False
    slowest = law.min_speed_fraction * nominal
    if mass <= law.dry_mass + law.hold_propellant:
        return min(-height / stopping, slowest), True
    beside = offset / law.tolerated_offset - 1.0 if returning > 0.0 else 0.0
    held = law.low_height * min(max(excess / law.tolerated_speed, beside), 1.0)
    wanted = min((held - height) / needed, MAX_CLIMB_SPEED_M_S)
    if not drifts:
        approach = _closing_fraction(closing, offset, height, nominal, law)
        wanted = min(wanted, (1.0 - approach) * slowest)
    return wanted, drifts


@kernel(exact=True)
def vertical_descent_command(state, end, nominal, mass, law, command):
    """Write the thrust acceleration of the vertical descent to `command` (3,), m/s^2.

    `state` (2, 3) is position and velocity, ENU, `end` (3,) the position of the centre of mass at
    touchdown, m, `nominal` the nominal vertical velocity, m/s, and `mass` the lander's mass, kg.
    `law` is a `VerticalDescentParams`.
    """
    height = state[0, 2] - end[2]
    east, north = end[0] - state[0, 0], end[1] - state[0, 1]
    offset = np.hypot(east, north)
    closing = (east * state[1, 0] + north * state[1, 1]) / max(offset, 1e-12)
    wanted, drifts = _limit_descent_speed(state, height, offset, closing, nominal, mass, law)
    tan_tilt = _tan_max_tilt(height, law.low_height if drifts else law.full_tilt_height, law)
    up = max(law.gravity + law.speed_gain * (wanted - state[1, 2]), 0.3 * law.gravity)
    returns = _return_time(offset, height, nominal, mass, law) > 0.0
    planned = min(wanted, law.min_speed_fraction * nominal) if returns else nominal
    gain = law.frequency**2 * _position_gain(offset, height, planned, law)
    for k in range(2):
        toward = gain * (end[k] - state[0, k])
        command[k] = toward - 2.0 * law.damping * law.frequency * state[1, k]
    limit, size = up * tan_tilt, np.hypot(command[0], command[1])
    # The lander becomes upright before touchdown, unless it holds its height or climbs.
    upright_height = law.upright_time * max(-wanted, 0.0)
    fraction = min(max(height, 0.0) / upright_height, 1.0) if upright_height > 0.0 else 1.0
    if size > limit:
        fraction *= limit / size
    command[0] *= fraction
    command[1] *= fraction
    command[2] = up


@kernel(exact=True)
def exceeds_limits(command, mass, max_tilt, max_thrust, slack):
    """Return whether a command violates a limit of tilt or thrust by over `slack`.

    `command` (3,) is the thrust acceleration, m/s^2, `mass` in kg, `max_tilt` in rad, `max_thrust`
    in N, and `slack` a fraction of the limits.
    """
    side = np.hypot(command[0], command[1])
    tilt, thrust = np.arctan2(side, command[2]), mass * np.hypot(side, command[2])
    return not (tilt <= (1.0 + slack) * max_tilt and thrust <= (1.0 + slack) * max_thrust)
