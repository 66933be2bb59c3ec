"""What it costs to fly to a site, and whether it can be done."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance import _kernels as k
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]

_SAMPLES = 24  # Simpson intervals along a trajectory: fuel to better than 0.1 %
_TIMES = 48  # candidate times-to-go


@dataclass(frozen=True)
class PathLimits:
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
    """Cost of reaching each of n sites.

    Attributes
    ----------
    propellant
        kg (n,); inf where no admissible trajectory exists or the tanks do not hold it.
    time_to_go
        Best time-to-go (n,), s; NaN where infeasible.
    peak_thrust, peak_tilt
        Greatest thrust (N) and lean of the thrust from the vertical (rad) on the way (n,); NaN
        where infeasible.
    """

    propellant: Array
    time_to_go: Array
    peak_thrust: Array
    peak_tilt: Array

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Tell which sites can be reached (n,)."""
        return np.isfinite(self.propellant)


def divert_cost(
    estimate: Estimate,
    end: PhaseEnd,
    lander: Lander,
    gravity: float,
    *,
    limits: PathLimits | None = None,
) -> DivertCost:
    """Find the cheapest admissible polynomial trajectory to each end of an approach.

    The integral of the thrust acceleration (Eq. 10 of the quadtree paper) is minimised over a
    range of times-to-go.

    Parameters
    ----------
    estimate
        Where the lander is.
    end
        Of the approach, for n sites.
    lander, gravity
        Thrust range, propellant, weight.
    limits
        What the trajectory must respect.
    """
    limits = limits or PathLimits()
    targets = np.ascontiguousarray(np.atleast_2d(end.position), dtype=np.float64)
    gap = np.linalg.norm(targets - estimate.position, axis=1)
    speed = float(np.linalg.norm(estimate.velocity))
    # Each target has times of its own: its answer does not depend on what else is asked for.
    slowest = np.maximum(20.0, 3.0 * gap / max(speed, 5.0))
    times = 3.0 * (slowest[:, None] / 3.0) ** np.linspace(0.0, 1.0, _TIMES)
    found = np.empty((len(targets), 4))
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    k.survey(
        np.ascontiguousarray(estimate.position),
        np.ascontiguousarray(estimate.velocity),
        targets,
        np.asarray(end.velocity, dtype=np.float64),
        np.asarray(end.acceleration, dtype=np.float64),
        times,
        _SAMPLES,
        gravity,
        estimate.mass,
        lander.exhaust_velocity,
        lander.thrust_min + margin,
        lander.thrust_max - margin,
        np.tan(limits.max_tilt),
        np.tan(limits.glideslope),
        found,
    )
    propellant = estimate.mass * -np.expm1(-found[:, 0] / lander.exhaust_velocity)
    left = estimate.mass - lander.dry_mass - limits.reserve
    good = propellant <= left
    return DivertCost(
        np.where(good, propellant, np.inf),
        np.where(good, found[:, 1], np.nan),
        np.where(good, found[:, 2], np.nan),
        np.where(good, np.arctan(found[:, 3]), np.nan),
    )
