"""What environments reward, as a scenario says it; no flight is changed by it."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class SiteReward:
    """Weights of the reward of ``Retarget-v0``.

    Attributes
    ----------
    safe, unsafe
        At the end of a flight, for a safe and for any other end.
    propellant
        Cost of full tanks; what is burnt costs its share of them.
    invalid
        Cost of choosing a site that is not available, up to ten times a flight.
    speed, tilt, hazard
        Cost of a safe touchdown at the limits: of the larger of its speeds, of its tilt, of the
        larger of slope and roughness under the pads; below them in proportion.
    information
        Of a map that is sure of every cell over one that knows nothing; what a decision adds to it
        is rewarded.
    shaping
        Of the potential, the probability of safety of the site flown to; 0 leaves it out.
    discount
        The learner's: with another one shaping may change which policy is best.
    """

    safe: float = quantity(1.0, help="of a safe landing")
    unsafe: float = quantity(-1.0, help="of any other end")
    propellant: float = quantity(1.0, ge=0, help="cost of full tanks, in proportion")
    invalid: float = quantity(0.05, ge=0, help="cost of a choice that is not available")
    speed: float = quantity(0.0, ge=0, help="cost of a safe touchdown as fast as allowed")
    tilt: float = quantity(0.0, ge=0, help="cost of a safe touchdown as tilted as allowed")
    hazard: float = quantity(0.0, ge=0, help="cost of ground under the pads as bad as allowed")
    information: float = quantity(0.0, ge=0, help="of all that a map can tell")
    shaping: float = quantity(0.0, ge=0, help="of the present site's probability of safety")
    discount: float = quantity(0.99, gt=0, le=1, help="of the learner, for shaping")

    def __post_init__(self) -> None:
        check_bounds(self, "weights")


@dataclass(frozen=True)
class DescentReward:
    """Weights of the reward of ``Guidance-v0`` and ``Control-v0``.

    Attributes
    ----------
    safe, crash
        For a touchdown within all limits, and for any other end but the time limit.
    propellant
        Cost of a kilogram.
    miss
        Cost of a metre between a safe touchdown and the target, up to 50 m.
    severity
        Cost of a crash at the distance and the speed of the planned start, half of it for each;
        nearer and slower ones cost less, none more.
    excess
        Cost of a touchdown that exceeds a limit e-fold, summed over speeds, tilt and rate; a crash
        that is no touchdown counts as the worst.
    shaping
        Of the potential; 0 leaves it out.
    discount
        The learner's: with another one shaping may change which policy is best.
    """

    safe: float = quantity(1.0, help="of a touchdown within all limits")
    crash: float = quantity(-1.0, help="of any other end but the time limit")
    propellant: float = quantity(0.001, ge=0, help="cost of a kilogram")
    miss: float = quantity(0.01, ge=0, help="cost of a metre off the target, up to 50 m")
    severity: float = quantity(0.0, ge=0, help="cost of a crash as far off and fast as the start")
    excess: float = quantity(0.0, ge=0, help="cost of exceeding a limit e-fold")
    shaping: float = quantity(1.0, ge=0, help="of the potential")
    discount: float = quantity(0.99, gt=0, le=1, help="of the learner, for shaping")

    def __post_init__(self) -> None:
        check_bounds(self, "weights")
