"""Search for the optimal final time by the derivative of the cost.

Neither solver accepts a starting iterate. The information reused from the last solution is its
final time, its masses and the curvature of its cost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from lunarsim.errors import InputError
from lunarsim.optimal.errors import InfeasibleError, RelaxationError, SolverError
from lunarsim.optimal.path import OptimalPath
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.transcription import HalfSpaces
from lunarsim.optimal.validation import is_number
from lunarsim.typing import Array

_MAX_WARM_SOLVES, _MAX_COLD_SOLVES = (
    4,
    16,
)  # maximum number of solves, with and without a last solution
_MIN_RELATIVE_SAVING = 5e-5  # relative saving of delta-v below which no further solve is made
_LANDING_ERROR_TOLERANCE_M = 1e-3  # tolerance of the landing error, m
# Multiples of the first final time, tried until one is feasible.
_TIME_FACTORS = (0.8, 1.0, 0.9, 1.25, 0.65, 1.6, 0.5, 2.0, 0.4, 2.6, 0.32, 3.3, 0.25, 4.2, 0.2, 5.3)
_MAX_THRUST_VIOLATION = (
    0.05  # tolerated violation of the thrust limits, as a fraction of the maximum thrust
)
_FIRST_STEP = 0.04  # relative first step of the final time if the curvature is unknown


def minimum_effort_time(descent: Descent) -> float:
    """Return the final time of the minimum-effort path of a descent, s.

    It is an initial guess of the optimal final time.

    The minimum of ``int |a_T|^2 dt`` over paths and final times is at the smallest positive root of
    ``g^2/2 T^4 - 2 (v v + v v_f + v_f v_f) T^2 - 12 (v + v_f) d T - 18 d d``, with d from end to
    start, v and v_f the initial and final velocity, g the gravity (D'Souza 1997). Without a
    positive root the result is 1 s.
    """
    d, v, w = descent.displacement, descent.velocity, descent.end_velocity
    squares = float(v @ v + v @ w + w @ w)
    roots = np.roots(
        [
            0.5 * descent.gravity**2,
            0.0,
            -2.0 * squares,
            -12.0 * float((v + w) @ d),
            -18.0 * float(d @ d),
        ]
    )
    real = roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)]
    return float(real.min()) if real.size else 1.0


@dataclass
class _FinalTimeSearch:
    """Search for the final time at which the cost's time derivative is zero.

    The slope is the derivative of the minimum cost with respect to the final time T.

    Attributes
    ----------
    limit
        Slope of a lander that only hovers longer, m/s^2. The slope is about
        ``limit (1 - A / (T - T_0)^2)``, so that ``(limit - slope)^(-1/2)`` is about linear in T.
        Infinite: the slope itself is assumed linear.
    step
        Maximum first step of the final time, relative to the first final time.
    curvature_guess
        Second derivative of the cost with respect to T in a similar problem; 0: unknown.
    low, high
        Bracket of the optimal final time, s.
    known
        Final times (s) and slopes evaluated so far.
    """

    limit: float = np.inf
    step: float = _FIRST_STEP
    curvature_guess: float = 0.0
    low: float = 0.0
    high: float = np.inf
    known: list[tuple[float, float]] = field(default_factory=list)

    def add(self, time: float, slope: float) -> None:
        """Add a final time (s) with its cost derivative, and update the bracket."""
        self.known.append((time, slope))
        if slope < 0.0:
            self.low = max(self.low, time)
        else:
            self.high = min(self.high, time)

    def exclude(self, infeasible: float, feasible: float) -> None:
        """Exclude an infeasible final time from the bracket.

        `feasible` is a feasible final time: the optimum lies on its side. Both are in s.
        """
        if infeasible < feasible:
            self.low = max(self.low, infeasible)
        else:
            self.high = min(self.high, infeasible)

    def max_saving(self, best: OptimalPath) -> float:
        """Return the maximum cost saving within the bracket, for a convex cost.

        `best` is the best path so far; the result is in the unit of its cost.
        """
        to = self.low if best.slope > 0.0 else self.high
        return abs(best.slope) * abs(best.duration - to)

    @property
    def curvature(self) -> float:
        """Second derivative of the cost by the final time, from the last two slopes.

        If there are not two different final times, or the value is not positive, it is
        `curvature_guess`, or else 2 over the last final time.
        """
        (t1, s1) = self.known[-1]
        (t0, s0) = self.known[-2] if len(self.known) > 1 else (t1, s1)
        found = (s1 - s0) / (t1 - t0) if t1 != t0 else 0.0
        return found if found > 0.0 else self.curvature_guess or 2.0 / t1

    def _linearise_slope(self, slope: float) -> float:
        """Transform a cost derivative to a value about linear in the final time.

        A derivative of zero stays zero.
        """
        if not np.isfinite(self.limit):
            return slope
        return float((1.05 - min(slope / self.limit, 1.0)) ** -0.5 - 1.05**-0.5)

    def next(self) -> float:
        """Return the next final time to try, s, by a secant step within the bracket."""
        time, slope = self.known[-1]
        step = min(
            self.step * time, abs(slope) / self.curvature_guess if self.curvature_guess else np.inf
        )
        candidate = time - np.copysign(step, slope)
        if len(self.known) > 1:
            before, s0 = self.known[-2]
            rise = self._linearise_slope(slope) - self._linearise_slope(s0)
            if rise * (time - before) > 0.0:
                candidate = time - self._linearise_slope(slope) * (time - before) / rise
                candidate = min(max(candidate, 0.8 * time), 1.25 * time)
            elif slope * s0 > 0.0:
                # Two equal slopes do not locate the zero; they only give its side.
                candidate = 0.8 * time if slope > 0.0 else 1.25 * time
        if not self.low < candidate < self.high:
            candidate = 0.5 * (self.low + self.high) if np.isfinite(self.high) else 1.2 * self.low
        return float(candidate)


def minimize_propellant(
    planner: Planner,
    descent: Descent,
    *,
    last: OptimalPath | None = None,
    elapsed: float = 0.0,
    half_spaces: HalfSpaces | None = None,
    allow_lossy: bool = False,
) -> OptimalPath:
    """Find the minimum-propellant path of a descent over all final times.

    `OptimalPath.converged` states whether the search converged.

    Parameters
    ----------
    planner
        Planner that solves for one final time.
    descent
        Landing problem.
    last
        Solution of a similar problem, `elapsed` s ago. The search starts at its final time with
        four solves, and one more if its masses deviate; if that time is infeasible, `last` is
        ignored.
    elapsed
        Time since the start of `last`, s.
    half_spaces
        Half-spaces in which the path must lie; they replace the cone of `descent`.
    allow_lossy
        Whether to accept a path that violates the thrust limits by more than 5 % of the maximum,
        as a bound or as an initial guess.

    Raises
    ------
    InputError
        If the elapsed time is negative or not finite.
    InfeasibleError
        If no path exists, with the nearest reachable end that was found.
    SolverError
        If the solver fails; a `RelaxationError` if its solution violates the thrust limits.
    """
    if not (is_number(elapsed) and elapsed >= 0.0):
        raise InputError("optimal.elapsed", elapsed, "must be a finite number of 0 or more")
    before = planner.solves
    path = _search_warm(planner, descent, last, elapsed, half_spaces) if last is not None else None
    if path is None:
        path = _search_cold(planner, descent, half_spaces)
    if path is None:
        path = _search_from_landing_error(planner, descent, half_spaces)
    if not (allow_lossy or is_flyable(path)):
        raise RelaxationError(
            f"The relaxed solution violates the thrust limits by {100.0 * path.excess:.0f} % of "
            f"the maximum thrust (final time {path.duration:.1f} s), so it cannot be flown."
        )
    return replace(path, solves=planner.solves - before)


def is_flyable(path: OptimalPath) -> bool:
    """Return whether a path violates the thrust limits by at most 5 % of the maximum.

    A larger violation means that the convex relaxation of the thrust limits is not lossless: too
    few intervals around a switch, or a state constraint that is active for long.
    """
    return path.excess <= _MAX_THRUST_VIOLATION


def _search_from_landing_error(
    planner: Planner, descent: Descent, half_spaces: HalfSpaces | None
) -> OptimalPath:
    """Search the minimum-propellant path near the time of minimum landing error.

    If propellant is scarce, few final times are feasible; the landing error leads to them. Raise
    InfeasibleError if no path is found.
    """
    near = search_nearest_end(planner, descent, half_spaces=half_spaces)
    if near is not None and near.miss < max(10.0 * _LANDING_ERROR_TOLERANCE_M, descent.region):
        first = iter((near.duration, 1.01 * near.duration, 0.99 * near.duration))
        path = search_near(planner, descent, first, half_spaces=half_spaces, log_mass=near.log_mass)
        if path is not None:
            return path
    why = "infeasible at every tried final time"
    if near is None:
        raise InfeasibleError(descent.end_position, why + "; no end at that height is reachable")
    raise InfeasibleError(descent.end_position, why, near.position[-1])


def _search_warm(
    planner: Planner,
    descent: Descent,
    last: OptimalPath,
    elapsed: float,
    half_spaces: HalfSpaces | None,
) -> OptimalPath | None:
    """Search the minimum-propellant path from the last solution, `elapsed` s ago.

    Return None if the remaining time of the last solution is infeasible.
    """
    first = last.duration - elapsed
    if not first > 0.0:
        return None
    log_mass = remaining_log_mass(last, elapsed, planner.intervals)
    return search_near(
        planner, descent, iter((first,)), half_spaces=half_spaces, max_solves=_MAX_WARM_SOLVES,
        log_mass=log_mass, curvature_guess=last.curvature,
    )  # fmt: skip


def remaining_log_mass(last: OptimalPath, elapsed: float, intervals: int) -> Array:
    """Return ln(mass / current mass) at the interval centres (N,) of a remaining path.

    The remaining path begins `elapsed` s after the start of `last`; it is divided into `intervals`.
    """
    share = (np.arange(intervals) + 0.5) / intervals
    now = min(max(elapsed, 0.0), last.duration)
    at = now + share * (last.duration - now)
    return np.asarray(np.log(last.mass_at(at) / float(last.mass_at(now))))


def _search_cold(
    planner: Planner, descent: Descent, half_spaces: HalfSpaces | None
) -> OptimalPath | None:
    """Search the minimum-propellant path without a last solution; None if infeasible.

    The first final times are multiples of the time of the minimum-effort path.
    """
    first = minimum_effort_time(descent)
    return search_near(
        planner, descent, (s * first for s in _TIME_FACTORS), half_spaces=half_spaces
    )


def search_near(
    planner: Planner,
    descent: Descent,
    first: Iterator[float],
    *,
    half_spaces: HalfSpaces | None = None,
    max_solves: int = _MAX_COLD_SOLVES,
    log_mass: Array | None = None,
    step: float = _FIRST_STEP,
    curvature_guess: float = 0.0,
) -> OptimalPath | None:
    """Find the minimum-propellant path near given final times; None if infeasible.

    Parameters
    ----------
    planner, descent, half_spaces
        Planner for one final time; landing problem; half-spaces in which the path must lie, None:
        the cone of the descent.
    first
        Final times, s, tried in order until one is feasible.
    max_solves
        Maximum number of solves, counted from the first feasible final time.
    log_mass
        Guess of ln(mass / initial mass) at the interval centres (N,).
    step
        Maximum relative first step from the first feasible final time.
    curvature_guess
        Second derivative of the cost by the final time for a similar problem; 0: unknown.

    Raises
    ------
    SolverError
        If none of the final times `first` is feasible, and the solver failed at one of them.
    """
    search, best, failure = _FinalTimeSearch(descent.gravity, step, curvature_guess), None, None
    converged, budget = False, np.inf
    time: float | None = next(first)
    while time is not None and planner.solves < budget:
        before = planner.solves
        try:
            path = planner.at_time(descent, time, log_mass=log_mass, half_spaces=half_spaces)
        except SolverError as error:  # another final time may succeed
            path, failure = None, error
        if path is None:
            if best is None:
                time = next(first, None)
                continue
            # Bisect between feasible and infeasible final times.
            search.exclude(time, best.duration)
            if converged := search.max_saving(best) < _MIN_RELATIVE_SAVING * best.cost:
                break
            time = 0.5 * (time + best.duration)
            continue
        log_mass = path.log_mass
        budget = before + max_solves if best is None else budget
        best = path if best is None or path.cost < best.cost else best
        search.add(time, path.slope)
        converged = path.slope**2 < 2.0 * search.curvature * _MIN_RELATIVE_SAVING * path.cost
        if converged or (converged := search.max_saving(best) < _MIN_RELATIVE_SAVING * best.cost):
            break
        time = search.next()
    if best is None and failure is not None:
        raise failure
    return best and replace(best, curvature=search.curvature, converged=converged)


def search_nearest_end(
    planner: Planner, descent: Descent, half_spaces: HalfSpaces | None = None
) -> OptimalPath | None:
    """Return the path that ends nearest to the target; None if no landing is possible.

    Height and velocity of the end are fixed, its horizontal position is free. Thrust slack (thrust
    above the maximum) has no penalty here. `half_spaces` replace the cone of the descent.
    """
    if descent.thrust_slack > 0.0:
        descent = replace(
            descent, thrust_max=descent.thrust_max + descent.thrust_slack, thrust_slack=0.0
        )
    first = minimum_effort_time(descent)
    search, best, log_mass = _FinalTimeSearch(), None, None
    times = [s * first for s in _TIME_FACTORS]
    time: float | None = times.pop(0)
    budget = planner.solves + 2 * _MAX_COLD_SOLVES + len(_TIME_FACTORS)
    failure: SolverError | None = None
    while time is not None and planner.solves < budget:
        try:
            path = planner.at_time(
                descent, time, log_mass=log_mass, half_spaces=half_spaces, nearest=True
            )
        except SolverError as error:  # another final time may succeed
            path, failure = None, error
        if path is None:
            if best is not None:
                time = 0.5 * (time + best.duration)
            else:
                time = times.pop(0) if times else None
            continue
        log_mass = path.log_mass
        if best is None or path.miss < best.miss:
            best = path
        search.add(time, path.slope)
        time = search.next()
        left = abs(time - path.duration) * abs(path.slope)
        if (
            path.miss < _LANDING_ERROR_TOLERANCE_M
            or left < 0.05 * _LANDING_ERROR_TOLERANCE_M * path.miss
        ):
            break
    if best is None and failure is not None:
        raise failure
    return best


def minimize_landing_error(planner: Planner, descent: Descent) -> OptimalPath | None:
    """Return the path of minimum landing error; of these, the minimum propellant.

    Blackmore, Acikmese and Scharf, "Minimum-landing-error powered-descent guidance for Mars landing
    using convex optimization", Journal of Guidance, Control, and Dynamics 33(4), 2010. The cone
    constraint moves with the end of the path. The result is None if no landing is possible at the
    height of the target.
    """
    near = search_nearest_end(planner, descent)
    if near is None:
        return None
    disc = replace(descent, region=near.miss * (1.0 + 1e-3) + 0.1)
    return planner.at_time(disc, near.duration, log_mass=near.log_mass) or near
