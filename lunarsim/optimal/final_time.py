"""The best final time: bracketed by the derivative of the cost, which each solve gives for nothing.

Neither solver takes a starting iterate, so that what is saved from the last solution is its final
time, its masses and the curvature of its cost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.optimal.checks import is_number
from lunarsim.optimal.errors import InfeasibleError, RelaxationError, SolverError
from lunarsim.optimal.path import Path
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.transcription import Walls

Array = NDArray[np.float64]

_WARM, _COLD = 4, 16  # solves at most
_GAIN = 5e-5  # of the increment that another solve may save at most: then it is not made
_NEAR = 1e-3  # of an error of a metre
# Shares of the first final time that are tried until one can be flown.
_LADDER = (0.8, 1.0, 0.9, 1.25, 0.65, 1.6, 0.5, 2.0, 0.4, 2.6, 0.32, 3.3, 0.25, 4.2, 0.2, 5.3)
_LOSSY = 0.05  # of the greatest thrust by which a path may break its limits
_STEP = 0.04  # share of the final time that is tried where nothing is known of the slope's change


def first_time(descent: Descent) -> float:
    """Return the final time of the path of least effort, s: a first guess.

    The least of ``int |a_T|^2 dt`` over paths and final times is at the least positive root of
    ``g^2/2 T^4 - 2 (v v + v v_f + v_f v_f) T^2 - 12 (v + v_f) d T - 18 d d``, d from end to start
    (D'Souza 1997).
    """
    d, v, w = descent.gap, descent.velocity, descent.end_velocity
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
class _Search:
    """A search for the final time at which a slope is zero.

    Attributes
    ----------
    limit
        What the slope tends to where the lander only hovers longer, m/s^2: the slope is about
        ``limit (1 - A / (T - T_0)^2)``, so that ``(limit - slope)^(-1/2)`` is about linear in T.
        inf: the slope is taken for linear itself.
    step
        Share of the first final time by which it is left at most.
    bend
        The slope's derivative in a problem like this one; 0: not known.
    low, high
        Final times between which it is.
    known
        Final times and slopes so far.
    """

    limit: float = np.inf
    step: float = _STEP
    bend: float = 0.0
    low: float = 0.0
    high: float = np.inf
    known: list[tuple[float, float]] = field(default_factory=list)

    def add(self, time: float, slope: float) -> None:
        """Note a slope."""
        self.known.append((time, slope))
        if slope < 0.0:
            self.low = max(self.low, time)
        else:
            self.high = min(self.high, time)

    def exclude(self, time: float, flown: float) -> None:
        """Note a final time that cannot be flown, on one side of one that can."""
        if time < flown:
            self.low = max(self.low, time)
        else:
            self.high = min(self.high, time)

    def saves(self, best: Path) -> float:
        """Return what a final time within the bracket saves at most, the cost being convex."""
        to = self.low if best.slope > 0.0 else self.high
        return abs(best.slope) * abs(best.duration - to)

    @property
    def curvature(self) -> float:
        """The slope's derivative by the last two, or a guess."""
        (t1, s1) = self.known[-1]
        (t0, s0) = self.known[-2] if len(self.known) > 1 else (t1, s1)
        found = (s1 - s0) / (t1 - t0) if t1 != t0 else 0.0
        return found if found > 0.0 else self.bend or 2.0 / t1

    def _straight(self, slope: float) -> float:
        """Return what of a slope is about linear in the time, zero with the slope."""
        if not np.isfinite(self.limit):
            return slope
        return float((1.05 - min(slope / self.limit, 1.0)) ** -0.5 - 1.05**-0.5)

    def next(self) -> float:
        """Return the time to try next."""
        time, slope = self.known[-1]
        by = min(self.step * time, abs(slope) / self.bend if self.bend else np.inf)
        wanted = time - np.copysign(by, slope)
        if len(self.known) > 1:
            before, s0 = self.known[-2]
            rise = self._straight(slope) - self._straight(s0)
            if rise * (time - before) > 0.0:
                wanted = time - self._straight(slope) * (time - before) / rise
                wanted = min(max(wanted, 0.8 * time), 1.25 * time)
            elif slope * s0 > 0.0:
                # Two slopes alike tell nothing of where it is zero, only on which side.
                wanted = 0.8 * time if slope > 0.0 else 1.25 * time
        if not self.low < wanted < self.high:
            wanted = 0.5 * (self.low + self.high) if np.isfinite(self.high) else 1.2 * self.low
        return float(wanted)


def least_propellant(
    planner: Planner,
    descent: Descent,
    *,
    last: Path | None = None,
    elapsed: float = 0.0,
    walls: Walls | None = None,
    lossy: bool = False,
) -> Path:
    """Return the path of least propellant over all final times.

    `Path.settled` tells whether the search came to its end.

    Parameters
    ----------
    planner
        Solves.
    descent
        The problem.
    last
        A solution of nearly the same problem, `elapsed` s ago: four solves from there, one more
        where its masses are off. Where its final time cannot be flown, it is as without it.
    elapsed
        s.
    walls
        Half-spaces in place of the descent's cone.
    lossy
        Whether a path that breaks the limits of thrust by more than 5 % of the greatest is welcome
        as well: a bound of what can be flown, or a first guess.

    Raises
    ------
    InputError
        If the time elapsed is no number, 0 or more.
    InfeasibleError
        If there is none, with the nearest end found that can be reached.
    SolverError
        If the solver fails; a `RelaxationError` where its answer breaks the limits of thrust.
    """
    if not (is_number(elapsed) and elapsed >= 0.0):
        raise InputError("optimal.elapsed", elapsed, "a time in s, 0 or more")
    before = planner.solves
    path = _warm(planner, descent, last, elapsed, walls) if last is not None else None
    if path is None:
        path = _cold(planner, descent, walls)
    if path is None:
        path = _rescued(planner, descent, walls)
    if not (lossy or flyable(path)):
        raise RelaxationError(
            f"in the relaxed problem's answer thrust breaks its limits by {100.0 * path.excess:.0f}"
            f" % of the greatest ({path.duration:.1f} s): relaxing was not lossless"
        )
    return replace(path, solves=planner.solves - before)


def flyable(path: Path) -> bool:
    """Tell whether a path's thrust keeps its limits but for 5 % of the greatest, as they are flown.

    Where they are broken by more, relaxing was not lossless: too few intervals about a switch, or a
    bound on the state that binds for long.
    """
    return path.excess <= _LOSSY


def _rescued(planner: Planner, descent: Descent, walls: Walls | None) -> Path:
    """Search about the final time of the least landing error.

    Where fuel is short few final times can be flown: the error leads to them.
    """
    near = nearest(planner, descent, walls=walls)
    if near is not None and near.miss < max(10.0 * _NEAR, descent.region):
        first = iter((near.duration, 1.01 * near.duration, 0.99 * near.duration))
        path = search_about(planner, descent, first, walls=walls, log_mass=near.log_mass)
        if path is not None:
            return path
    why = "proven infeasible at every final time that was tried"
    if near is None:
        raise InfeasibleError(descent.end_position, why + "; nor is another end at that height")
    raise InfeasibleError(descent.end_position, why, near.position[-1])


def _warm(
    planner: Planner, descent: Descent, last: Path, elapsed: float, walls: Walls | None
) -> Path | None:
    """Search from a last solution; None where its final time cannot be flown."""
    first = last.duration - elapsed
    if not first > 0.0:
        return None
    log_mass = masses_left(last, elapsed, planner.intervals)
    return search_about(
        planner, descent, iter((first,)), walls=walls, most=_WARM, log_mass=log_mass,
        bend=last.curvature,
    )  # fmt: skip


def masses_left(last: Path, elapsed: float, intervals: int) -> Array:
    """Return ln(mass / mass now) in the middle of each interval (N,) of what is left of a path."""
    share = (np.arange(intervals) + 0.5) / intervals
    now = min(max(elapsed, 0.0), last.duration)
    at = now + share * (last.duration - now)
    return np.asarray(np.log(last.mass_at(at) / float(last.mass_at(now))))


def _cold(planner: Planner, descent: Descent, walls: Walls | None) -> Path | None:
    first = first_time(descent)
    return search_about(planner, descent, (s * first for s in _LADDER), walls=walls)


def search_about(
    planner: Planner,
    descent: Descent,
    first: Iterator[float],
    *,
    walls: Walls | None = None,
    most: int = _COLD,
    log_mass: Array | None = None,
    step: float = _STEP,
    bend: float = 0.0,
) -> Path | None:
    """Return the best path found from first final times on; None where none of them can be flown.

    Parameters
    ----------
    planner, descent, walls
        See `least_propellant`.
    first
        Final times, s: the next one is tried while none could be flown.
    most
        Solves at most, from the first final time on that can be flown.
    log_mass
        Guess of ln(mass / mass at the start) in the middle of each interval (N,).
    step
        Share of the final time by which the first one that can be flown is left at most.
    bend
        `curvature` of the path of a problem like this one; 0: not known.
    """
    search, best, failure = _Search(descent.gravity, step, bend), None, None
    settled, budget = False, np.inf
    time: float | None = next(first)
    while time is not None and planner.solves < budget:
        before = planner.solves
        try:
            path = planner.at_time(descent, time, log_mass=log_mass, walls=walls)
        except SolverError as error:  # another final time may do
            path, failure = None, error
        if path is None:
            if best is None:
                time = next(first, None)
                continue
            # Between what can be flown and what cannot the limit is approached by halves.
            search.exclude(time, best.duration)
            if settled := search.saves(best) < _GAIN * best.cost:
                break
            time = 0.5 * (time + best.duration)
            continue
        log_mass = path.log_mass
        budget = before + most if best is None else budget
        best = path if best is None or path.cost < best.cost else best
        search.add(time, path.slope)
        settled = path.slope**2 < 2.0 * search.curvature * _GAIN * path.cost
        if settled or (settled := search.saves(best) < _GAIN * best.cost):
            break
        time = search.next()
    if best is None and failure is not None:
        raise failure
    return best and replace(best, curvature=search.curvature, settled=settled)


def nearest(planner: Planner, descent: Descent, walls: Walls | None = None) -> Path | None:
    """Return a path whose end comes nearest; None: it cannot land anywhere at that height.

    Spare thrust is had for nothing.
    """
    if descent.spare > 0.0:
        descent = replace(descent, thrust_max=descent.thrust_max + descent.spare, spare=0.0)
    first = first_time(descent)
    search, best, log_mass = _Search(), None, None
    times = [s * first for s in _LADDER]
    time: float | None = times.pop(0)
    budget = planner.solves + 2 * _COLD + len(_LADDER)
    failure: SolverError | None = None
    while time is not None and planner.solves < budget:
        try:
            path = planner.at_time(descent, time, log_mass=log_mass, walls=walls, nearest=True)
        except SolverError as error:  # another final time may do
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
        if path.miss < _NEAR or left < 0.05 * _NEAR * path.miss:
            break
    if best is None and failure is not None:
        raise failure
    return best


def least_error(planner: Planner, descent: Descent) -> Path | None:
    """Return the path whose end comes nearest, and of these the one of least propellant.

    Blackmore, Acikmese and Scharf, "Minimum-landing-error powered-descent guidance for Mars landing
    using convex optimization", Journal of Guidance, Control, and Dynamics 33(4), 2010. The slope of
    the cone over the end goes where the end goes. None: it cannot land anywhere at that height.
    """
    near = nearest(planner, descent)
    if near is None:
        return None
    disc = replace(descent, region=near.miss * (1.0 + 1e-3) + 0.1)
    return planner.at_time(disc, near.duration, log_mass=near.log_mass) or near
