"""Compiled descents, a lane each: draws at the start, and the way from one action to the next.

The vehicle, the attitude loop and the touchdown are the simulation's own kernels. A lane's draws
hang on its key and on how many flights it has begun, on nothing else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._frame_kernels import rotation_between
from lunarsim._jit import kernel
from lunarsim.onboard.control._kernels import demand, follow, steer
from lunarsim.vehicle._kernels import advance_bodies
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


# What of a flight's draws are where: see `variation.DRAWN`.
LOAD, IMPULSE, THRUST, LAG, OFFSET, FAILS, ENGINE, TORQUE, SEES_LATE, ACTS_LATE = (
    0, 1, 2, 3, 4, 6, 7, 8, 11, 12,
)  # fmt: skip
DRAWS = 13
# Sets these draws apart from those of the start.
VARIED = np.uint64(0xD1342543DE82EF95)


@kernel()
def draw(key, flight, ranges, out):
    """Draw what is a flight's own (13,) from the ranges of `Variation` (12,)."""
    key = np.uint64(key) ^ VARIED
    first = flight * 2 * DRAWS
    for k in range(6):
        out[k] = ranges[k] * (2.0 * uniform(key, first + k) - 1.0)
    out[FAILS] = ranges[6] * uniform(key, first + 6)
    left = ranges[9] + (1.0 - ranges[9]) * uniform(key, first + 7)
    out[ENGINE] = left if uniform(key, first + 8) < ranges[7] else 1.0
    weak = min(int(3.0 * uniform(key, first + 9)), 2)
    left = ranges[9] + (1.0 - ranges[9]) * uniform(key, first + 10)
    for k in range(3):
        out[TORQUE + k] = 1.0
    if uniform(key, first + 11) < ranges[8]:
        out[TORQUE + weak] = left
    for k in range(2):
        out[SEES_LATE + k] = ranges[10 + k] * uniform(key, first + 12 + k)


@kernel(shared=True)
def vary(share, mask, keys, begun, ranges, standard, nominal, drawn, figures, y):
    """Draw what is their own of the flights in the lanes of `mask` (n,), which have begun.

    Parameters
    ----------
    mask, keys, begun
        As `begin` takes them, after it.
    ranges, standard
        Of `Variation` (12,); standard gravity, m/s^2.
    nominal
        Gravity, exhaust velocity, lag, dry and wet mass of the lander (5,).
    drawn, figures, y
        Draws (n, 13); each lander's own figures (n, 5); states (n, 15), whose mass is set.
    """
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        draw(keys[i], begun[i] - 1, ranges, drawn[i])
        own = drawn[i]
        figures[i, 0] = nominal[0]
        figures[i, 1] = nominal[1] + own[IMPULSE] * standard
        figures[i, 2] = nominal[2] + own[LAG]
        figures[i, 3] = nominal[3] + own[LOAD]
        figures[i, 4] = nominal[4] + own[LOAD]
        y[i, 13] = figures[i, 4]


@kernel(shared=True)
def scatter(share, mask, keys, counts, out):
    """Write standard normal numbers into the rows of `out` (n, k) in `mask`, and count them."""
    for i in range(share[0], len(out), share[1]):
        if mask[i]:
            for k in range(out.shape[1]):
                out[i, k] = normal(np.uint64(keys[i]) ^ _FIRST, counts[i])
                counts[i] += 2


class Vehicle(NamedTuple):
    """Landers and how they are flown, SI; see `advance_bodies` and `judge` for the rest.

    `figures` (n, 5) and `drawn` (n, 13) are each lander's own, see `vary`; `control` (9,): least
    and greatest thrust, tilt, gains of the attitude loop, greatest torques.
    """

    figures: np.ndarray
    drawn: np.ndarray
    inertia: np.ndarray
    rig: np.ndarray
    control: np.ndarray
    heading: float
    pads: np.ndarray
    disc: np.ndarray
    spacing: float
    limits: np.ndarray
    com_height: float


class Grounds(NamedTuple):
    """Heights with rocks of each world (k, rows, cols), where they are, the extremes (k, 2), m."""

    z: np.ndarray
    frame: np.ndarray
    levels: np.ndarray


class Flights(NamedTuple):
    """How flights stand (n,): world, time (s), end, limits failed, and the touchdown (n, 7)."""

    world: np.ndarray
    time: np.ndarray
    ended: np.ndarray
    failed: np.ndarray
    told: np.ndarray


@kernel()
def _ask(y, loop, action, guided, vehicle, load, attitude):
    """Return the thrust that an action asks for, N; the attitude, or torques, go where they act.

    A load that was drawn is not known: the thrust is that for the mass without it.
    """
    control = vehicle.control
    if guided:
        for k in range(4):
            loop[k] = y[6 + k]
        return steer(
            action, y[13] - load, control[0], control[1], vehicle.heading, control[2], attitude
        )
    for k in range(3):
        loop[7 + k] = min(max(action[1 + k], -control[6 + k]), control[6 + k])
    return min(max(action[0], control[0]), control[1])


@kernel()
def _end(i, y, vehicle, grounds, flights):
    """Return 1 if a flight has ended, on the ground or under the map, and note how; else 0."""
    w = flights.world[i]
    z, frame = grounds.z[w], grounds.frame
    if touches(y, vehicle.pads, vehicle.disc, z, frame):
        figures = vehicle.figures[i]
        flights.ended[i] = LANDED
        flights.failed[i] = judge(
            y, vehicle.pads, vehicle.disc, vehicle.spacing, z, frame, vehicle.limits,
            vehicle.com_height, figures[0], figures[3], figures[4], vehicle.inertia,
            flights.told[i],
        )  # fmt: skip
        return 1
    if y[2] < grounds.levels[w, 0] - 1.0:
        flights.ended[i] = LOST
        flights.failed[i] = OFF_MAP
        return 1
    return 0


@kernel()
def _loaded(first, beyond, ended, y, lanes, block):
    """Take the lanes that are in flight into a block (15, width), and return how many there are.

    What room is left is filled with the first of them, which comes to no harm.
    """
    count = 0
    for i in range(first, beyond):
        if ended[i] == FLYING:
            lanes[count] = i
            count += 1
    for n in range(block.shape[1] if count > 0 else 0):
        i = lanes[n] if n < count else lanes[0]
        for s in range(15):
            block[s, n] = y[i, s]
    return count


@kernel()
def _figured(lanes, count, own, block):
    """Take the figures (n, 5) of the lanes of a block into it (5, width), as `_loaded` does."""
    for n in range(block.shape[1] if count > 0 else 0):
        i = lanes[n] if n < count else lanes[0]
        for k in range(5):
            block[k, n] = own[i, k]


@kernel()
def _moments(mass, figures, inertia, out):
    """Write the principal moments at a mass (3,), as the attitude loop knows them."""
    dry, wet = figures[3], figures[4]
    full = (mass - dry) / (wet - dry)
    for k in range(3):
        out[k] = inertia[0, k] + full * (inertia[1, k] - inertia[0, k])


@kernel()
def _quaternion(block, n, out):
    for k in range(4):
        out[k] = block[6 + k, n]


@kernel()
def _followed(block, n, before, loop, dt, after, turn):
    """Let a lane's attitude loop follow what its gyroscopes have seen over a step."""
    _quaternion(block, n, after)
    rotation_between(before, after, turn)
    follow(loop, turn, dt)


@kernel()
def _stored(block, n, y):
    for s in range(15):
        y[s] = block[s, n]


@kernel()
def _given(loop, drawn, time, asked, thrust, torque, n):
    """Return the thrust that comes of what is asked, N; write the torques (3, n), N m.

    The engine's line off the centre of mass turns the lander by its thrust at the step's start.
    """
    failed = time >= drawn[FAILS]
    for k in range(3):
        torque[k, n] = loop[7 + k] * drawn[TORQUE + k] if failed else loop[7 + k]
    torque[0, n] += drawn[OFFSET + 1] * thrust
    torque[1, n] -= drawn[OFFSET] * thrust
    asked *= 1.0 + drawn[THRUST]
    return asked * drawn[ENGINE] if failed else asked


@kernel(shared=True)
def advance(share, y, loop, actions, guided, steps, dt, limit, width, vehicle, grounds, flights):
    """Fly every lane that is in flight for `steps` steps under its action, or to its end.

    Parameters
    ----------
    y, loop
        State (n, 15) and attitude loop (n, 10).
    actions, guided
        Thrust accelerations (n, 3), m/s^2, for the attitude loop; or thrust and torques (n, 4), N.
    steps, dt, limit, width
        Steps of the integration, their length, when a flight is over, s; lanes that are integrated
        side by side, on which nothing depends.
    vehicle, grounds, flights
        See there.
    """
    v = vehicle
    inertia, rig, gains, most = v.inertia, v.rig, v.control[3:6], v.control[6:]
    time, ended = flights.time, flights.ended
    reach = np.sqrt(np.max(np.sum(v.pads * v.pads, axis=1))) + 0.1
    lanes = np.empty(width, np.int64)
    block, work = np.empty((15, width)), np.empty((5, 15, width))
    asked, torque = np.zeros(width), np.zeros((3, width))
    gives, figures = np.zeros(width), np.ones((5, width))
    attitude, before, known = np.empty((width, 4)), np.empty((width, 4)), np.empty((width, 3))
    after, turn = np.empty(4), np.empty(3)
    for b in range(share[0], (len(y) + width - 1) // width, share[1]):
        count = _loaded(b * width, min((b + 1) * width, len(y)), ended, y, lanes, block)
        _figured(lanes, count, v.figures, figures)
        for n in range(count):
            i = lanes[n]
            asked[n] = _ask(y[i], loop[i], actions[i], guided, v, v.drawn[i, LOAD], attitude[n])
            _moments(y[i, 13], v.figures[i], inertia, known[n])
        left = count
        for _ in range(steps):
            if left == 0:
                break
            for n in range(count):
                i = lanes[n]
                if guided:
                    demand(loop[i], attitude[n], gains, known[n], most)
                    _quaternion(block, n, before[n])
                gives[n] = _given(loop[i], v.drawn[i], time[i], asked[n], block[14, n], torque, n)
            advance_bodies(block, dt, gives, torque, figures, inertia, rig, work)
            for n in range(count):
                i = lanes[n]
                if ended[i] != FLYING:
                    continue
                time[i] += dt
                if guided:
                    _followed(block, n, before[n], loop[i], dt, after, turn)
                if block[2, n] - reach <= grounds.levels[flights.world[i], 1]:
                    _stored(block, n, y[i])
                    left -= _end(i, y[i], v, grounds, flights)
        for n in range(count):
            i = lanes[n]
            if ended[i] == FLYING:
                _stored(block, n, y[i])
                if time[i] >= limit - 0.5 * dt:
                    ended[i] = LATE
