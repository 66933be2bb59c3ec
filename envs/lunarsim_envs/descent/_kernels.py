"""Compiled descents, a lane each: draws at the start, and the way from one action to the next.

The vehicle, the attitude loop and the touchdown are the simulation's own kernels. A lane's draws
hang on its key and on how many flights it has begun, on nothing else.
"""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotation_between
from lunarsim._jit import kernel
from lunarsim.onboard.control._kernels import demand, follow, steer
from lunarsim.vehicle._kernels import advance_body
from lunarsim.vehicle._touchdown_kernels import OFF_MAP, height_at, judge, touches

# How a flight stands.
FLYING, LANDED, LOST, LATE = 0, 1, 2, 3
# Draws that a flight has room for.
_DRAWS = 16
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


@kernel()
def uniform(key, count):
    """Return draw number `count` of a key, in (0, 1).

    SplitMix64: Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014.
    """
    x = np.uint64(key) + _GOLDEN * np.uint64(count + 1)
    x = (x ^ (x >> np.uint64(30))) * _FIRST
    x = (x ^ (x >> np.uint64(27))) * _SECOND
    x = x ^ (x >> np.uint64(31))
    return (np.float64(x >> np.uint64(12)) + 0.5) * 2.0**-52


@kernel()
def normal(key, count):
    """Return a standard normal draw of a key from its draws `count` and `count` + 1."""
    size = np.sqrt(-2.0 * np.log(uniform(key, count)))
    return size * np.cos(2.0 * np.pi * uniform(key, count + 1))


@kernel(shared=True)
def begin(
    share, mask, keys, begun, y, loop, target, world, time, ended, starts, aim, upright, weight,
    reliefs, frame,
):  # fmt: skip
    """Draw and set a new flight in every lane of `mask`.

    Parameters
    ----------
    mask, keys, begun
        Lanes to begin (n,), their keys (n,) and how many flights each has begun (n,).
    y, loop, target, world, time, ended
        State (n, 15), attitude loop (n, 10), target (n, 3), index of the world, s, how it stands.
    starts
        Planned position over the target and velocity, and their standard deviations (n, 8).
    aim
        Middle and half sides of the targets' scatter (4,), m.
    upright, weight
        Attitude at the start (4,); mass (kg) and thrust (N) (2,).
    reliefs, frame
        Ground without rocks of each world (k, rows, cols), and where it is: see `height_at`.
    """
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        first = begun[i] * _DRAWS
        begun[i] += 1
        key = keys[i]
        world[i] = min(int(uniform(key, first) * len(reliefs)), len(reliefs) - 1)
        for k in range(2):
            target[i, k] = aim[k] + aim[2 + k] * (2.0 * uniform(key, first + 1 + k) - 1.0)
        target[i, 2] = height_at(reliefs[world[i]], frame, target[i, 0], target[i, 1])
        for k in range(3):
            off = normal(key, first + 3 + 2 * k)
            y[i, k] = target[i, k] + starts[i, k] + starts[i, 6] * off
            off = normal(key, first + 9 + 2 * k)
            y[i, 3 + k] = starts[i, 3 + k] + starts[i, 7] * off
        for k in range(4):
            y[i, 6 + k] = upright[k]
            loop[i, k] = upright[k]
        for k in range(3):
            y[i, 10 + k] = 0.0
        y[i, 13] = weight[0]
        y[i, 14] = weight[1]
        for k in range(4, 10):
            loop[i, k] = 0.0
        time[i] = 0.0
        ended[i] = FLYING


@kernel()
def _ask(y, loop, action, guided, lander, heading, attitude):
    """Return the thrust that an action asks for, N; the attitude, or torques, go where they act.

    `lander` (9,): least and greatest thrust, tilt, gains of the attitude loop, greatest torques.
    """
    if guided:
        for k in range(4):
            loop[k] = y[6 + k]
        return steer(action, y[13], lander[0], lander[1], heading, lander[2], attitude)
    for k in range(3):
        loop[7 + k] = min(max(action[1 + k], -lander[6 + k]), lander[6 + k])
    return min(max(action[0], lander[0]), lander[1])


@kernel(shared=True)
def advance(
    share, active, y, loop, actions, guided, steps, dt, limit, figures, inertia, rig, lander,
    heading, pads, disc, spacing, limits, com_height, grounds, frame, levels, world, time, ended,
    failed, told,
):  # fmt: skip
    """Fly every active lane for `steps` steps under its action, or to its end.

    Parameters
    ----------
    active
        Lanes that fly (n,).
    y, loop
        State (n, 15) and attitude loop (n, 10).
    actions, guided
        With `guided` thrust accelerations (n, 3), ENU, m/s^2, that the attitude loop follows on
        perfect gyroscopes; else thrust and torques (n, 4), N and N m.
    steps, dt, limit
        Steps of the integration, their length, and when a flight is over, s.
    figures, inertia, rig
        Of the vehicle: see `advance_body`.
    lander, heading
        See `_ask`.
    pads, disc, spacing, limits, com_height
        See `judge`.
    grounds, frame, levels, world
        Ground with rocks of each world (k, rows, cols), where it is, its least and greatest
        height (k, 2), and the world of each lane.
    time, ended, failed, told
        Time of flight (n,), s; how each stands (n,); limits failed (n,) and figures of the
        touchdown (n, 7): see `judge`.
    """
    work = np.empty((5, 15))
    attitude = np.empty(4)
    known = np.empty(3)
    before = np.empty(4)
    turn = np.empty(3)
    reach = np.sqrt(np.max(np.sum(pads * pads, axis=1))) + 0.1
    for i in range(share[0], len(y), share[1]):
        if not active[i]:
            continue
        here, own = y[i], loop[i]
        thrust = _ask(here, own, actions[i], guided, lander, heading, attitude)
        full = (here[13] - figures[3]) / (figures[4] - figures[3])
        for k in range(3):
            known[k] = inertia[0, k] + full * (inertia[1, k] - inertia[0, k])
        w = world[i]
        for _ in range(steps):
            if guided:
                demand(own, attitude, lander[3:6], known, lander[6:])
            for k in range(4):
                before[k] = here[6 + k]
            advance_body(here, dt, thrust, own[7:], figures, inertia, rig, work)
            time[i] += dt
            if guided:
                rotation_between(before, here[6:10], turn)
                follow(own, turn, dt)
            if here[2] - reach <= levels[w, 1] and touches(here, pads, disc, grounds[w], frame):
                ended[i] = LANDED
                failed[i] = judge(
                    here, pads, disc, spacing, grounds[w], frame, limits, com_height, figures[0],
                    figures[3], figures[4], inertia, told[i],
                )  # fmt: skip
                break
            if here[2] < levels[w, 0] - 1.0:
                ended[i] = LOST
                failed[i] = OFF_MAP
                break
        if ended[i] == FLYING and time[i] >= limit - 0.5 * dt:
            ended[i] = LATE
