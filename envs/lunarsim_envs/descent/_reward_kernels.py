# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled reward terms of descents, and the reference velocity of the shaping."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.touchdown import LIMITS, VALUES
from lunarsim_envs.descent._kernels import FLYING, LANDED, LOST

# Reward terms in the order of their sum, and the row of each in an array of terms.
TERMS = ("touchdown", "propellant", "miss", "excess", "severity", "shaping")
_TOUCHDOWN, _PROPELLANT, _MISS, _EXCESS, _SEVERITY, _SHAPING = range(len(TERMS))
# Maximum miss distance in the reward, m.
MAX_MISS_M = 50.0
# Maximum excess over a limit (natural logarithm of the ratio).
MAX_EXCESS = 3.0
# Limits of motion at touchdown, and the columns of their values.
MOTION_LIMITS = tuple(limit for limit in LIMITS if not limit.is_terrain)
_COLUMNS = np.array([VALUES.index(limit.value) for limit in MOTION_LIMITS])
# Deceleration of the reference velocity over the maximum one (full thrust minus gravity, full
# tanks). Touchdown speed over the vertical speed limit.
_BRAKES, _LANDS = 0.38, 0.4
# Near the target, the reference speed is the distance over _LAST, s. The horizontal speed is
# increased by _SOONER, so that the lander is above the target before it is down.
_LAST, _SOONER = 4.0, 1.5


class Weights(NamedTuple):
    """Weights of the reward terms, those of `lunarsim.scenario.rewards.DescentReward`."""

    safe: float
    crash: float
    no_landing: float
    propellant: float
    miss: float
    severity: float
    excess: float
    shaping: float


class RewardParams(NamedTuple):
    """Reward weights, and properties of start and lander that rewards need, SI.

    `start_distance` is the distance of the planned start from the target, `deceleration` is the
    maximum one with full tanks, and `limits` (n,) are the limits of motion at touchdown, in the
    order of `MOTION_LIMITS`.
    """

    weights: Weights
    start_distance: float
    com_height: float
    deceleration: float
    vertical_speed_limit: float
    horizontal_speed_limit: float
    rate_limit: float
    limits: np.ndarray


@kernel(exact=True)
def _norm(x, y, z):
    """Return the length of a vector."""
    return np.sqrt(x * x + y * y + z * z)


@kernel(exact=True)
def _nearness(y, target, params):
    """Return how near the target is: T / (T + sqrt(r / 2 a)), from 0 to 1.

    `reference_velocity` defines the symbols.
    """
    east, north = y[0] - target[0], y[1] - target[1]
    up = max(y[2] - target[2] - params.com_height, 0.0)
    return _LAST / (
        _LAST + np.sqrt(_norm(east, north, up) / (2.0 * (_BRAKES * params.deceleration)))
    )


@kernel(exact=True)
def reference_velocity(y, target, params):
    """Return a lander's reference velocity towards its target, ENU, m/s.

    It is the vector to the target divided by T + sqrt(r / 2 a), where r is the distance, a is 0.38
    of the maximum deceleration and T is 4 s. Far away its norm is about sqrt(2 a r), which
    corresponds to a constant deceleration a; near the target it is r / T. The horizontal part is
    increased, by up to 2.5 times near the target, so that the lander is above the target before
    touchdown. Vertically it aims at a point slightly below the terrain, so that touchdown occurs at
    a speed within the limit. Rewards based on a velocity field: Gaudet, Linares and Furfaro, "Deep
    reinforcement learning for six degree-of-freedom planetary landing", Advances in Space Research
    65, 2020. `y` (15,) is the state of the lander and `target` (3,) its target.
    """
    east, north = y[0] - target[0], y[1] - target[1]
    up = max(y[2] - target[2] - params.com_height, 0.0)
    near = _nearness(y, target, params)
    time, sooner = _LAST / near, 1.0 + _SOONER * near
    below = _LAST * _LANDS * params.vertical_speed_limit
    return -(east * sooner) / time, -(north * sooner) / time, -(up + below) / time


@kernel(exact=True)
def _potential(y, target, params):
    """Return the shaping potential of a lander with state `y` (15,) and `target` (3,).

    It falls with log(1 + e / horizontal speed limit), where e is the deviation from the reference
    velocity, and near the target also with log(1 + rate / rate limit). The logarithm distinguishes
    1 from 2 m/s near the end as well as 10 from 20 m/s earlier.
    """
    east, north, up = reference_velocity(y, target, params)
    deviation = _norm(y[3] - east, y[4] - north, y[5] - up)
    rate = _norm(y[10], y[11], y[12])
    return -params.weights.shaping * (
        np.log1p(deviation / params.horizontal_speed_limit)
        + _nearness(y, target, params) * np.log1p(rate / params.rate_limit)
    )


@kernel(exact=True)
def _severity(y, target, params):
    """Return the distance from the target over that of the planned start.

    It is at most 1. `y` (15,) is the state of the lander and `target` (3,) its target.
    """
    away = _norm(y[0] - target[0], y[1] - target[1], y[2] - target[2])
    return min(away / params.start_distance, 1.0)


@kernel(exact=True)
def _excess(touchdown_values, params):
    """Return by how much a touchdown exceeds its limits.

    It is the sum over the limits of motion (speeds, tilt, rates) of log(value / limit), or 0 within
    the limit. Each logarithm is at most 3, also for values that are not finite.
    """
    total = 0.0
    for k in range(len(_COLUMNS)):
        ratio = abs(touchdown_values[_COLUMNS[k]]) / params.limits[k]
        total += min(np.log(max(ratio, 1.0)), MAX_EXCESS) if np.isfinite(ratio) else MAX_EXCESS
    return total


@kernel()
def shaping_potentials(y, target, params, out):
    """Write the shaping potentials of n landers to `out` (n,).

    `y` (n, 15) are their states and `target` (n, 3) their targets.
    """
    for i in range(len(y)):
        out[i] = _potential(y[i], target[i], params)


@kernel()
def reward_terms(
    moved, y, target, ended, failed, touchdown_values, params, mass, potential, score, terms
):  # fmt: skip
    """Write the reward terms of the last step of some landers to `terms` (6, n).

    `moved` (n,) marks these landers; values of others are not written. `terms` has a row for each
    of `TERMS`. `mass` and `potential` (n,) are those before the step, and are set to those after
    it; the terms without shaping are added to `score` (n,). `y`, `target`, `ended`, `failed` and
    `touchdown_values` are attributes of `DescentBatch`.
    """
    w = params.weights
    for i in range(len(y)):
        if not moved[i]:
            continue
        over = ended[i] != FLYING
        after = 0.0 if over else _potential(y[i], target[i], params)
        terms[_PROPELLANT, i] = -w.propellant * (mass[i] - y[i, 13])
        terms[_SHAPING, i] = after - potential[i]
        mass[i], potential[i] = y[i, 13], after
        if ended[i] == LANDED and failed[i] == 0:
            miss = _norm(y[i, 0] - target[i, 0], y[i, 1] - target[i, 1], 0.0)
            terms[_TOUCHDOWN, i] = w.safe
            terms[_MISS, i] = -w.miss * min(miss, MAX_MISS_M)
        elif ended[i] == LANDED or ended[i] == LOST:
            terms[_TOUCHDOWN, i] = w.crash
            terms[_EXCESS, i] = -w.excess * _excess(touchdown_values[i], params)
            terms[_SEVERITY, i] = -w.severity * _severity(y[i], target[i], params)
        elif over:
            terms[_TOUCHDOWN, i] = w.no_landing
        for k in range(_SHAPING):
            score[i] += terms[k, i]
