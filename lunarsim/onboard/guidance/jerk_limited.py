"""Cost of flying to ranked sites by polynomials of bounded jerk and snap (Eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.onboard.guidance import _jerk_kernels as k
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.paths import APOLLO, PolynomialPath
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite

# The integrand is the norm of a quadratic: smooth except near zeros of the thrust.
_NODES, _WEIGHTS = leggauss(48)
_TIMES = np.geomspace(1.0, 1000.0, 120)


@dataclass(frozen=True)
class SiteCost:
    """Delta-v, propellant and time-to-go to reach each of n sites.

    Attributes
    ----------
    delta_v
        Integral of the thrust acceleration (F of Eq. 10 of the quadtree paper) (n,), m/s; inf if no
        time is found.
    propellant
        Propellant (n,), kg; equal to the mass if no time is found.
    time_to_go
        Minimum time-to-go within the limits of jerk and snap (n,), s; NaN if no time is found.
    """

    delta_v: Array
    propellant: Array
    time_to_go: Array


def max_jerk_and_snap(path: PolynomialPath) -> tuple[float, float]:
    """Return the maximum jerk (m/s^3) and snap (m/s^4) along a quartic path.

    Jerk and snap are the first and second derivative of the acceleration. Jerk is linear in time,
    so its maximum is at an end; snap is constant.

    Raises
    ------
    InputError
        If the path is not quartic.
    """
    if path.powers != APOLLO.powers:
        raise InputError(
            "guidance.powers", path.powers, f"must be {APOLLO.powers}, the powers of a quartic path"
        )
    first, second = path.terms
    ends = (first, first + 2.0 * second)
    most = max(float(np.linalg.norm(j)) for j in ends) / path.time_to_go
    return most, 2.0 * float(np.linalg.norm(second)) / path.time_to_go**2


def min_times_to_go(
    position: ArrayLike, velocity: ArrayLike, ends: PhaseEnd, *, jerk: float, snap: float
) -> Array:
    """Return the minimum times-to-go within limits of jerk and snap (n,), s.

    Times from 1 s to 1000 s are searched; the result is NaN if none of them keeps the limits.

    Parameters
    ----------
    position, velocity
        Current state (3,), m and m/s.
    ends
        Required states at the phase end, for one site or for n.
    jerk, snap
        Maximum jerk, m/s^3, and snap, m/s^4.

    Raises
    ------
    InputError
        If a limit is not positive.
    """
    for name, value in (("jerk", jerk), ("snap", snap)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"guidance.{name}", value, "must be positive and finite")
    targets = np.ascontiguousarray(np.atleast_2d(ends.position), dtype=np.float64)
    out = np.empty(len(targets))
    k.min_times_to_go.run_loop(
        len(targets),
        0.1,
        np.ascontiguousarray(position, dtype=np.float64),
        np.ascontiguousarray(velocity, dtype=np.float64),
        targets,
        np.asarray(ends.velocity, dtype=np.float64),
        np.asarray(ends.acceleration, dtype=np.float64),
        _TIMES,
        jerk,
        snap,
        out,
    )
    return out


def delta_v(path: PolynomialPath, gravity: float) -> float:
    """Return the integral of the thrust acceleration along a path, m/s.

    This is Eq. 10 of the quadtree paper; `gravity` is in m/s^2.
    """
    half = 0.5 * path.time_to_go
    acceleration = path.at(half * (_NODES + 1.0))[2] + np.array([0.0, 0.0, gravity])
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
    """Return delta-v, propellant and time-to-go to reach sites (n, 3), estimated ENU.

    Time-to-go is the minimum within the limits of jerk and snap, on Apollo paths. Thrust and
    glideslope are not checked here: `lunarsim.onboard.guidance.divert_cost` does it before a
    divert.

    Parameters
    ----------
    estimate
        Estimated state.
    sites
        End positions of the paths, m.
    gravity, exhaust_velocity
        Downward acceleration, m/s^2, and exhaust velocity, m/s.
    jerk, snap
        Maximum jerk, m/s^3, and snap, m/s^4.
    arrival_velocity
        Velocity at the site (3,), m/s.

    Raises
    ------
    InputError
        If an argument is not finite, or one that must be positive is not.
    """
    sites = np.atleast_2d(np.asarray(sites, dtype=np.float64)).reshape(-1, 3)
    for name, value in (
        ("sites", sites),
        ("estimate.position", estimate.position), ("estimate.velocity", estimate.velocity),
        ("arrival_velocity", np.asarray(arrival_velocity, dtype=np.float64)),
    ):  # fmt: skip
        check_finite(f"guidance.{name}", value)
    for name, number in (
        ("gravity", gravity), ("exhaust_velocity", exhaust_velocity),
        ("estimate.mass", estimate.mass),
    ):  # fmt: skip
        if not (np.isfinite(number) and number > 0.0):
            raise InputError(f"guidance.{name}", number, "must be positive and finite")
    ends = PhaseEnd(sites, np.asarray(arrival_velocity, dtype=np.float64))
    times = min_times_to_go(estimate.position, estimate.velocity, ends, jerk=jerk, snap=snap)
    totals = np.full(len(sites), np.inf)
    for n in np.flatnonzero(np.isfinite(times)):
        end = PhaseEnd(sites[n], ends.velocity)
        path = APOLLO.path(estimate.position, estimate.velocity, end, times[n])
        totals[n] = delta_v(path, gravity)
    return SiteCost(totals, estimate.mass * -np.expm1(-totals / exhaust_velocity), times)
