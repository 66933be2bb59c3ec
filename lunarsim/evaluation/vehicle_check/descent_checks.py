"""Throttle range, propellant and landing gear against the nominal descent."""

from __future__ import annotations

import numpy as np

from lunarsim.core.touchdown import tip_margin
from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import Check, Found, one
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.vehicle.touchdown import touchdown_params

# Downward acceleration left for corrections at touchdown: the gain of the vertical descent, 1.5
# 1/s, times a velocity error of 0.1 m/s.
_DOWNWARD_RESERVE_M_S2 = 0.15
# Maximum share of the approach with commands inside the throttle gap: about the share of the
# thrust range that planned paths reserve for feedback (approach.throttle_margin).
_MAX_GAP_SHARE = 0.1
# Relative excess at which the throttle leaves the lower range (`ThrottleRegions`).
_GAP_HYSTERESIS = 0.05


def _approach_path(mission: Mission) -> list[Found]:
    """Return the number of paths within the limits of angles: the planned path, or none."""
    return one(1.0, float(mission.path.is_within_limits))


def _gap(mission: Mission) -> list[Found]:
    """Return the share of the approach with commands inside the throttle gap.

    It is 1 if the terminal descent needs a thrust in the gap, with the hysteresis of the throttle.
    """
    if not isinstance(mission.lander, JetLander) or not mission.lander.engine.has_gap:
        return []
    low, high = mission.lander.engine.gap_lower, mission.lander.engine.gap_upper
    inside = (mission.path.thrust > low) & (mission.path.thrust < high)
    hovers = (1.0 - _GAP_HYSTERESIS) * low < mission.terminal_thrust < high
    return one(_MAX_GAP_SHARE, 1.0 if hovers else float(np.mean(inside)))


def nominal_propellant(mission: Mission) -> float:
    """Return the propellant of braking, approach and terminal descent, kg.

    Propellant of a phase is ``m0 (1 - exp(-dv / v_e))`` with its delta-v. The reserve is what must
    remain at the end of the approach: the terminal descent may use it, so the larger one of both
    counts.
    """
    end_mass = float(mission.path.mass[-1])
    terminal = max(end_mass - mission.touchdown_mass, mission.software.approach.reserve)
    return mission.braking_propellant + mission.start_mass - end_mass + terminal


def _divert_propellant(mission: Mission) -> list[Found]:
    """Return the propellant with the most expensive of the farthest diverts in reach.

    They are those of the first decision; the edge of the map limits them.
    """
    if mission.edge == 0.0:
        return []
    first = [d for d in mission.diverts[:1] for d in d if np.isfinite(d.time_to_go)]
    far = max((d.distance for d in first), default=0.0)
    extra = max((d.extra_propellant for d in first if d.distance > 0.99 * far), default=0.0)
    return one(nominal_propellant(mission) + extra, mission.lander.propellant_mass)


def _reach(mission: Mission) -> list[Found]:
    """Return half the radius of the map, and the radius in reach at the first decision.

    All sites within the radius are in reach.
    """
    if mission.edge == 0.0:
        return []
    first = [d for ring in mission.diverts[:1] for d in ring]
    nearest = min((d.distance for d in first if np.isnan(d.time_to_go)), default=np.inf)
    reach = max((d.distance for d in first if d.distance < 0.99 * nearest), default=0.0)
    return one(0.5 * mission.edge, reach)


def tip_over_speed(lander: Lander, mass: float, slope: float, gravity: float) -> float:
    """Return the horizontal speed at touchdown that tips a lander over an edge, m/s.

    It is the speed at which the margin of `lunarsim.core.touchdown.tip_margin`, ``1 - (v /
    v_tip)^2``, is 0 in the worst direction; 0 on a slope on which the lander does not stand. `mass`
    is in kg, the terrain slope `slope` in rad, `gravity` in m/s^2.
    """
    com, state, margins = lander.com(mass), np.zeros(15), []
    params = touchdown_params(lander, gravity)
    params = params._replace(com_height=params.com_height + float(com[2]))
    state[13] = mass
    for angle in np.deg2rad(np.arange(0.0, 360.0, 15.0)):
        state[3:5] = np.cos(angle), np.sin(angle)
        margins.append(float(tip_margin(state, lander.pads - com, slope, params)))
    return float(1.0 / np.sqrt(1.0 - min(margins)))


def _tip_over(mission: Mission) -> list[Found]:
    """Return the limit of horizontal speed and the speed that tips the lander over."""
    lander, slope = mission.lander, mission.lander.slope_limit
    speed = tip_over_speed(lander, mission.touchdown_mass, slope, mission.gravity)
    return one(lander.horizontal_speed_limit, speed, slope=np.rad2deg(slope))


def _touchdown_speed(mission: Mission) -> list[Found]:
    """Return the speed limit, and the descent speed plus the error that the throttle leaves.

    A thrust error F gives the vertical descent with gain k a speed error of ``F / (m k)``. The
    throttle leaves its dead band plus half a step.
    """
    lander, law = mission.lander, _vertical_descent(mission)
    error, gain = 0.0, law.speed_gain if law else VerticalDescent().speed_gain
    if isinstance(lander, JetLander):
        error = lander.engine.dead_band + 0.5 * lander.engine.throttle_step
    speed = mission.software.approach.vertical_descent_speed
    return one(lander.vertical_speed_limit, speed + error / (mission.touchdown_mass * gain))


def _touchdown_tilt(mission: Mission) -> list[Found]:
    """Return the tilt limit, and the tilt that law and attitude control allow at touchdown.

    The law reduces its maximum tilt linearly over the last metres. The attitude lags behind by the
    response time of the control; a phase-plane control leaves its dead band.
    """
    law, control = _vertical_descent(mission), mission.software.control
    if law is None:
        return []
    height = mission.software.approach.vertical_descent_speed * control.response_time
    lag = (law.max_tilt - law.max_tilt_at_touchdown) * min(height / law.full_tilt_height, 1.0)
    error = control.dead_band if isinstance(control, PhasePlane) else lag
    return one(mission.lander.tilt_limit, law.max_tilt_at_touchdown + error)


def _vertical_descent(mission: Mission) -> VerticalDescent | None:
    """Return the settings of the vertical descent; None for another law."""
    settings = mission.software.terminal_descent or VerticalDescent()
    return settings if isinstance(settings, VerticalDescent) else None


DESCENT_CHECKS = (
    Check("approach-path", "path", "number of planned paths within the limits of angles", "",
        _approach_path, "no path leads from the start to the target, or the given time-to-go does "
        "not suit it: raise approach.max_tilt_deg, lower approach.glideslope_deg, or change "
        "start.position_m or approach.time_to_go_s"),
    Check("approach-thrust-max", "throttle", "maximum thrust against the approach", "N",
        lambda m: one(m.path.thrust.max(), m.lander.thrust_max), "the lander does not brake as "
        "planned and falls short of the end of the approach: raise vehicle.thrust_max_n, or extend "
        "approach.time_to_go_s", wanted_margin=0.05),
    Check("approach-thrust-min", "throttle", "minimum thrust against the approach", "N",
        lambda m: one(m.path.thrust.min(), m.lander.thrust_min), "the engine cannot throttle down "
        "far enough and the lander flies above its path: lower vehicle.thrust_min_n, or change "
        "start.velocity_m_s", "at most"),
    Check("terminal-thrust-max", "throttle", "maximum thrust against the terminal descent", "N",
        lambda m: one(m.terminal_thrust, m.lander.thrust_max), "the lander cannot hold its rate of "
        "descent: raise vehicle.thrust_max_n, or lower approach.vertical_speed_m_s",
        wanted_margin=0.1),
    Check("terminal-thrust-min", "throttle", "minimum thrust against the weight at touchdown", "N",
        lambda m: one(m.touchdown_mass * (m.gravity - _DOWNWARD_RESERVE_M_S2), m.lander.thrust_min),
        "the lander does not descend and climbs as its mass decreases: lower vehicle.thrust_min_n, "
        "or raise vehicle.dry_mass_kg", "at most", 0.05),
    Check("engine-lag", "throttle", "duration of the terminal descent against the lag of the "
        "engine", "s", lambda m: one(m.lander.thrust_lag, m.terminal_time), "the lander cannot "
        "correct its speed before touchdown: lower vehicle.thrust_lag_s, or raise "
        "approach.vertical_altitude_m", wanted_margin=1.0),
    Check("throttle-gap", "throttle", "share of the descent with commands inside the throttle gap",
        "", _gap, "the engine alternates between both ends of the gap and the lander leaves its "
        "path: move vehicle.engine.gap_lower_n and gap_upper_n away from the weight at touchdown, "
        "or change approach.time_to_go_s", "at most"),
    Check("propellant-nominal", "propellant", "propellant for approach and reserve", "kg",
        lambda m: one(nominal_propellant(m), m.lander.propellant_mass), "the tanks are empty "
        "before touchdown: raise vehicle.propellant_mass_kg, lower approach.reserve_kg, or start "
        "closer to the target", wanted_margin=0.05),
    Check("propellant-divert", "propellant", "propellant for the same descent with a divert to the "
        "edge of the map", "kg", _divert_propellant, "safe sites near the edge of the map are "
        "refused for lack of propellant: raise vehicle.propellant_mass_kg, lower "
        "approach.reserve_kg, or reduce size_m of the map", wanted_margin=0.05),
    Check("divert-reach", "propellant", "radius in reach at the first decision against half the "
        "radius of the map", "m", _reach, "most of the mapped sites are out of reach: raise "
        "decisions.first_altitude_m, approach.max_tilt_deg or vehicle.thrust_max_n",
        wanted_margin=0.99),
    Check("tip-over-speed", "gear", "horizontal speed that tips the lander over on {slope:.3g} deg",
        "m/s", _tip_over, "the lander tips over at a speed or on a slope that counts as safe: "
        "lower vehicle.horizontal_speed_limit_m_s or com_height_m, or raise vehicle.leg_radius_m",
        wanted_margin=0.25),
    Check("touchdown-speed", "gear", "vertical speed at touchdown", "m/s", _touchdown_speed,
        "landings violate the limit: lower approach.descent_speed_m_s, "
        "vehicle.engine.dead_band_n or throttle_step_n", "at most", 0.1),
    Check("touchdown-tilt", "gear", "tilt that guidance and attitude control allow at touchdown", "deg",
        _touchdown_tilt, "corrections of the last seconds violate the limit, or the lander drifts: "
        "lower control.dead_band_deg, or raise vehicle.tilt_limit_deg", "at most", 0.25),
    Check("belly-clearance", "maps", "clearance under the body against the roughness limit", "m",
        lambda m: one(m.lander.roughness_limit, m.lander.belly_clearance), "rocks that count as "
        "safe touch the body: raise vehicle.belly_clearance_m, or lower vehicle.roughness_limit_m"),
)  # fmt: skip
