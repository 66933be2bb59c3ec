"""Propellant cost and feasibility of a divert to each site."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance import _given_time_kernels as held
from lunarsim.onboard.guidance import _reach_kernels as k
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_finite

_SAMPLES = 24  # Simpson intervals along a path: propellant error below 0.1 %
_COARSE_TIMES = 14  # times-to-go of the coarse search
_COARSE_SAMPLES = 8  # Simpson intervals of the coarse search
# Upper time-to-go of the first search, as a multiple of the time at the current speed. Slower paths
# are rarely admissible; they are searched only if no faster one is.
_FIRST_SEARCH_TIME_RATIO = 8.0


@dataclass(frozen=True)
class PathLimits:
    """Limits of tilt, glideslope, propellant and thrust on a planned path.

    Attributes
    ----------
    max_tilt
        Maximum tilt of the thrust from the vertical, rad.
    glideslope
        Minimum elevation of the path, seen from the target, rad.
    reserve
        Propellant reserve at the target, kg.
    throttle_margin
        Fraction of the thrust range reserved for feedback at each end.
    """

    max_tilt: float = np.deg2rad(40.0)
    glideslope: float = np.deg2rad(8.0)
    reserve: float = 15.0
    throttle_margin: float = 0.08


@dataclass(frozen=True)
class DivertCost:
    """Propellant and time-to-go of the cheapest path to each of n sites.

    Attributes
    ----------
    propellant
        Propellant (n,), kg; inf if no admissible path exists or the propellant does not suffice.
    time_to_go
        Time-to-go with minimum propellant (n,), s; NaN if infeasible.
    peak_thrust, peak_tilt
        Maximum thrust (N) and tilt of the thrust from the vertical (rad) on the path (n,); NaN
        if infeasible.
    """

    propellant: Array
    time_to_go: Array
    peak_thrust: Array
    peak_tilt: Array

    @property
    def feasible(self) -> BoolArray:
        """Whether each site can be reached (n,)."""
        return np.isfinite(self.propellant)


@lru_cache(maxsize=32)
def _sample_table(shape: PathShape, samples: int) -> Array:
    """Return the fraction of time left and its two powers at samples of a path.

    `samples` is the number of intervals; the result (samples + 1, 3) is for `evaluate_path`.
    """
    left = 1.0 - np.arange(samples + 1) / samples
    return np.column_stack((left, left**shape.low, left**shape.high))


def admissible_times(
    estimate: Estimate, end: PhaseEnd, targets: Array, lander: Lander, gravity: float
) -> tuple[Array, Array]:
    """Return lower and upper bounds of the time-to-go to each target (n,), s.

    `targets` (n, 3) are end positions, m. The minimum is the time of constant maximum thrust
    straight towards the target. The maximum is the time for which the delta-v in the tanks can
    compensate gravity. The bounds of a target are independent of the other targets.
    """
    distance = np.linalg.norm(targets - estimate.position, axis=1)
    speed = float(np.linalg.norm(estimate.velocity))
    max_acceleration = lander.thrust_max / lander.dry_mass + gravity
    fastest = (
        2.0 * distance / (speed + np.sqrt(speed**2 + 2.0 * max_acceleration * distance) + 1e-12)
    )
    max_delta_v = lander.exhaust_velocity * np.log(max(estimate.mass / lander.dry_mass, 1.0))
    slowest = (max_delta_v + speed + float(np.linalg.norm(end.velocity))) / gravity
    first = np.maximum(fastest, 1.0)
    return first, np.maximum(slowest, first)


def _max_time_of_first_search(
    estimate: Estimate, targets: Array, first: Array, last: Array
) -> Array:
    """Return the upper limit of the time-to-go in the first search (n,), s.

    Slower paths, up to `last`, are searched only if no faster one is admissible. `first` and `last`
    (n,), s, are the bounds from `admissible_times`.
    """
    distance = np.linalg.norm(targets - estimate.position, axis=1)
    speed = float(np.linalg.norm(estimate.velocity))
    return np.asarray(
        np.minimum(last, _FIRST_SEARCH_TIME_RATIO * np.maximum(distance / max(speed, 5.0), first))
    )


def divert_cost(
    estimate: Estimate,
    end: PhaseEnd,
    lander: Lander,
    gravity: float,
    *,
    limits: PathLimits | None = None,
    shape: PathShape = APOLLO,
    min_times: Array | None = None,
    times: Array | None = None,
) -> DivertCost:
    """Find the minimum-propellant path of a guidance law to each end of an approach.

    The integral of the thrust acceleration (Eq. 10 of the quadtree paper) is minimised over
    admissible times-to-go, or evaluated at given times.

    Parameters
    ----------
    estimate
        Estimated state.
    end
        End state of the approach, for n sites.
    lander, gravity
        Lander, and downward gravitational acceleration, m/s^2.
    limits
        Limits on thrust, tilt, glideslope and propellant; default: default limits.
    shape
        Shape of the paths of the guidance law.
    min_times
        Minimum time-to-go of each site (n,), s; NaN: the site is out of reach.
    times
        Fixed time-to-go of each site (n,), s; None: search for the optimal one.

    Raises
    ------
    InputError
        If the estimate or an end is not finite, or gravity is not positive.
    """
    limits = limits or PathLimits()
    targets = np.ascontiguousarray(np.atleast_2d(end.position), dtype=np.float64)
    _check_inputs(estimate, end, gravity)
    first, last = admissible_times(estimate, end, targets, lander, gravity)
    if min_times is not None:
        first = np.maximum(first, min_times)
    params = _kernel_params(estimate, lander, gravity, limits)
    end_motion = np.array([end.velocity, end.acceleration], dtype=np.float64)
    if times is not None:
        given = np.where(times >= first, times, np.nan)
        path_costs = _evaluate_paths(estimate, targets, end_motion, given, shape, params)
        return _convert_costs(path_costs, estimate, lander, limits.reserve)
    search_limit = _max_time_of_first_search(estimate, targets, first, last)
    path_costs = _search_paths(estimate, targets, end_motion, first, search_limit, shape, params)
    slow = np.flatnonzero(~np.isfinite(path_costs[:, 0]) & (search_limit < last))
    if len(slow):
        path_costs[slow] = _search_paths(
            estimate, targets[slow], end_motion, np.maximum(first, search_limit)[slow], last[slow],
            shape, params,
        )  # fmt: skip
    return _convert_costs(path_costs, estimate, lander, limits.reserve)


def _search_paths(
    estimate: Estimate, targets: Array, end_motion: Array, first: Array, last: Array,
    shape: PathShape, params: Array,
) -> Array:  # fmt: skip
    """Find the path with minimum delta-v to each target, between two times.

    `targets` (n, 3) are positions, m, `end_motion` (2, 3) is final velocity and acceleration, and
    `first` and `last` (n,) are the bounds of the time-to-go, s. The result (n, 4) is that of
    `search_sites`. `params` is the result of `_kernel_params`.
    """
    found = np.empty((len(targets), 4))
    with threads_for(1.0 * len(targets)):
        k.search_sites(
            np.array([estimate.position, estimate.velocity], dtype=np.float64),
            np.ascontiguousarray(targets), end_motion, first, last, _COARSE_TIMES,
            _sample_table(shape, _COARSE_SAMPLES), _sample_table(shape, _SAMPLES),
            np.array(shape.powers), params, found,
        )  # fmt: skip
    return found


def _evaluate_paths(
    estimate: Estimate,
    targets: Array,
    end_motion: Array,
    times: Array,
    shape: PathShape,
    params: Array,
) -> Array:
    """Evaluate the path of a given time-to-go to each target.

    `targets` (n, 3) are positions, m, `end_motion` (2, 3) is final velocity and acceleration, and
    `times` (n,) are in s. The result (n, 4) is that of `evaluate_given_times`. `params` is the
    result of `_kernel_params`.
    """
    found = np.empty((len(targets), 4))
    with threads_for(0.1 * len(targets)):
        held.evaluate_given_times(
            np.array([estimate.position, estimate.velocity], dtype=np.float64), targets, end_motion,
            times, _sample_table(shape, _SAMPLES), np.array(shape.powers), params, found,
        )  # fmt: skip
    return found


def _convert_costs(
    path_costs: Array, estimate: Estimate, lander: Lander, reserve: float
) -> DivertCost:
    """Convert delta-v to propellant; sites that need too much are infeasible.

    `path_costs` (n, 4) is the result of `search_sites`; `reserve` is the propellant that must
    remain, kg.
    """
    propellant = estimate.mass * -np.expm1(-path_costs[:, 0] / lander.exhaust_velocity)
    good = propellant <= estimate.mass - lander.dry_mass - reserve
    return DivertCost(
        np.where(good, propellant, np.inf),
        np.where(good, path_costs[:, 1], np.nan),
        np.where(good, path_costs[:, 2], np.nan),
        np.where(good, np.arctan(path_costs[:, 3]), np.nan),
    )


def _kernel_params(estimate: Estimate, lander: Lander, gravity: float, limits: PathLimits) -> Array:
    """Return parameters of vehicle and limits for the kernel `evaluate_path` (7,)."""
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    return np.array(
        [
            gravity,
            estimate.mass,
            lander.exhaust_velocity,
            lander.thrust_min + margin,
            lander.thrust_max - margin,
            np.tan(limits.max_tilt),
            np.tan(limits.glideslope),
        ]
    )


def _check_inputs(estimate: Estimate, end: PhaseEnd, gravity: float) -> None:
    """Raise InputError if the state or the end is not finite or gravity not positive."""
    for name, value in (
        ("estimate.position", estimate.position),
        ("estimate.velocity", estimate.velocity),
        ("estimate.mass", np.asarray(estimate.mass)),
        ("end.position", end.position),
        ("end.velocity", end.velocity),
        ("end.acceleration", end.acceleration),
    ):
        check_finite(f"guidance.{name}", value)
    if not (np.isfinite(gravity) and gravity > 0.0):
        raise InputError("guidance.gravity", gravity, "must be positive and finite")
