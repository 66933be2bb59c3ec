# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled kernels of descents: random starts, flight steps and touchdown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.touchdown import (
    OFF_MAP,
    TouchdownParams,
    evaluate_on_raster,
    has_contact,
    height_at,
)
from lunarsim.onboard.control._kernels import limited_thrust_attitude
from lunarsim.vehicle._kernels import advance_bodies
from lunarsim_envs.descent import _loop_kernels as loop

# Status of a flight.
FLYING, LANDED, LOST, LATE, AWAY = 0, 1, 2, 3, 4
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
    thread_slice, mask, keys, flight_counts, y, rate, target, world, time, ended, starts,
    target_areas, world_ranges, initial_attitude, initial_mass_thrust, smooth_terrains, frame,
):  # fmt: skip
    """Sample start, target and world of new flights for the landers of `mask` (n,).

    Writes `y`, `rate`, `target`, `world`, `time` and `ended`, and adds 1 to `flight_counts`. `keys`
    and `flight_counts` (n,) are the random streams and their numbers of flights; `world_ranges` (n,
    2) has the first allowed world and the number of worlds. `initial_attitude` is a quaternion,
    `initial_mass_thrust` in kg and N. `smooth_terrains` and `frame` are terrain without rocks.
    Other arguments are attributes of `DescentBatch`. `thread_slice` is (thread, number of threads).
    """
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        first = flight_counts[i] * _DRAWS
        flight_counts[i] += 1
        key = keys[i]
        worlds = world_ranges[i, 1]
        world[i] = world_ranges[i, 0] + min(int(uniform(key, first) * worlds), worlds - 1)
        area = target_areas[i]
        for k in range(2):
            target[i, k] = area[k] + area[2 + k] * (2.0 * uniform(key, first + 1 + k) - 1.0)
        target[i, 2] = height_at(smooth_terrains[world[i]], frame, target[i, 0], target[i, 1])
        for k in range(3):
            off = normal(key, first + 3 + 2 * k)
            y[i, k] = target[i, k] + starts[i, k] + starts[i, 6] * off
            off = normal(key, first + 9 + 2 * k)
            y[i, 3 + k] = starts[i, 3 + k] + starts[i, 7] * off
        for k in range(4):
            y[i, 6 + k] = initial_attitude[k]
        for k in range(3):
            y[i, 10 + k] = 0.0
            rate[i, k] = 0.0
        y[i, 13] = initial_mass_thrust[0]
        y[i, 14] = initial_mass_thrust[1]
        time[i] = 0.0
        ended[i] = FLYING


# Indices of the randomized parameters, in the order of `domain_randomization.RANDOM_QUANTITIES`.
LOAD, IMPULSE, THRUST, LAG, OFFSET, FAILS, ENGINE, TORQUE, SEES_LATE, ACTS_LATE = (
    0, 1, 2, 3, 4, 6, 7, 8, 11, 12,
)  # fmt: skip
DRAWS = 13
# Random stream of the randomized parameters.
VARIED = np.uint64(0xD1342543DE82EF95)


@kernel()
def sample_parameters(key, flight, ranges, out):
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
def randomize(
    thread_slice, mask, keys, flight_counts, ranges, standard_gravity, nominal, randomized, params,
    y,
):  # fmt: skip
    """Sample new randomized vehicle parameters for the started flights of `mask` (n,).

    `standard_gravity` is in m/s^2; `nominal` (5,) has the nominal gravity, exhaust velocity, thrust
    lag, dry mass and wet mass. Writes `randomized` (n, 13), `params` (n, 5) and the mass in the
    states `y`. `thread_slice` is (thread, number of threads).
    """
    for i in range(thread_slice[0], len(y), thread_slice[1]):
        if not mask[i]:
            continue
        sample_parameters(keys[i], flight_counts[i] - 1, ranges, randomized[i])
        values = randomized[i]
        params[i, 0] = nominal[0]
        params[i, 1] = nominal[1] + values[IMPULSE] * standard_gravity
        params[i, 2] = nominal[2] + values[LAG]
        params[i, 3] = nominal[3] + values[LOAD]
        params[i, 4] = nominal[4] + values[LOAD]
        y[i, 13] = params[i, 4]


@kernel(shared=True)
def sample_normals(thread_slice, mask, keys, positions, out):
    """Write standard normal numbers to rows `mask` of `out` (n, k).

    `positions` (n,) in the random streams `keys` (n,) are advanced. `thread_slice` is (thread,
    number of threads).
    """
    for i in range(thread_slice[0], len(out), thread_slice[1]):
        if mask[i]:
            for k in range(out.shape[1]):
                out[i, k] = normal(np.uint64(keys[i]) ^ _FIRST, positions[i])
                positions[i] += 2


class Vehicle(NamedTuple):
    """Vehicle parameters of a batch of n landers, SI.

    `params` (n, 5) has gravity, exhaust velocity, thrust lag, dry and wet mass, and `randomized`
    (n, 13) the other randomized parameters of each lander. `control` (9,) has minimum and maximum
    thrust, maximum tilt, gains of the attitude loop (3) and maximum torques (3). `inertia` and
    `rig` are arguments of `advance_bodies`; the fields from `pads` on describe the touchdown
    (`evaluate_on_raster`); `heading` is the azimuth of body x, rad. The attitude loop knows the
    moments of inertia `known_inertia` (2, 3). Deviations of the true lander: `mass_deviation`, kg,
    and true thrust and torque divided by the commanded ones.
    """

    params: np.ndarray
    randomized: np.ndarray
    inertia: np.ndarray
    rig: np.ndarray
    control: np.ndarray
    heading: float
    pads: np.ndarray
    disc: np.ndarray
    spacing: float
    limits: np.ndarray
    com_height: float
    known_inertia: np.ndarray
    mass_deviation: float
    thrust_scale: float
    torque_scale: float


class TerrainRasters(NamedTuple):
    """Terrain of k worlds: heights with rocks, grid and height ranges, m.

    `z` (k, rows, cols) are heights; `frame` (3,) has east and north of cell (0, 0) and the grid
    spacing; `levels` (k, 2) has minimum and maximum height, and `max_rise` (k,) an upper bound of
    the terrain under a pad above that under its centre, m.
    """

    z: np.ndarray
    frame: np.ndarray
    levels: np.ndarray
    max_rise: np.ndarray


class Flights(NamedTuple):
    """Status of the flights of n landers, each field an attribute of `DescentBatch`.

    World index, time (s), status (FLYING, ...) and violated limits (n,); touchdown values (n,
    values) in the order of `core.touchdown.VALUES`; targets (n, 3) and distances from them at which
    flights end (n,), m.
    """

    world: np.ndarray
    time: np.ndarray
    ended: np.ndarray
    failed: np.ndarray
    touchdown_values: np.ndarray
    target: np.ndarray
    max_distance: np.ndarray


@kernel(exact=True)
def _end_without_touchdown(i, y, time_limit, flights):
    """End the flight of lander `i` at the time limit, s, or too far from its target.

    `y` (15,) is its state.
    """
    if flights.time[i] >= time_limit:
        flights.ended[i] = LATE
        return
    squares = 0.0
    for k in range(3):
        squares += (y[k] - flights.target[i, k]) ** 2
    if squares > flights.max_distance[i] ** 2:
        flights.ended[i] = AWAY


@kernel()
def _end_flight(i, y, vehicle, terrains, flights):
    """End the flight of lander `i` if it touches the terrain or is below the map.

    `y` (15,) is its state. Returns 1 and writes the touchdown to `flights`, or returns 0 if the
    flight continues.
    """
    w = flights.world[i]
    z, frame = terrains.z[w], terrains.frame
    if has_contact(y, vehicle.pads, vehicle.disc, z, frame, terrains.max_rise[w]):
        params = vehicle.params[i]
        flights.ended[i] = LANDED
        touchdown = TouchdownParams(
            vehicle.limits, vehicle.com_height, params[0], params[3], params[4], vehicle.inertia
        )
        flights.failed[i] = evaluate_on_raster(
            y, vehicle.pads, vehicle.disc, vehicle.spacing, z, frame, touchdown,
            flights.touchdown_values[i],
        )  # fmt: skip
        return 1
    if y[2] < terrains.levels[w, 0] - 1.0:
        flights.ended[i] = LOST
        flights.failed[i] = OFF_MAP
        return 1
    return 0


@kernel(exact=True)
def _load_states(start, stop, ended, y, lanes, states):
    """Copy the states of the flying landers from `start` to `stop` - 1 to a block.

    The block `states` (15, width) has one column per lander; empty columns repeat the first lander.
    Writes the indices of the landers to `lanes` and returns their number.
    """
    count = 0
    for i in range(start, stop):
        if ended[i] == FLYING:
            lanes[count] = i
            count += 1
    for n in range(states.shape[1] if count > 0 else 0):
        i = lanes[n] if n < count else lanes[0]
        for s in range(15):
            states[s, n] = y[i, s]
    return count


@kernel(exact=True)
def _set_command(states, loop_state, n, action, guided, control, heading, payload, attitude):
    """Convert the action of one lander to commanded thrust, and attitude or torques.

    `action` is a thrust acceleration, m/s^2, if `guided`, otherwise thrust and torques, N and N m.
    The command is limited, and written to column `n` of `loop_state`. It is computed with the
    nominal mass, without the unknown `payload`, kg. `attitude` (4,) is scratch.
    """
    if guided:
        loop_state[loop.THRUST, n] = limited_thrust_attitude(
            action, states[13, n] - payload, control[0], control[1], heading, control[2], attitude
        )
        for k in range(4):
            loop_state[loop.AIM + k, n] = attitude[k]
        return
    loop_state[loop.THRUST, n] = min(max(action[0], control[0]), control[1])
    for k in range(3):
        loop_state[loop.TORQUE + k, n] = min(max(action[1 + k], -control[6 + k]), control[6 + k])


@kernel(exact=True)
def _load_lander(i, states, loop_state, n, params, rate, vehicle, height_ranges, reach, flights):
    """Copy parameters and attitude-loop state of lander `i` to column `n` of a block.

    A block has several landers, one per column. Writes `loop_state`, whose rows are those of
    `_loop_kernels`, and `params` (5, width). `reach` is the distance from the centre of mass to the
    pads plus a margin, m.
    """
    for k in range(5):
        params[k, n] = vehicle.params[i, k]
    randomized, inertia = vehicle.randomized[i], vehicle.known_inertia
    # Moments of inertia at the current mass, which the attitude loop uses.
    full = (states[13, n] - params[3, n]) / (params[4, n] - params[3, n])
    for k in range(3):
        loop_state[loop.MOMENT + k, n] = inertia[0, k] + full * (inertia[1, k] - inertia[0, k])
        loop_state[loop.RATE + k, n] = rate[i, k]
        loop_state[loop.WEAK + k, n] = randomized[TORQUE + k]
    loop_state[loop.TIME, n] = flights.time[i]
    loop_state[loop.FAILS, n], loop_state[loop.ENGINE, n] = randomized[FAILS], randomized[ENGINE]
    share, scale = randomized[THRUST], vehicle.thrust_scale
    loop_state[loop.SHARE, n] = share + (scale - 1.0) * (1.0 + share)
    loop_state[loop.OFFSET, n], loop_state[loop.OFFSET + 1, n] = (
        randomized[OFFSET],
        randomized[OFFSET + 1],
    )
    loop_state[loop.FLOOR, n] = height_ranges[flights.world[i], 1] + reach


@kernel(exact=True)
def _store_lander(states, loop_state, n, i, y, rate, flights):
    """Copy state, body rate and time from column `n` of a block back to lander `i`.

    A block has several landers, one per column of `states` and `loop_state`. Writes `y`, `rate` and
    `flights.time`.
    """
    for s in range(15):
        y[i, s] = states[s, n]
    for k in range(3):
        rate[i, k] = loop_state[loop.RATE + k, n]
    flights.time[i] = loop_state[loop.TIME, n]


@kernel()
def _end_flights(states, loop_state, count, lanes, y, rate, vehicle, terrains, flights):
    """End the flights of landers in a block that have touched down or left the map.

    A block has several landers, one per column of `states` and `loop_state`. `count` is their
    number and `lanes` their indices. Writes `y`, `rate` and `flights`; returns the number of
    flights that ended in this step.
    """
    count_ended = 0
    for n in range(count):
        i = lanes[n]
        if flights.ended[i] == FLYING and states[2, n] <= loop_state[loop.FLOOR, n]:
            _store_lander(states, loop_state, n, i, y, rate, flights)
            count_ended += _end_flight(i, y[i], vehicle, terrains, flights)
    return count_ended


@kernel(shared=True)
def advance(
    thread_slice, y, rate, actions, guided, steps, dt, time_limit, width, vehicle, terrains, flights
):
    """Fly all flying landers for `steps` integration steps, or to their end.

    Updates the states `y` (n, 15), the measured body rates `rate` (n, 3) and `flights`. `actions`
    are thrust accelerations if `guided`, otherwise thrust and torques. `dt` and `time_limit` are in
    s; landers are flown in blocks of `width`. `thread_slice` is (thread, number of threads).
    """
    v, ended = vehicle, flights.ended
    gains, max_torque = v.control[3:6], v.control[6:]
    reach = np.sqrt(np.max(np.sum(v.pads * v.pads, axis=1))) + 0.1
    lanes, attitude = np.empty(width, np.int64), np.empty(4)
    states, work = np.empty((15, width)), np.empty((5, 15, width))
    loop_state, scratch = np.empty((loop.ROWS, width)), np.empty((3, width))
    thrust, torque, params = np.zeros(width), np.zeros((3, width)), np.ones((5, width))
    for b in range(thread_slice[0], (len(y) + width - 1) // width, thread_slice[1]):
        count = _load_states(b * width, min((b + 1) * width, len(y)), ended, y, lanes, states)
        if count == 0:
            continue
        for n in range(width):
            i = lanes[n] if n < count else lanes[0]
            _load_lander(i, states, loop_state, n, params, rate, v, terrains.levels, reach, flights)
            _set_command(
                states,
                loop_state,
                n,
                actions[i],
                guided,
                v.control,
                v.heading,
                v.randomized[i, LOAD] + v.mass_deviation,
                attitude,
            )
        left = count
        for _ in range(steps):
            if guided:
                loop.command_torques(states, loop_state, width, gains, max_torque, scratch)
            loop.actuate(states, loop_state, width, v.torque_scale, thrust, torque)
            advance_bodies(states, dt, thrust, torque, params, v.inertia, v.rig, work)
            for n in range(width):
                loop_state[loop.TIME, n] += dt
            if guided:
                loop.measure_rates(states, loop_state, width, dt, scratch)
            if loop.count_low(states, loop_state, width) > 0:
                left -= _end_flights(
                    states, loop_state, count, lanes, y, rate, v, terrains, flights
                )
                if left == 0:
                    break
        for n in range(count):
            i = lanes[n]
            if ended[i] == FLYING:
                _store_lander(states, loop_state, n, i, y, rate, flights)
                _end_without_touchdown(i, y[i], time_limit - 0.5 * dt, flights)
