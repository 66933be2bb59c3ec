"""The search for the path that lets the lander know most of the ground in reach.

Paths are those of the Apollo law (Klumpp 1974), each told by its time-to-go and the acceleration at
its end: what is asked for there bends the whole path, to the side as well as up, so that it may
overfly the site or come in from elsewhere. Thousands of them, drawn evenly by Halton's sequence
over both and closer about the best, are scored by one kernel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from lunarsim._jit import threads_for
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert import PathLimits
from lunarsim.onboard.guidance.paths import APOLLO
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.seeking import _seeking_kernels as kernels
from lunarsim.onboard.seeking.eyes import Eye
from lunarsim.onboard.tasking.contract import Looks

Array = NDArray[np.float64]

# Samples by which limits are checked (Simpson's intervals), and from which looks are taken.
_FINE, _COARSE = 24, 24
# Bounds of the family: shares of the expected time-to-go, and accelerations at the end as shares
# of gravity: along the way there and across it, and up.
_TIMES = (0.7, 1.8)
_ALONG, _UP = 1.2, (-0.5, 1.2)
# A path close by differs from the best by such a share of the family's extents.
_CLOSE = 0.12


@dataclass(frozen=True)
class Plan:
    """A path, and what is expected of it.

    Attributes
    ----------
    time_to_go
        s.
    acceleration
        At its end (3,), m/s^2.
    known
        Share of the uncertainty about the ground in reach that will be gone.
    propellant
        kg.
    """

    time_to_go: float
    acceleration: Array
    known: float
    propellant: float


@dataclass(frozen=True)
class Problem:
    """What a plan is made for.

    Attributes
    ----------
    estimate
        Where the lander is when it begins.
    end
        Where the approach ends.
    site
        The site (3,), m.
    nodes
        Of the ground (g, 6), see the kernel.
    lander, gravity, limits
        Of the vehicle, m/s^2, and of its paths.
    standing
        Height of the centre of mass over the pads, m.
    least_altitude
        Of the pads above the site, below which looks no longer count, m.
    passed
        Least altitude so far, m: single looks above it are past.
    """

    estimate: Estimate
    end: PhaseEnd
    site: Array
    nodes: Array
    lander: Lander
    gravity: float
    limits: PathLimits
    standing: float
    least_altitude: float
    passed: float = np.inf


class SeekingPlanner:
    """Scores the family of paths with what is known of sensors and their schedules.

    Parameters
    ----------
    eyes, looks
        Sensors, and when each of them measures.
    candidates
        Paths looked at for a plan.
    price
        Share of the uncertainty that a kilogram of propellant is worth, 1/kg.
    end_tilt
        Greatest lean of the thrust at the end of the approach, rad.
    """

    def __init__(
        self, eyes: list[Eye], looks: list[Looks], candidates: int, price: float, end_tilt: float
    ) -> None:
        self.candidates, self.price, self.end_tilt = candidates, price, end_tilt
        self._looks = looks
        self._tables = [
            np.ascontiguousarray([getattr(eye, name) for eye in eyes])
            for name in ("sharp", "open", "astray", "told")
        ]
        self._figures = np.array([_figures_of(e, o) for e, o in zip(eyes, looks, strict=True)])
        self._fine, self._coarse = _samples(_FINE), _samples(_COARSE)

    def best(
        self, problem: Problem, expected: float, most: float, last: Plan | None
    ) -> Plan | None:
        """Return the best path that keeps the limits; None without one.

        Where none is to be had for what it may take, it is the one that takes least.

        Parameters
        ----------
        problem
            From where to where, over which ground.
        expected
            Time-to-go about which paths are looked for, s.
        most
            Propellant that a path may take, kg.
        last
            What is flown now: it stays unless another is better.
        """
        low, high = self._bounds(problem, expected)
        plans = self.drawn(problem, expected, 2 * self.candidates // 3)
        if last is not None:
            plans = np.vstack((_row(last), plans))
        value, known, burnt = self._values(problem, plans, most)
        if not np.isfinite(value).any():
            most = float(np.min(burnt))
            value, known, burnt = self._values(problem, plans, most)
        first = int(np.argmax(value))
        if not np.isfinite(value[first]):
            return None
        near = _CLOSE * (high - low) * (_spread(self.candidates // 3) - 0.5)
        about = plans[first] + _turned(problem, near)
        about[:, 0] = np.maximum(about[:, 0], 1.0)
        better, known_too, burnt_too = self._values(problem, about, most)
        plans = np.vstack((plans, about))
        value = np.append(value, better)
        known, burnt = np.append(known, known_too), np.append(burnt, burnt_too)
        k = int(np.argmax(value))
        return Plan(float(plans[k, 0]), plans[k, 1:].copy(), float(known[k]), float(burnt[k]))

    def _bounds(self, problem: Problem, expected: float) -> tuple[Array, Array]:
        """Return the least and greatest parameters of the family (4,), along and across."""
        g = problem.gravity
        low = np.array([_TIMES[0] * expected, -_ALONG * g, -_ALONG * g, _UP[0] * g])
        high = np.array([_TIMES[1] * expected, _ALONG * g, _ALONG * g, _UP[1] * g])
        low[0] = max(low[0], 1.0)
        return low, np.maximum(high, low)

    def drawn(self, problem: Problem, expected: float, count: int) -> Array:
        """Return plans spread evenly over the family (count, 4): time and acceleration at the end.

        Parameters
        ----------
        problem
            From where to where.
        expected
            Time-to-go about which they lie, s.
        count
            How many.
        """
        low, high = self._bounds(problem, expected)
        return _turned(problem, low + (high - low) * _spread(count))

    def _values(self, problem: Problem, plans: Array, most: float) -> tuple[Array, Array, Array]:
        """Return worth, share known and propellant (kg) of plans (n,); -inf: not to be had."""
        scored = self.score(problem, plans)
        e, lander = problem.estimate, problem.lander
        burnt = e.mass * -np.expm1(-scored[:, 1] / lander.exhaust_velocity)
        held = e.mass - lander.dry_mass - problem.limits.reserve
        good = burnt <= min(most, held)
        value = np.where(good, scored[:, 0] - self.price * np.where(good, burnt, 0.0), -np.inf)
        return value, scored[:, 0], burnt

    def score(self, problem: Problem, plans: Array) -> Array:
        """Return share known and increment (m/s) of plans (n, 4): time and acceleration (n, 2)."""
        p = problem
        out = np.empty((len(plans), 2))
        vehicle = vehicle_figures(p.estimate, p.lander, p.gravity, p.limits)
        ground = np.array([*p.site, p.site[2] + p.standing, p.least_altitude])
        with threads_for(10.0 * len(plans)):
            kernels.score(
                np.array([p.estimate.position, p.estimate.velocity], dtype=np.float64),
                np.asarray(p.end.position, dtype=np.float64),
                np.asarray(p.end.velocity, dtype=np.float64), np.ascontiguousarray(plans),
                self._fine, self._coarse, np.array(APOLLO.powers), vehicle,
                float(np.tan(self.end_tilt)), ground, np.ascontiguousarray(p.nodes),
                *self._tables, self._figures, self._stations(p.passed), out,
            )  # fmt: skip
        return out

    def _stations(self, passed: float) -> Array:
        """Return altitudes of single looks that are to come (eyes, k); NaN for none.

        An eye all of whose looks are past has one that is never reached.
        """
        most = max(max((len(o.at) for o in self._looks), default=0), 1)
        out = np.full((len(self._looks), most), np.nan)
        for row, looks in zip(out, self._looks, strict=True):
            if looks.at:
                ahead = [h for h in looks.at if h < passed] or [-np.inf]
                row[: len(ahead)] = ahead
        return out


def _turned(problem: Problem, plans: Array) -> Array:
    """Return plans with accelerations in ENU that are given along the way there, and across it.

    Along is the way over ground from the lander to the end.
    """
    way = problem.end.position[:2] - problem.estimate.position[:2]
    size = float(np.hypot(*way))
    along = way / size if size > 1.0 else np.array([1.0, 0.0])
    out = plans.copy()
    a, b = plans[:, 1], plans[:, 2]
    out[:, 1] = a * along[0] - b * along[1]
    out[:, 2] = a * along[1] + b * along[0]
    return out


def _figures_of(eye: Eye, looks: Looks) -> list[float]:
    """Return an eye's figures as the kernel takes them (9,)."""
    field = 1.0 / np.sqrt(1.0 + eye.half_field**2)
    limit = float(np.cos(min(eye.gimbal_limit, np.pi)))
    return [
        eye.pixel, eye.sharpest, field, limit, eye.longest, looks.highest, looks.lowest, *eye.sun,
    ]  # fmt: skip


def vehicle_figures(
    estimate: Estimate, lander: Lander, gravity: float, limits: PathLimits
) -> Array:
    """Return vehicle and limits as `measure` takes them (7,)."""
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    return np.array([
        gravity, estimate.mass, lander.exhaust_velocity, lander.thrust_min + margin,
        lander.thrust_max - margin, np.tan(limits.max_tilt), np.tan(limits.glideslope),
    ])  # fmt: skip


def _samples(count: int) -> Array:
    """Return share of the time that is left and its powers along a path (count + 1, 3)."""
    left = 1.0 - np.arange(count + 1) / count
    return np.column_stack((left, left**APOLLO.low, left**APOLLO.high))


def _row(plan: Plan) -> Array:
    return np.array([[plan.time_to_go, *plan.acceleration]])


@lru_cache(maxsize=8)
def _spread(count: int) -> Array:
    """Return points spread evenly over the unit cube (count, 4)."""
    drawn: Any = qmc.Halton(4, scramble=False).random(max(count, 1) + 1)[1:]
    return np.asarray(drawn)
