"""What it costs to fly to a site, and whether it can be done."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance import _kernels as k
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]

_SAMPLES = 24  # Simpson intervals along a trajectory: fuel to better than 0.1 %
_TIMES = 48  # candidate times-to-go


@dataclass(frozen=True)
class DivertLimits:
    """What a trajectory must respect.

    Attributes
    ----------
    max_tilt
        Largest tilt of the thrust from the vertical, rad.
    glideslope
        Least elevation of the path as seen from the target, rad.
    reserve
        Propellant that must be left at the target, kg.
    throttle_margin
        Share of the thrust range kept back at either end for feedback.
    """

    max_tilt: float = np.deg2rad(40.0)
    glideslope: float = np.deg2rad(8.0)
    reserve: float = 15.0
    throttle_margin: float = 0.08


@dataclass(frozen=True)
class DivertCost:
    """Cost of reaching each of n targets.

    Attributes
    ----------
    propellant
        kg (n,); inf where no admissible trajectory exists or the tanks do not hold it.
    time_to_go
        Best time-to-go (n,), s; NaN where infeasible.
    """

    propellant: Array
    time_to_go: Array

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Tell which targets can be reached (n,)."""
        return np.isfinite(self.propellant)


def divert_cost(
    estimate: Estimate,
    targets: ArrayLike,
    lander: Lander,
    gravity: float,
    *,
    arrival_velocity: ArrayLike = (0.0, 0.0, -2.0),
    limits: DivertLimits | None = None,
) -> DivertCost:
    """Find the cheapest admissible polynomial trajectory to each target.

    The integral of the thrust acceleration (Eq. 10 of the quadtree paper) is minimised over a
    range of times-to-go.

    Parameters
    ----------
    estimate
        Where the lander is.
    targets
        Ends of the approach (n, 3), estimated ENU, m.
    lander, gravity
        Thrust range, propellant, weight.
    arrival_velocity
        Velocity at the target (3,), m/s.
    limits
        What the trajectory must respect.
    """
    limits = limits or DivertLimits()
    targets = np.ascontiguousarray(np.atleast_2d(targets), dtype=np.float64)
    gap = np.linalg.norm(targets - estimate.position, axis=1)
    speed = float(np.linalg.norm(estimate.velocity))
    slowest = max(20.0, 3.0 * float(gap.max(initial=1.0)) / max(speed, 5.0))
    times = np.geomspace(3.0, slowest, _TIMES)
    dv = np.empty(len(targets))
    best = np.empty(len(targets))
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    k.survey(
        np.ascontiguousarray(estimate.position),
        np.ascontiguousarray(estimate.velocity),
        targets,
        np.asarray(arrival_velocity, dtype=np.float64),
        np.zeros(3),
        times,
        _SAMPLES,
        gravity,
        (lander.thrust_min + margin) / estimate.mass,
        (lander.thrust_max - margin) / estimate.mass,
        np.tan(limits.max_tilt),
        np.tan(limits.glideslope),
        dv,
        best,
    )
    propellant = estimate.mass * -np.expm1(-dv / lander.exhaust_velocity)
    left = estimate.mass - lander.dry_mass - limits.reserve
    propellant = np.where(propellant <= left, propellant, np.inf)
    return DivertCost(propellant, np.where(np.isfinite(propellant), best, np.nan))
