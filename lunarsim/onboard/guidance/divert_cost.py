"""Propellant cost and feasibility of a divert to each site."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lunarsim.core import divert as core
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_finite

_SAMPLES = 24  # Simpson intervals along a path: propellant error below 0.1 %
_COARSE_SAMPLES = 8  # Simpson intervals of the coarse search


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
        Fraction of the thrust range reserved for feedback at its upper end.
    lower_throttle_margin
        The same at its lower end; None: as at the upper end.
    max_final_tilt
        Maximum tilt of the thrust at the end of the path, rad, where it is below `max_tilt`.
    """

    max_tilt: float = np.deg2rad(40.0)
    glideslope: float = np.deg2rad(8.0)
    reserve: float = 15.0
    throttle_margin: float = 0.08
    lower_throttle_margin: float | None = None
    max_final_tilt: float = 0.5 * np.pi

    def thrust_range(self, lander: Lander) -> tuple[float, float]:
        """Return the minimum and maximum thrust of planned paths of a lander, N."""
        upper, lower = self.throttle_margin, self.lower_throttle_margin
        lower, throttle = upper if lower is None else lower, lander.thrust_max - lander.thrust_min
        return lander.thrust_min + lower * throttle, lander.thrust_max - upper * throttle

    def params(self, mass: float, lander: Lander, gravity: float) -> Array:
        """Return the `params` of the kernel `evaluate_path` (8,).

        They are gravity, m/s^2, mass, kg, exhaust velocity, m/s, minimum and maximum thrust reduced
        by the throttle margins, N, and the tangents of the limits of tilt, glideslope and final
        tilt.
        """
        return np.array([
            gravity, mass, lander.exhaust_velocity, *self.thrust_range(lander),
            np.tan(self.max_tilt), np.tan(self.glideslope),
            np.tan(min(self.max_final_tilt, self.max_tilt)),
        ])  # fmt: skip


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
        """Whether each site can be reached (n,).

        A site can be reached if its propellant is finite.
        """
        return np.isfinite(self.propellant)


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
    targets = np.ascontiguousarray(np.atleast_2d(end.position), dtype=np.float64)
    _check_inputs(estimate, end, gravity)
    count = len(targets)
    shortest = np.zeros(count) if min_times is None else np.asarray(min_times, dtype=np.float64)
    state = np.array([estimate.position, estimate.velocity], dtype=np.float64)
    law, mass = divert_params(shape, end, lander, gravity, limits or PathLimits()), estimate.mass
    found = np.empty((count, 4))
    if times is None:
        core.divert_costs.run_loop(count, 1.0, state, mass, targets, shortest, law, found)
    else:
        given = np.where(times >= shortest, times, np.nan)
        core.costs_at_times.run_loop(count, 0.1, state, mass, targets, given, law, found)
    return DivertCost(found[:, 0], found[:, 1], found[:, 2], np.arctan(found[:, 3]))


@lru_cache(maxsize=32)
def _sample_table(shape: PathShape, samples: int) -> Array:
    """Return `core.sample_table` of a path shape (samples + 1, 3), cached."""
    return np.asarray(core.sample_table(shape.powers, samples))


def divert_params(
    shape: PathShape, end: PhaseEnd, lander: Lander, gravity: float, limits: PathLimits
) -> core.DivertParams:
    """Pack path shape, end state, lander and limits for compiled functions.

    `gravity` is the downward acceleration, m/s^2. The thrust range is reduced by the throttle
    margins of `limits`; the position of `end` is not included.
    """
    masses = (
        lander.thrust_max / lander.dry_mass, lander.dry_mass, lander.exhaust_velocity,
        limits.reserve,
    )  # fmt: skip
    return core.DivertParams(
        np.array(shape.powers), np.array([end.velocity, end.acceleration], dtype=np.float64),
        limits.params(lander.wet_mass, lander, gravity), _sample_table(shape, _COARSE_SAMPLES),
        _sample_table(shape, _SAMPLES), np.array(masses),
    )  # fmt: skip


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
