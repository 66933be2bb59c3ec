"""Find the limit because of which no path leads from the start to the target."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import FlightSoftware
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array

# Values of the fields of `[approach]` that do not limit a path. The tilt of an approach must be
# below 85 deg; the default height and speed of the end suit every lander.
_WITHOUT_LIMIT: dict[str, Any] = {
    "max_tilt": np.deg2rad(84.0),
    "glideslope": 0.0,
    "reserve": 0.0,
    "throttle_margin": 0.0,
    "lower_throttle_margin": 0.0,
    "arrival_acceleration": (0.0, 0.0, 0.0),
    "arrival_velocity": (0.0, 0.0),
    "arrival_offset": (0.0, 0.0),
    "vertical_altitude": Approach().vertical_altitude,
    "vertical_speed": Approach().vertical_speed,
}
_UNITS = {"arrival_acceleration": "_m_s2", "arrival_velocity": "_m_s", "arrival_offset": "_m"}
_UNITS |= {"max_tilt": "_deg", "glideslope": "_deg", "reserve": "_kg", "vertical_speed": "_m_s"}
_UNITS |= {"vertical_altitude": "_m"}
# Factor on the largest thrust that counts as relaxing it.
_MORE_THRUST = 2.0
# Share of the dry mass that remains if the propellant counts as unlimited.
_DRY_SHARE = 0.5


@dataclass(frozen=True)
class _ReachabilityCase:
    """Inputs that determine whether a path leads from the start to the target.

    `start` is the estimated start state, `target` (3,) is in m, and `gravity` in m/s^2.
    """

    start: Estimate
    target: Array
    software: FlightSoftware
    approach: Approach
    lander: Lander
    gravity: float

    @property
    def feasible(self) -> bool:
        """Whether a path from the start to the target satisfies all limits."""
        end = self.approach.end(self.target[None, :], self.lander)
        cost = self.software.guidance.cost(
            self.start, end, self.lander, self.gravity, self.approach.limits
        )
        return bool(cost.feasible[0])


def unreachable(
    start: Estimate, target: Array, software: FlightSoftware, lander: Lander, gravity: float
) -> InputError:
    """Return the error for a `start` from which the target (3,) is not reachable.

    Each limit is relaxed separately. The error names the limits without which there is a path:
    first the fields of `[approach]` that differ from their defaults, then its other fields, the
    lander's limits and the start velocity. If no single limit is the cause, it names the start
    position.
    """
    approach, plain = software.approach, Approach()
    above = start.position - target
    ends = float(approach.vertical_altitude + lander.com_height)
    if ends >= above[2] > plain.vertical_altitude + lander.com_height:
        return InputError(
            "approach.vertical_altitude_m", approach.vertical_altitude,
            f"must be less than {above[2] - lander.com_height:.4g} m, the height of the lander at "
            "the start (start.position_m)",
        )  # fmt: skip
    case = _ReachabilityCase(start, target, software, approach, lander, gravity)
    causes = [(f, v) for f, v, relaxed in _relaxed_cases(case) if relaxed.feasible]
    if not causes:
        return InputError(
            "start.position_m", tuple(round(float(v), 1) for v in above),
            "must be a point from which a path leads to the target",
            "Start elsewhere, or relax the limits of thrust, tilt, glideslope and propellant.",
        )  # fmt: skip
    (field, value), *others = causes
    also = "".join(f", or {other} ({v})" for other, v in others)
    return InputError(
        field, value, "must allow a path from the start to the target", f"Relax this value{also}."
    )


def _relaxed_cases(case: _ReachabilityCase) -> Iterator[tuple[str, Any, _ReachabilityCase]]:
    """Yield scenario key and value of each limit, and the case without that limit."""
    approach, plain, lander = case.approach, Approach(), case.lander
    fields = [n for n, v in _WITHOUT_LIMIT.items() if getattr(approach, n) not in (None, v)]
    for name in sorted(fields, key=lambda n: getattr(approach, n) == getattr(plain, n)):
        value = getattr(approach, name)
        shown = round(float(np.rad2deg(value)), 9) if _UNITS.get(name) == "_deg" else value
        # A jerk does not limit a path, but requires a horizontal velocity.
        eased = replace(approach, **({"jerk": None} | {name: _WITHOUT_LIMIT[name]}))
        yield f"approach.{name}{_UNITS.get(name, '')}", shown, replace(case, approach=eased)
    yield (
        "vehicle.thrust_min_n", lander.thrust_min,
        replace(case, lander=replace(lander, thrust_min=0.0)),
    )  # fmt: skip
    stronger = replace(lander, thrust_max=_MORE_THRUST * lander.thrust_max)
    yield "vehicle.thrust_max_n", lander.thrust_max, replace(case, lander=stronger)
    # A lower dry mass at equal total mass means more propellant.
    lighter = replace(lander, dry_mass=_DRY_SHARE * lander.dry_mass)
    yield "vehicle.propellant_mass_kg", lander.propellant_mass, replace(case, lander=lighter)
    velocity = tuple(float(v) for v in case.start.velocity)
    at_rest = replace(case.start, velocity=np.zeros(3))
    yield "start.velocity_m_s", velocity, replace(case, start=at_rest)
