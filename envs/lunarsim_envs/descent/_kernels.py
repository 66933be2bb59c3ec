# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernels of descents: random starts, flight steps and touchdown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.control._kernels import thrust_attitude
from lunarsim.vehicle._kernels import advance_bodies
from lunarsim.vehicle._touchdown_kernels import OFF_MAP, has_contact, height_at, violated_limits
from lunarsim_envs.descent import _loop_kernels as loop

# Status of a flight.
FLYING, LANDED, LOST, LATE = 0, 1, 2, 3
# Random draws reserved for each flight.
_DRAWS = 16
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


@kernel()
def uniform(key, count):
    """Return random number `count` of a stream, uniform in (0, 1).

    The 64-bit integer `key` selects the stream; the generator is SplitMix64 (Steele et al. 2014).
    """
    x = np.uint64(key) + _GOLDEN * np.uint64(count + 1)
    x = (x ^ (x >> np.uint64(30))) * _FIRST
    x = (x ^ (x >> np.uint64(27))) * _SECOND
    x = x ^ (x >> np.uint64(31))
    return (np.float64(x >> np.uint64(12)) + 0.5) * 2.0**-52


@kernel()
def normal(key, count):
    """Return a standard normal number from numbers `count`, `count` + 1 of a stream.

    The 64-bit integer `key` selects the stream.
    """
    size = np.sqrt(-2.0 * np.log(uniform(key, count)))
    return size * np.cos(2.0 * np.pi * uniform(key, count + 1))


@kernel(shared=True)
def begin(
    share, mask, keys, counts, y, rate, target, world, time, ended, starts, aims, spans, upright,
    weight, reliefs, frame,
):  # fmt: skip
    """Sample start, target and world of new flights for the landers of `mask` (n,).

    `keys` and `counts` (n,) are the random streams and their numbers of flights; `spans` (n, 2) has
    the first allowed world and the number of worlds; `upright` is the initial attitude and `weight`
    the initial mass (kg) and thrust (N). Other arguments are attributes of `DescentBatch`;
    `reliefs` and `frame` are terrain without rocks. `share` is (thread, number of threads).
    """
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        first = counts[i] * _DRAWS
        counts[i] += 1
        key = keys[i]
        worlds = spans[i, 1]
        world[i] = spans[i, 0] + min(int(uniform(key, first) * worlds), worlds - 1)
        aim = aims[i]
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
        for k in range(3):
            y[i, 10 + k] = 0.0
            rate[i, k] = 0.0
        y[i, 13] = weight[0]
        y[i, 14] = weight[1]
        time[i] = 0.0
        ended[i] = FLYING


# Indices of the randomized parameters, in the order of `domain_randomization.DRAWN`.
LOAD, IMPULSE, THRUST, LAG, OFFSET, FAILS, ENGINE, TORQUE, SEES_LATE, ACTS_LATE = (
    0, 1, 2, 3, 4, 6, 7, 8, 11, 12,
)  # fmt: skip
DRAWS = 13
# Random stream of the randomized parameters.
VARIED = np.uint64(0xD1342543DE82EF95)


@kernel()
def draw(key, flight, ranges, out):
    """Sample the randomized vehicle parameters of one flight into `out` (13,).

    `key` selects the random stream of the lander, `flight` is the number of the flight, and
    `ranges` (12,) is `DomainRandomization.ranges`.
    """
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
def vary(share, mask, keys, counts, ranges, standard, nominal, drawn, figures, y):
    """Sample new randomized vehicle parameters for the started flights of `mask` (n,).

    `standard` is standard gravity, m/s^2; `nominal` (5,) has the nominal gravity, exhaust velocity,
    thrust lag, dry mass and wet mass. Writes `drawn` (n, 13), `figures` (n, 5) and the mass in `y`.
    `share` is (thread, number of threads).
    """
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        draw(keys[i], counts[i] - 1, ranges, drawn[i])
        own = drawn[i]
        figures[i, 0] = nominal[0]
        figures[i, 1] = nominal[1] + own[IMPULSE] * standard
        figures[i, 2] = nominal[2] + own[LAG]
        figures[i, 3] = nominal[3] + own[LOAD]
        figures[i, 4] = nominal[4] + own[LOAD]
        y[i, 13] = figures[i, 4]


@kernel(shared=True)
def scatter(share, mask, keys, counts, out):
    """Write standard normal numbers to rows `mask` of `out` (n, k).

    `counts` (n,) is the position in each random stream `keys` (n,) and is advanced. `share` is
    (thread, number of threads).
    """
    for i in range(share[0], len(out), share[1]):
        if mask[i]:
            for k in range(out.shape[1]):
                out[i, k] = normal(np.uint64(keys[i]) ^ _FIRST, counts[i])
                counts[i] += 2


class Vehicle(NamedTuple):
    """Vehicle parameters of a batch of n landers, SI.

    `figures` (n, 5) has gravity, exhaust velocity, thrust lag, dry and wet mass, and `drawn` (n,
    13) the other randomized parameters of each lander. `control` (9,) has minimum and maximum
    thrust, maximum tilt, gains of the attitude loop (3) and maximum torques (3). `inertia` and
    `rig` are arguments of `advance_bodies`; the fields from `pads` on describe the touchdown
    (`violated_limits`); `heading` is the azimuth of body x, rad.
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


class TerrainRasters(NamedTuple):
    """Terrain of k worlds: heights with rocks, grid and height ranges, m.

    `z` (k, rows, cols) are heights; `frame` (3,) has east and north of cell (0, 0) and the grid
    spacing; `levels` (k, 2) has minimum and maximum height.
    """

    z: np.ndarray
    frame: np.ndarray
    levels: np.ndarray


class Flights(NamedTuple):
    """Status of the flights of n landers, each field an attribute of `DescentBatch`.

    World index, time (s), status (FLYING, ...) and violated limits (n,); touchdown values (n, 7).
    """

    world: np.ndarray
    time: np.ndarray
    ended: np.ndarray
    failed: np.ndarray
    touchdown_values: np.ndarray


@kernel()
def _end(i, y, vehicle, terrains, flights):
    """Check if lander `i`, in state `y` (15,), has touched down or left the map.

    Records the end in `flights` and returns 1, or returns 0 while the flight continues.
    """
    w = flights.world[i]
    z, frame = terrains.z[w], terrains.frame
    if has_contact(y, vehicle.pads, vehicle.disc, z, frame):
        figures = vehicle.figures[i]
        flights.ended[i] = LANDED
        flights.failed[i] = violated_limits(
            y, vehicle.pads, vehicle.disc, vehicle.spacing, z, frame, vehicle.limits,
            vehicle.com_height, figures[0], figures[3], figures[4], vehicle.inertia,
            flights.touchdown_values[i],
        )  # fmt: skip
        return 1
    if y[2] < terrains.levels[w, 0] - 1.0:
        flights.ended[i] = LOST
        flights.failed[i] = OFF_MAP
        return 1
    return 0


@kernel(exact=True)
def _loaded(first, beyond, ended, y, lanes, block):
    """Copy the states of flying landers to `block` (15, width), one column each.

    `first` and `beyond` bound the indices of landers; their indices are written to `lanes`. Empty
    columns repeat the first lander. Returns the number of flying landers.
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


@kernel(exact=True)
def _asked(block, own, n, action, guided, control, heading, load, attitude):
    """Convert an action to commanded thrust, and attitude or torques, of one lander.

    `action` is in physical units: thrust acceleration if `guided`, otherwise thrust and torques.
    The command is computed with the nominal mass, without the random payload `load`, kg.
    """
    if guided:
        own[loop.THRUST, n] = thrust_attitude(
            action, block[13, n] - load, control[0], control[1], heading, control[2], attitude
        )
        for k in range(4):
            own[loop.AIM + k, n] = attitude[k]
        return
    own[loop.THRUST, n] = min(max(action[0], control[0]), control[1])
    for k in range(3):
        own[loop.TORQUE + k, n] = min(max(action[1 + k], -control[6 + k]), control[6 + k])


@kernel(exact=True)
def _takes(i, block, own, n, figures, rate, vehicle, levels, reach, flights):
    """Copy vehicle parameters and controller state of lander i to column n of a block.

    `own` gets the rows of `_loop_kernels`; `figures` (5, width) the vehicle parameters; `reach` is
    the distance from the centre of mass to the pads plus a margin, m.
    """
    for k in range(5):
        figures[k, n] = vehicle.figures[i, k]
    drawn, inertia = vehicle.drawn[i], vehicle.inertia
    # Moments of inertia at the current mass, which the attitude loop uses.
    full = (block[13, n] - figures[3, n]) / (figures[4, n] - figures[3, n])
    for k in range(3):
        own[loop.MOMENT + k, n] = inertia[0, k] + full * (inertia[1, k] - inertia[0, k])
        own[loop.RATE + k, n] = rate[i, k]
        own[loop.WEAK + k, n] = drawn[TORQUE + k]
    own[loop.TIME, n] = flights.time[i]
    own[loop.FAILS, n], own[loop.ENGINE, n] = drawn[FAILS], drawn[ENGINE]
    own[loop.SHARE, n] = drawn[THRUST]
    own[loop.OFFSET, n], own[loop.OFFSET + 1, n] = drawn[OFFSET], drawn[OFFSET + 1]
    own[loop.FLOOR, n] = levels[flights.world[i], 1] + reach


@kernel(exact=True)
def _stored(block, own, n, i, y, rate, flights):
    """Copy state, body rate and time from column n of a block back to lander i."""
    for s in range(15):
        y[i, s] = block[s, n]
    for k in range(3):
        rate[i, k] = own[loop.RATE + k, n]
    flights.time[i] = own[loop.TIME, n]


@kernel()
def _ended(block, own, count, lanes, y, rate, vehicle, terrains, flights):
    """Check which landers of a block near the terrain have ended their flight.

    `count` is the number of landers in the block and `lanes` their indices. Returns the number of
    flights that ended in this step.
    """
    over = 0
    for n in range(count):
        i = lanes[n]
        if flights.ended[i] == FLYING and block[2, n] <= own[loop.FLOOR, n]:
            _stored(block, own, n, i, y, rate, flights)
            over += _end(i, y[i], vehicle, terrains, flights)
    return over


@kernel(shared=True)
def advance(share, y, rate, actions, guided, steps, dt, limit, width, vehicle, terrains, flights):
    """Fly all flying landers for `steps` integration steps, or to their end.

    `y` (n, 15) are the states and `rate` (n, 3) the measured body rates; `actions` are thrust
    accelerations if `guided`, otherwise thrust and torques. `dt` is the time step and `limit` the
    time limit, s; landers are flown in blocks of `width`. `share` is (thread, number of threads).
    """
    v, ended = vehicle, flights.ended
    gains, most = v.control[3:6], v.control[6:]
    reach = np.sqrt(np.max(np.sum(v.pads * v.pads, axis=1))) + 0.1
    lanes, attitude = np.empty(width, np.int64), np.empty(4)
    block, work = np.empty((15, width)), np.empty((5, 15, width))
    own, spare = np.empty((loop.ROWS, width)), np.empty((3, width))
    gives, torque, figures = np.zeros(width), np.zeros((3, width)), np.ones((5, width))
    for b in range(share[0], (len(y) + width - 1) // width, share[1]):
        count = _loaded(b * width, min((b + 1) * width, len(y)), ended, y, lanes, block)
        if count == 0:
            continue
        for n in range(width):
            i = lanes[n] if n < count else lanes[0]
            _takes(i, block, own, n, figures, rate, v, terrains.levels, reach, flights)
            _asked(
                block, own, n, actions[i], guided, v.control, v.heading, v.drawn[i, LOAD], attitude
            )
        left = count
        for _ in range(steps):
            if guided:
                loop.ask(block, own, width, gains, most, spare)
            loop.give(block, own, width, gives, torque)
            advance_bodies(block, dt, gives, torque, figures, v.inertia, v.rig, work)
            for n in range(width):
                own[loop.TIME, n] += dt
            if guided:
                loop.sense(block, own, width, dt, spare)
            if loop.low(block, own, width) > 0:
                left -= _ended(block, own, count, lanes, y, rate, v, terrains, flights)
                if left == 0:
                    break
        for n in range(count):
            i = lanes[n]
            if ended[i] == FLYING:
                _stored(block, own, n, i, y, rate, flights)
                if flights.time[i] >= limit - 0.5 * dt:
                    ended[i] = LATE
