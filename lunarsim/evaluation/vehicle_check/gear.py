"""Landing gear: tip-over margins and the state at touchdown."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.vertical import VerticalDescent

_GEAR_KEYS = "raise vehicle.leg_radius_m, or lower vehicle.com_height_m"


def support_arm(lander: Lander, mass: float) -> float:
    """Return the distance from the centre of mass to the nearest edge of the legs, m.

    It is ``r cos(pi / n)`` for n legs on the radius r, minus the lateral offset of the centre of
    mass. `mass` is in kg.
    """
    com = lander.com(mass)
    arm = lander.leg_radius * np.cos(np.pi / lander.legs) - np.hypot(com[0], com[1])
    return float(arm)


def centre_height(lander: Lander, mass: float) -> float:
    """Return the height of the centre of mass above the pads, m, for a mass (kg)."""
    return lander.com_height + float(lander.com(mass)[2])


def static_tip_angle(lander: Lander, mass: float) -> float:
    """Return the slope on which a lander at rest tips over, rad.

    It is ``atan(arm / height)``; 0 if the centre of mass is outside the legs. `mass` is in kg.
    """
    arm = max(support_arm(lander, mass), 0.0)
    return float(np.arctan2(arm, centre_height(lander, mass)))


def tip_over_speed(lander: Lander, mass: float, slope: float, gravity: float) -> float:
    """Return the horizontal speed at touchdown that tips a lander over an edge, m/s.

    At contact the lander rotates about the edge with its angular momentum ``m v h``. It tips over
    if its energy ``(m v h)^2 / (2 J)`` exceeds ``m g l (1 - cos(tip - slope))``, with the distance
    l of the centre of mass from the edge and the moment of inertia ``J = I + m l^2``. This is the
    criterion of `lunarsim.core.touchdown.tip_margin`.

    Parameters
    ----------
    lander, mass
        Lander, and its mass at touchdown, kg.
    slope
        Terrain slope downwards to the edge, rad.
    gravity
        Downward acceleration, m/s^2.
    """
    arm, height = max(support_arm(lander, mass), 0.0), centre_height(lander, mass)
    left = float(np.arctan2(arm, height)) - slope
    if left <= 0.0:
        return 0.0
    length = float(np.hypot(arm, height))
    about_edge = float(lander.inertia(mass)[:2].min()) + mass * length**2
    barrier = mass * gravity * length * (1.0 - np.cos(left))
    return float(np.sqrt(2.0 * about_edge * barrier) / (mass * height))


def gear_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of the landing gear."""
    lander, mass = mission.lander, mission.touchdown_mass
    slope = lander.slope_limit
    yield CheckRow(
        "tip-over-static", "gear", "slope on which the lander tips over at rest",
        float(np.rad2deg(slope)), float(np.rad2deg(static_tip_angle(lander, mass))), "deg",
        f"Otherwise the lander tips over on a slope that counts as safe: {_GEAR_KEYS}.",
        wanted_margin=0.5,
    )  # fmt: skip
    yield CheckRow(
        "tip-over-speed", "gear",
        f"horizontal speed that tips the lander over on {np.rad2deg(slope):.3g} deg",
        lander.horizontal_speed_limit, tip_over_speed(lander, mass, slope, mission.gravity), "m/s",
        "Otherwise the lander tips over at a speed that counts as safe: lower "
        f"vehicle.horizontal_speed_limit_m_s, {_GEAR_KEYS}.", wanted_margin=0.25,
    )  # fmt: skip
    speed = -float(mission.terminal.velocity[-1, 2]) if mission.lands else np.inf
    yield CheckRow(
        "touchdown-speed", "gear", "vertical speed at touchdown of the nominal descent",
        lander.vertical_speed_limit, speed, "m/s",
        "Otherwise every landing violates the limit: lower approach.descent_speed_m_s or "
        "approach.vertical_speed_m_s, or raise vehicle.vertical_speed_limit_m_s.", "at most", 0.1,
    )  # fmt: skip
    law = getattr(mission.terminal_law, "last", mission.terminal_law)
    if isinstance(law, VerticalDescent):
        yield CheckRow(
            "touchdown-tilt", "gear", "tilt that the terminal descent commands at touchdown",
            float(np.rad2deg(lander.tilt_limit)), float(np.rad2deg(law.max_tilt_at_touchdown)),
            "deg", "Otherwise corrections of the last second violate the limit: raise "
            "vehicle.tilt_limit_deg.", "at most", 0.25,
        )  # fmt: skip
