"""Define reward weights of the environments; they do not affect flights."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class SiteReward:
    """Weights of the reward in the environment ``Retarget-v1`` (site selection).

    Attributes
    ----------
    safe, unsafe
        Reward for a safe landing, and for any other outcome.
    propellant
        Penalty per full tank of propellant used after the first decision.
    invalid
        Penalty for selecting an unavailable site, up to ten times per flight.
    speed, tilt, hazard
        Penalty for a safe touchdown at a landing limit, in proportion below it: the larger of the
        two speeds, the tilt, and the larger of slope and roughness under the pads.
    information
        Reward for removing all uncertainty of the map; each decision earns the part that it
        removes.
    shaping
        Weight of the shaping potential, which is p_safe of the current site; 0 disables it.
    """

    safe: float = quantity(1.0, help="Reward for a safe landing")
    unsafe: float = quantity(-1.0, help="Reward for any outcome other than a safe landing")
    propellant: float = quantity(
        1.0, ge=0, help="Penalty per full tank of propellant used after the first decision"
    )
    invalid: float = quantity(
        0.05,
        ge=0,
        help="Penalty each time the agent selects an unavailable site, at most ten times per "
        "flight",
    )
    speed: float = quantity(
        0.0,
        ge=0,
        help="Penalty for a safe touchdown with a speed at its limit, vertical or horizontal; "
        "proportionally smaller at lower speed",
    )
    tilt: float = quantity(
        0.0,
        ge=0,
        help="Penalty for a safe touchdown with a tilt at its limit; proportionally smaller at "
        "smaller tilt",
    )
    hazard: float = quantity(
        0.0,
        ge=0,
        help="Penalty for a safe touchdown on terrain with slope or roughness at its limit; "
        "proportionally smaller on smoother terrain",
    )
    information: float = quantity(
        0.0,
        ge=0,
        help="Reward for removing all uncertainty of the hazard map. A decision that removes a "
        "part of the uncertainty earns the same part of this reward",
    )
    shaping: float = quantity(
        0.0,
        ge=0,
        help="Weight of reward shaping by p_safe of the current site; 0: no shaping",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "weights")


@dataclass(frozen=True)
class DescentReward:
    """Weights of the reward in the environments ``Guidance-v1`` and ``Control-v1``.

    Attributes
    ----------
    safe, crash
        Reward for a touchdown within all limits, and for any other touchdown, at the target.
    no_landing
        Reward for a flight that ends without touchdown: at the time limit or far away.
    propellant
        Penalty per kilogram of propellant.
    miss
        Penalty per metre between a safe touchdown and the target, up to 50 m.
    severity
        Maximum penalty for the distance of a crash from the target. It applies at the distance of
        the planned start and beyond; closer crashes cost proportionally less.
    excess
        Penalty for exceeding a limit by a factor of e, summed over speeds, tilt and rate. A crash
        outside the stored terrain costs the maximum, a factor of e^3 for each limit.
    shaping
        Weight of the shaping potential; 0 disables it.
    """

    safe: float = quantity(10.0, help="Reward for a touchdown within all limits")
    crash: float = quantity(0.0, help="Reward for a touchdown at the target that violates a limit")
    no_landing: float = quantity(
        -15.0,
        help="Reward for a flight that ends without touchdown: at the time limit or far away",
    )
    propellant: float = quantity(0.002, ge=0, help="Penalty per kilogram of propellant used")
    miss: float = quantity(
        0.1,
        ge=0,
        help="Penalty per metre between a safe touchdown and the target; more than 50 m counts as "
        "50 m",
    )
    severity: float = quantity(
        6.0,
        ge=0,
        help="Additional penalty for a crash as far from the target as the planned start or "
        "farther; proportionally smaller for a nearer crash",
    )
    excess: float = quantity(
        0.2,
        ge=0,
        help="Additional penalty for a crash: this weight times ln(value / limit), at most 3, "
        "summed over the exceeded touchdown limits of speed, tilt and angular rate",
    )
    shaping: float = quantity(
        1.0, ge=0, help="Weight of potential-based reward shaping; 0: no shaping"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "weights")
