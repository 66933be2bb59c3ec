"""What it takes to fly to a ranked site, by a polynomial of bounded jerk and snap (Eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.apollo import PolynomialTrajectory, terminal_polynomial
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]

# The integrand is the norm of a quadratic: smooth but for near-zeros of the thrust.
_NODES, _WEIGHTS = leggauss(48)
_TIMES = np.geomspace(1.0, 1000.0, 400)


@dataclass(frozen=True)
class SiteCost:
    """Cost of reaching each of n sites.

    Attributes
    ----------
    increment
        F of Eq. 10: integral of the thrust acceleration (n,), m/s; inf where no time is found.
    propellant
        kg (n,).
    time_to_go
        s (n,); NaN where none is found.
    """

    increment: Array
    propellant: Array
    time_to_go: Array


def steepest(trajectory: PolynomialTrajectory) -> tuple[float, float]:
    """Return the greatest jerk (m/s^3) and snap (m/s^4) along a trajectory.

    Jerk is linear in time, so it is greatest at an end; snap is constant.
    """
    _, c1, c2 = trajectory.c
    ends = (c1, c1 + 2.0 * c2 * trajectory.time_to_go)
    return max(float(np.linalg.norm(j)) for j in ends), 2.0 * float(np.linalg.norm(c2))


def limited_time_to_go(
    position: ArrayLike, velocity: ArrayLike, target: PhaseEnd, *, jerk: float, snap: float
) -> float:
    """Return the least time-to-go (s) whose polynomial keeps both limits; NaN above 1000 s.

    Parameters
    ----------
    position, velocity
        Now (3,), m and m/s.
    target
        Boundary conditions at the end.
    jerk, snap
        Limits, m/s^3 and m/s^4.
    """
    for name, value in (("jerk", jerk), ("snap", snap)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"guidance.{name}", value, "a positive limit")

    def excess(time: float) -> float:
        j, s = steepest(terminal_polynomial(position, velocity, target, time))
        return max(j / jerk, s / snap) - 1.0

    previous = None
    for time in _TIMES:
        if excess(time) <= 0.0:
            return float(time if previous is None else brentq(excess, previous, time, xtol=1e-6))
        previous = time
    return float("nan")


def increment(trajectory: PolynomialTrajectory, gravity: float) -> float:
    """Return the integral of the thrust acceleration along a trajectory (Eq. 10), m/s."""
    half = 0.5 * trajectory.time_to_go
    acceleration = trajectory.at(half * (_NODES + 1.0))[2] + np.array([0.0, 0.0, gravity])
    return float(half * _WEIGHTS @ np.linalg.norm(acceleration, axis=-1))


def site_cost(
    estimate: Estimate,
    sites: ArrayLike,
    gravity: float,
    exhaust_velocity: float,
    *,
    jerk: float,
    snap: float,
    arrival_velocity: ArrayLike = (0.0, 0.0, -1.0),
) -> SiteCost:
    """Return what it takes to reach sites (n, 3), estimated ENU.

    The time-to-go is the least that keeps jerk and snap, as with Apollo. Thrust and glideslope are
    not looked at: `lunarsim.onboard.guidance.divert` does so before a site is flown to.

    Parameters
    ----------
    estimate
        The lander now.
    sites
        Where the trajectories end, m.
    gravity, exhaust_velocity
        m/s^2, m/s.
    jerk, snap
        Limits, m/s^3 and m/s^4.
    arrival_velocity
        At the site (3,), m/s.

    Raises
    ------
    InputError
        If a site, the estimate or a figure is not finite, or a figure or limit is not positive.
    """
    sites = np.atleast_2d(np.asarray(sites, dtype=np.float64)).reshape(-1, 3)
    for name, value in (
        ("sites", sites), ("position", estimate.position), ("velocity", estimate.velocity),
        ("arrival_velocity", np.asarray(arrival_velocity, dtype=np.float64)),
    ):  # fmt: skip
        if not np.isfinite(value).all():
            raise InputError(f"guidance.{name}", value.tolist(), "finite coordinates")
    for name, number in (
        ("gravity", gravity), ("exhaust_velocity", exhaust_velocity),
        ("mass", estimate.mass),
    ):  # fmt: skip
        if not (np.isfinite(number) and number > 0.0):
            raise InputError(f"guidance.{name}", number, "a positive number")
    times, totals = np.full(len(sites), np.nan), np.full(len(sites), np.inf)
    for n, site in enumerate(sites):
        target = PhaseEnd(site, np.asarray(arrival_velocity, dtype=np.float64))
        times[n] = limited_time_to_go(
            estimate.position, estimate.velocity, target, jerk=jerk, snap=snap
        )
        if np.isfinite(times[n]):
            path = terminal_polynomial(estimate.position, estimate.velocity, target, times[n])
            totals[n] = increment(path, gravity)
    return SiteCost(totals, estimate.mass * -np.expm1(-totals / exhaust_velocity), times)
