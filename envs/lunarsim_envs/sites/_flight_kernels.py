# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled flights to a site: guidance, cost of diverts, and the next event."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.control._kernels import thrust_attitude
from lunarsim.onboard.guidance._given_time_kernels import evaluate_given_times
from lunarsim.onboard.guidance._kernels import MASS, power_terms
from lunarsim.onboard.guidance._reach_kernels import search_sites
from lunarsim_envs.descent import _kernels as d

# Events that stop a lane: none, a scan, a decision.
NOTHING, SCAN, DECIDE = 0, 1, 2
APPROACH, VERTICAL = 0, 1
# State of a lane that waits while others of its block fly.
_WAITING = 9
# Random stream of the drift.
_DRIFT = np.uint64(0xA0761D6478BD642F)
# Constant of `divert.divert_cost`.
_TIMES, _SLOWNESS = 14, 8.0
# Constants of `strain.Strain`.
_LONGEST, _SLACK = 0.5, 0.02

_survey = cast(Any, search_sites).compiled
_measured = cast(Any, evaluate_given_times).compiled
_advance = cast(Any, d.advance).compiled


class Law(NamedTuple):
    """Guidance parameters of a scenario, SI.

    `powers` (2,): powers of time in the polynomial path. `asked` (2, 3): velocity and acceleration
    at the end of the approach; `above` (3,): position of this end relative to the site. `figures`
    (7,): gravity, mass (unused), exhaust velocity, minimum and maximum thrust, tangents of maximum
    tilt and glideslope. `rough`, `table`: coarse and fine samples of a path (`batch.samples`).
    `bounds` (4,): maximum thrust over dry mass, dry mass, exhaust velocity, propellant reserve.
    `ends` (2,): altitude and time-to-go at which the vertical descent starts. `descent` (10,):
    frequency, damping, speed gain, maximum tilt and its value at touchdown, heights of full tilt
    and of the low descent, tolerated lateral speed, minimum speed fraction, vertical velocity.
    `window` (3,): minimum and maximum altitude of decisions, and their interval. `scans`: altitudes
    of LiDAR scans, descending. `lag`: time constant of attitude and thrust. `least`: minimum
    time-to-go for replanning. `most_thrust`: maximum thrust. `stand`: height of the centre of mass
    above the pads. `cycle`: integration steps per control cycle.
    """

    powers: np.ndarray
    asked: np.ndarray
    above: np.ndarray
    figures: np.ndarray
    rough: np.ndarray
    table: np.ndarray
    bounds: np.ndarray
    ends: np.ndarray
    descent: np.ndarray
    window: np.ndarray
    scans: np.ndarray
    lag: float
    least: float
    max_tilt: float
    most_thrust: float
    stand: float
    cycle: int


class Course(NamedTuple):
    """Guidance state of n landers.

    `site` (n, 3): current site, local frame, m. Times, s (n,): `arrival` at the end of the
    approach, `due` of the next decision, `strained` since which commands exceed limits (NaN: they
    do not). `phase`: APPROACH or VERTICAL; `scanned`: number of scans; `event` that stops the
    lander; `decided`: whether a decision was made. `answer` (n, 7): lagged and commanded
    acceleration, and the time of the command. `path` (n, 8): start time, duration and coefficients
    of the current path. `slip` (n, 2): drift velocity of navigation, m/s.
    """

    site: np.ndarray
    arrival: np.ndarray
    due: np.ndarray
    strained: np.ndarray
    phase: np.ndarray
    scanned: np.ndarray
    event: np.ndarray
    decided: np.ndarray
    answer: np.ndarray
    path: np.ndarray
    slip: np.ndarray


@kernel(exact=True)
def believed(y, slip, time, out):
    """Compute the estimated position and velocity of a lander, into `out` (2, 3).

    They are the true state `y` (15,) plus a drift with constant velocity `slip` (2,), m/s, since
    the start (`time`, s).
    """
    for k in range(3):
        out[0, k] = y[k]
        out[1, k] = y[3 + k]
    for k in range(2):
        out[0, k] += slip[k] * time
        out[1, k] += slip[k]


@kernel()
def _slower(state, targets, first, likely, last, law, figures, out):
    """Search longer times-to-go for targets without an admissible path.

    `out` (m, 4) has the results of the search between `first` and `likely` (m,), s; the search goes
    on to `last` (m,). `targets` (m, 3) are end points of the approach, m.
    """
    slow = 0
    at = np.empty(len(targets), np.int64)
    for n in range(len(targets)):
        if not np.isfinite(out[n, 0]) and likely[n] < last[n]:
            at[slow] = n
            slow += 1
    if slow == 0:
        return
    ends, begins, until = np.empty((slow, 3)), np.empty(slow), np.empty(slow)
    found = np.empty((slow, 4))
    for k in range(slow):
        n = at[k]
        begins[k], until[k] = max(first[n], likely[n]), last[n]
        for axis in range(3):
            ends[k, axis] = targets[n, axis]
    _survey(
        (0, 1), state, ends, law.asked, begins, until, _TIMES, law.rough, law.table, law.powers,
        figures, found,
    )  # fmt: skip
    for k in range(slow):
        for column in range(4):
            out[at[k], column] = found[k, column]


@kernel(exact=True)
def _fastest(state, gap, law):
    """Return a lower bound of the time to fly a distance `gap`, m, at full thrust, s."""
    speed = np.sqrt(state[1, 0] ** 2 + state[1, 1] ** 2 + state[1, 2] ** 2)
    most = law.bounds[0] + law.figures[0]
    fastest = 2.0 * gap / (speed + np.sqrt(speed * speed + 2.0 * most * gap) + 1e-12)
    return max(fastest, 1.0)


@kernel(exact=True)
def _burnt(increment, mass, law):
    """Return the propellant for a delta-v `increment`, m/s, in kg.

    `mass` is the current mass, kg. The result is inf if too little propellant is left.
    """
    burnt = mass * -np.expm1(-increment / law.bounds[2])
    return burnt if burnt <= mass - law.bounds[1] - law.bounds[3] else np.inf


@kernel()
def reach(state, mass, sites, law, out):
    """Compute propellant (kg) and time-to-go (s) of minimum-propellant paths to sites.

    `state` (2, 3) is the estimated position and velocity, and `sites` (m, 3) are positions, m. The
    first two columns of `out` (m, 4) get the results: inf and NaN for sites out of reach.
    """
    m = len(sites)
    targets = np.empty((m, 3))
    first, last, likely = np.empty(m), np.empty(m), np.empty(m)
    speed = np.sqrt(state[1, 0] ** 2 + state[1, 1] ** 2 + state[1, 2] ** 2)
    end_speed = np.sqrt(np.sum(law.asked[0] ** 2))
    held = law.bounds[2] * np.log(max(mass / law.bounds[1], 1.0))
    for n in range(m):
        gap = 0.0
        for k in range(3):
            targets[n, k] = sites[n, k] + law.above[k]
            gap += (targets[n, k] - state[0, k]) ** 2
        gap = np.sqrt(gap)
        first[n] = _fastest(state, gap, law)
        last[n] = max((held + speed + end_speed) / law.figures[0], first[n])
        likely[n] = min(last[n], _SLOWNESS * max(gap / max(speed, 5.0), first[n]))
    figures = law.figures.copy()
    figures[MASS] = mass
    _survey(
        (0, 1), state, targets, law.asked, first, likely, _TIMES, law.rough, law.table, law.powers,
        figures, out,
    )  # fmt: skip
    _slower(state, targets, first, likely, last, law, figures, out)
    for n in range(m):
        out[n, 0] = _burnt(out[n, 0], mass, law)
        if not np.isfinite(out[n, 0]):
            out[n, 1] = np.nan


@kernel()
def holds(state, mass, site, time, law):
    """Return whether the path to a site (3,) with time-to-go `time`, s, is feasible.

    A feasible path is within the limits of thrust, tilt, glideslope and propellant.
    """
    target, figures = np.empty((1, 3)), law.figures.copy()
    gap = 0.0
    for k in range(3):
        target[0, k] = site[k] + law.above[k]
        gap += (target[0, k] - state[0, k]) ** 2
    figures[MASS] = mass
    times, out = np.empty(1), np.empty((1, 4))
    times[0] = time if time >= _fastest(state, np.sqrt(gap), law) else np.nan
    _measured((0, 1), state, target, law.asked, times, law.table, law.powers, figures, out)
    return np.isfinite(_burnt(out[0, 0], mass, law))


@kernel()
def time_to(y, slip, time, site, law):
    """Return the minimum-propellant time-to-go to a site (3,), s; NaN if out of reach.

    `y` (15,) is the true state and `slip` (2,) the drift velocity of its estimate, m/s.
    """
    state, out = np.empty((2, 3)), np.empty((1, 4))
    believed(y, slip, time, state)
    reach(state, y[13], site.reshape((1, 3)), law, out)
    return out[0, 1]


@kernel(exact=True)
def _approach(i, time, course, law, wanted, spare):
    """Compute the commanded thrust acceleration of the approach, into `wanted` (3,).

    It is the same computation as `PathGuidance.command`. `i` is the lander; the first two rows of
    the scratch `spare` (7, 3) are its estimated position and velocity.
    """
    state, ahead, x, target = spare[:2], spare[2:4], spare[4:6], spare[6]
    answer, path = course.answer[i], course.path[i]
    if law.lag > 0.0 and not np.isnan(answer[6]):
        keep = np.exp(-(time - answer[6]) / law.lag)
        for k in range(3):
            answer[k] = answer[3 + k] + keep * (answer[k] - answer[3 + k])
    answer[6] = time
    left = course.arrival[i] - time - law.lag
    if left >= law.least or np.isnan(path[0]):
        for k in range(3):
            a = answer[k]
            ahead[0, k] = state[0, k] + law.lag * (state[1, k] + 0.5 * law.lag * a)
            ahead[1, k] = state[1, k] + law.lag * a
            target[k] = course.site[i, k] + law.above[k]
        left = max(left, law.least)
        power_terms(ahead, target, law.asked, left, law.powers, x)
        path[0], path[1] = time, left
        for k in range(3):
            path[2 + k] = (law.powers[0] + 1.0) * x[0, k]
            path[5 + k] = (law.powers[1] + 1.0) * x[1, k]
    share = max(path[1] - (time - path[0]), 0.0) / path[1]
    low, high = share ** law.powers[0], share ** law.powers[1]
    for k in range(3):
        wanted[k] = law.asked[1, k] + path[2 + k] * low + path[5 + k] * high
        answer[3 + k] = wanted[k]
    wanted[2] += law.figures[0]


@kernel(exact=True)
def leaning(height, full, descent):
    """Return the tangent of the maximum tilt in the vertical descent at a height, m.

    Below the height `full` (m), the limit falls linearly to its value at touchdown.
    """
    share = min(max(height / full, 0.0), 1.0)
    return np.tan(descent[4] + share * (descent[3] - descent[4]))


@kernel(exact=True)
def vertical(state, end, descent, gravity, wanted):
    """Compute the thrust acceleration of the vertical descent (3,), m/s^2.

    It is the same computation as `VerticalDescent.command`. `state` (2, 3) is the estimated
    position and velocity, `end` (3,) the touchdown position and `descent` is `Law.descent`.
    """
    frequency, damping, planned = descent[0], descent[1], descent[9]
    height = state[0, 2] - end[2]
    speed = np.hypot(state[1, 0], state[1, 1])
    excess = max(speed - descent[7], 0.0)
    stopping = excess / (0.5 * gravity * leaning(height, descent[5], descent))
    asked = planned
    if excess > 0.0 and -planned * stopping > height:
        asked = min(-height / stopping, descent[8] * planned)
    lean = leaning(height, descent[5] if asked == planned else descent[6], descent)
    up = max(gravity + descent[2] * (asked - state[1, 2]), 0.3 * gravity)
    for k in range(2):
        off = state[0, k] - end[k]
        wanted[k] = -(frequency**2) * off - 2.0 * damping * frequency * state[1, k]
    size = np.hypot(wanted[0], wanted[1])
    if size > up * lean:
        wanted[0] *= up * lean / size
        wanted[1] *= up * lean / size
    wanted[2] = up


@kernel(exact=True)
def _strains(i, wanted, mass, time, course, law):
    """Return whether commands of a lander have exceeded tilt or thrust for 0.5 s.

    `wanted` (3,) is the commanded thrust acceleration, m/s^2. Updates `course.strained`.
    """
    side = np.hypot(wanted[0], wanted[1])
    lean = np.arctan2(side, wanted[2])
    push = mass * np.hypot(side, wanted[2])
    if lean <= (1.0 + _SLACK) * law.max_tilt and push <= (1.0 + _SLACK) * law.most_thrust:
        course.strained[i] = np.nan
        return False
    if np.isnan(course.strained[i]):
        course.strained[i] = time
    if time - course.strained[i] < _LONGEST - 1e-9:
        return False
    course.strained[i] = np.nan
    return True


@kernel(exact=True)
def guide(i, y, time, course, law, wanted, spare):
    """Compute the commanded thrust acceleration of lander `i` (3,), m/s^2.

    Returns whether the path exceeds limits, so that a longer time-to-go is needed. `y` (15,) is the
    true state and `spare` (7, 3) is scratch.
    """
    state = spare[:2]
    slip, site = course.slip[i], course.site[i]
    believed(y, slip, time, state)
    altitude = state[0, 2] - site[2] - law.stand
    left = course.arrival[i] - time
    if course.phase[i] == APPROACH and (altitude <= law.ends[0] or left <= law.ends[1]):
        course.phase[i] = VERTICAL
    if course.phase[i] == APPROACH:
        _approach(i, time, course, law, wanted, spare)
        return _strains(i, wanted, y[13], time, course, law)
    end = spare[6]
    for k in range(3):
        end[k] = site[k]
    end[2] += law.stand
    vertical(state, end, law.descent, law.figures[0], wanted)
    return False


@kernel()
def _longer(i, y, time, course, law):
    """Delay the arrival of lander `i` if the minimum-propellant path takes longer.

    The kernel is called when the current path exceeds limits.
    """
    longer = time_to(y, course.slip[i], time, course.site[i], law)
    if longer > course.arrival[i] - time:
        course.arrival[i] = time + longer


@kernel(exact=True)
def due(i, y, time, course, law):
    """Return the event that is due for lander `i` now: SCAN, DECIDE or NOTHING.

    Scans are due at the altitudes `law.scans`; decisions within the altitude window `law.window`.
    """
    altitude = y[2] - course.site[i, 2] - law.stand
    done = course.scanned[i]
    if done < len(law.scans) and altitude <= law.scans[done]:
        return SCAN
    if (
        course.phase[i] == APPROACH
        and law.window[0] <= altitude <= law.window[1]
        and time >= course.due[i] - 1e-9
    ):
        return DECIDE
    return NOTHING


@kernel(shared=True)
def begin(share, mask, keys, flight_counts, y, target, drift, control, heading, course, law):
    """Initialise guidance, drift and attitude of the started flights of `mask` (n,).

    `drift` (2,) is the standard deviation of the drift velocity of navigation, m/s; `control` is
    `Vehicle.control`. `share` is (thread, number of threads).
    """
    wanted, attitude, spare = np.empty(3), np.empty(4), np.empty((7, 3))
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        key = np.uint64(keys[i]) ^ _DRIFT
        for k in range(2):
            course.slip[i, k] = drift[k] * d.normal(key, 4 * (flight_counts[i] - 1) + 2 * k)
        for k in range(3):
            course.site[i, k] = target[i, k]
        course.phase[i], course.scanned[i], course.event[i] = APPROACH, 0, NOTHING
        course.decided[i] = False
        course.due[i] = 0.0
        course.strained[i] = np.nan
        for k in range(7):
            course.answer[i, k] = 0.0
        course.answer[i, 6] = np.nan
        course.path[i, 0] = np.nan
        time = time_to(y[i], course.slip[i], 0.0, course.site[i], law)
        # No admissible path: use twice the distance over the speed as time-to-go.
        way = np.sqrt(np.sum((course.site[i] + law.above - y[i, :3]) ** 2))
        speed = np.sqrt(np.sum(y[i, 3:6] ** 2))
        course.arrival[i] = time if np.isfinite(time) else max(2.0 * way / max(speed, 1.0), 5.0)
        # Start with the attitude and the thrust that guidance commands.
        if guide(i, y[i], 0.0, course, law, wanted, spare):
            _longer(i, y[i], 0.0, course, law)
        y[i, 14] = thrust_attitude(
            wanted, y[i, 13], control[0], control[1], heading, control[2], attitude
        )
        for k in range(4):
            y[i, 6 + k] = attitude[k]
        for k in range(7):
            course.answer[i, k] = 0.0
        course.answer[i, 6] = np.nan
        course.path[i, 0] = np.nan
        course.strained[i] = np.nan


@kernel()
def stretched(y, slip, time, site, stretch, law):
    """Return the time-to-go to a site (3,), s, and whether a factor was applied.

    `stretch` is the factor on the minimum-propellant time-to-go (NaN: none). The factor is ignored
    if its path would violate a limit.
    """
    left = time_to(y, slip, time, site, law)
    if np.isnan(stretch) or not np.isfinite(left):
        return left, np.isnan(stretch)
    state = np.empty((2, 3))
    believed(y, slip, time, state)
    if holds(state, y[13], site, stretch * left, law):
        return stretch * left, True
    return left, False


@kernel(shared=True)
def decide(share, mask, time, y, sites, stretches, course, law, refused, unstretched):
    """Apply site decisions of the landers of `mask` (n,).

    `sites` (n, 3) are new sites (NaN keeps the site) and `stretches` (n,) factors on the
    time-to-go. Writes to `refused` and `unstretched` (n,) whether the site was out of reach and
    whether the factor was ignored. `share` is (thread, number of threads).
    """
    for i in range(share[0], len(y), share[1]):
        if not mask[i]:
            continue
        course.due[i] = time[i] + law.window[2]
        course.event[i] = NOTHING
        first = not course.decided[i]
        course.decided[i] = True
        refused[i] = unstretched[i] = False
        keeps = np.isnan(sites[i, 0])
        if keeps and not first and np.isnan(stretches[i]):
            continue
        goal = course.site[i] if keeps else sites[i]
        left, flown = stretched(y[i], course.slip[i], time[i], goal, stretches[i], law)
        unstretched[i] = not flown
        if not np.isfinite(left):
            refused[i] = not keeps
            continue
        for k in range(3):
            course.site[i, k] = goal[k]
        course.arrival[i] = time[i] + left


@kernel(shared=True)
def fly(share, y, rate, width, dt, limit, vehicle, terrains, flights, course, law):
    """Fly all flying landers until a scan or a decision is due, or to their end.

    Landers are flown in blocks of `width`; a lander whose event is due waits for its block. `dt` is
    the integration step and `limit` the time limit, s. `share` is (thread, number of threads).
    """
    wanted, spare = np.zeros((width, 3)), np.empty((7, 3))
    n = len(y)
    for b in range(share[0], (n + width - 1) // width, share[1]):
        low, high = b * width, min((b + 1) * width, n)
        own = d.Vehicle(
            vehicle.figures[low:high], vehicle.randomized[low:high], vehicle.inertia, vehicle.rig,
            vehicle.control, vehicle.heading, vehicle.pads, vehicle.disc, vehicle.spacing,
            vehicle.limits, vehicle.com_height,
        )  # fmt: skip
        here = d.Flights(
            flights.world[low:high], flights.time[low:high], flights.ended[low:high],
            flights.failed[low:high], flights.touchdown_values[low:high],
        )  # fmt: skip
        while True:
            flying = 0
            for i in range(low, high):
                if flights.ended[i] != d.FLYING:
                    continue
                if course.event[i] == NOTHING:
                    course.event[i] = due(i, y[i], flights.time[i], course, law)
                if course.event[i] != NOTHING:
                    flights.ended[i] = _WAITING
                    continue
                flying += 1
                time = flights.time[i]
                if guide(i, y[i], time, course, law, wanted[i - low], spare):
                    _longer(i, y[i], time, course, law)
            if flying > 0:
                # Same argument types as for descents, so that no second version is compiled.
                _advance(
                    (np.int64(0), np.int64(1)), y[low:high], rate[low:high], wanted, np.bool_(True),
                    law.cycle, dt, limit, width, own, terrains, here,
                )  # fmt: skip
            for i in range(low, high):
                if flights.ended[i] == _WAITING:
                    flights.ended[i] = d.FLYING
            if flying == 0:
                break
