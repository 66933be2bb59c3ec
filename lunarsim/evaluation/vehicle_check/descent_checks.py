"""Throttle range, propellant and landing gear against the nominal descent."""

from __future__ import annotations

import numpy as np

from lunarsim.core.touchdown import tip_margin
from lunarsim.evaluation.vehicle_check.attitude import trim_angles
from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import AT_LEAST, AT_MOST, Check, Found, one
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


def _terminal_tilt(mission: Mission) -> list[Found]:
    """Return needed and maximum tilt for the horizontal motion after the approach.

    In the time t of the terminal descent, the offset r and the velocity v reach 0 with a linear
    acceleration that begins with ``-6 r / t^2 - 4 v / t`` (E-guidance).
    """
    law, path, time = mission.vertical_descent, mission.path, mission.terminal_time
    if law is None:
        return []
    start = 6.0 * path.position[-1, :2] / time**2 + 4.0 * path.velocity[-1, :2] / time
    tilt = np.arctan(np.linalg.norm(start) / (mission.gravity + mission.terminal_deceleration))
    return one(tilt, law.max_tilt)


def nominal_propellant(mission: Mission) -> float:
    """Return the propellant of braking, approach and terminal descent, kg.

    Propellant of a phase is ``m0 (1 - exp(-dv / v_e))`` with its delta-v. The reserve is what must
    remain at the end of the approach: the terminal descent may use it, so the larger one of both
    counts.
    """
    end_mass = float(mission.path.mass[-1])
    terminal = max(end_mass - mission.touchdown_mass, float(mission.software.approach.reserve))
    return mission.braking_propellant + mission.start_mass - end_mass + terminal


def _divert_propellant(mission: Mission) -> list[Found]:
    """Return the propellant with the costliest of the farthest diverts in reach.

    They are those of the first decision; the edge of the map limits them.
    """
    if mission.edge == 0.0:
        return []
    first = [d for d in mission.first_diverts if np.isfinite(d.time_to_go)]
    far = max((d.distance for d in first), default=0.0)
    extra = max((d.extra_propellant for d in first if d.distance > 0.99 * far), default=0.0)
    return one(nominal_propellant(mission) + extra, mission.lander.propellant_mass)


def _reach(mission: Mission) -> list[Found]:
    """Return half the radius of the map, and the radius in reach.

    All sites within the radius are in reach at the first decision.
    """
    if mission.edge == 0.0:
        return []
    diverts = mission.first_diverts
    nearest = min((d.distance for d in diverts if np.isnan(d.time_to_go)), default=np.inf)
    reach = max((d.distance for d in diverts if d.distance < 0.99 * nearest), default=0.0)
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
    """Return the limit of vertical speed, and the speed at touchdown.

    A thrust error F gives the vertical descent with gain k a speed error of ``F / (m k)``. The
    throttle leaves its dead band plus half a step. Pulses of the thrust P with the period T and the
    duty cycle d change the speed by ``P d (1 - d) T / m``, half of it up and half of it down. The
    speed is the nominal one plus these errors.
    """
    lander, law, mass = mission.lander, mission.vertical_descent, mission.touchdown_mass
    error, gain = 0.0, law.speed_gain if law else VerticalDescent().speed_gain
    if isinstance(lander, JetLander):
        engine, weight = lander.engine, mass * mission.gravity
        error = (engine.dead_band + 0.5 * engine.throttle_step) / gain
        if engine.continuous_min > weight:
            off = 1.0 - weight / engine.continuous_min
            error += 0.5 * weight * off * engine.pulse_period
    speed = mission.software.approach.vertical_descent_speed
    return one(lander.vertical_speed_limit, speed + error / mass)


def _touchdown_drift(mission: Mission) -> list[Found]:
    """Return the limit of horizontal speed, and that at which the law touches down."""
    law = mission.vertical_descent
    return [] if law is None else one(mission.lander.horizontal_speed_limit, law.tolerated_speed)


def _hold_end(mission: Mission) -> list[Found]:
    """Return the propellant from a hold to touchdown, and that which ends it, kg.

    The vertical descent holds up to the height at which it tilts, and then descends at its minimum
    speed against gravity.
    """
    law, speed = mission.vertical_descent, mission.software.approach.vertical_descent_speed
    if law is None:
        return []
    dv = mission.gravity * law.low_height / (law.min_speed_fraction * speed)
    needed = mission.touchdown_mass * (1.0 - np.exp(-dv / mission.lander.exhaust_velocity))
    return one(needed, law.hold_propellant)


def _hold_start(mission: Mission) -> list[Found]:
    """Return the propellant at the nominal touchdown, and that which ends a hold, kg."""
    law = mission.vertical_descent
    left = mission.touchdown_mass - mission.lander.dry_mass
    return [] if law is None else one(left, law.hold_propellant)


def _remaining_tilt(mission: Mission, law: VerticalDescent) -> tuple[float, float]:
    """Return tilt, rad, and rate, rad/s, that an attitude loop has left at touchdown.

    The commanded tilt is at its maximum, which the law reduces linearly with the height, and over
    the last seconds to zero. The attitude follows it with a first-order lag T, the response time of
    the control. The command at touchdown is zero, so that the rate is the remaining tilt over T.
    """
    lag = max(mission.software.control.response_time, 1e-3)
    before = np.linspace(0.0, 20.0 * lag, 4001)  # time before touchdown, s
    height = mission.software.approach.vertical_descent_speed * before
    share = np.minimum(height / law.full_tilt_height, 1.0)
    tilt = law.max_tilt_at_touchdown + share * (law.max_tilt - law.max_tilt_at_touchdown)
    tilt *= np.minimum(before / law.upright_time, 1.0)
    left = float(np.trapezoid(tilt * np.exp(-before / lag), before) / lag)
    return left, left / lag


def _touchdown_tilt(mission: Mission) -> list[Found]:
    """Return the tilt limit, and the tilt that can remain at touchdown.

    A phase-plane control leaves its dead band. A lander whose gimbal points the thrust at a centre
    of mass beside the engine's axis hovers with the tilt of the gimbal.
    """
    law, lander, control = mission.vertical_descent, mission.lander, mission.software.control
    if law is None:
        return []
    if isinstance(control, PhasePlane):
        tilt = law.max_tilt_at_touchdown + control.dead_band
    else:
        tilt = _remaining_tilt(mission, law)[0]
    if isinstance(lander, JetLander):
        tilt += float(np.hypot(*trim_angles(lander, mission.touchdown_mass)))
    return one(lander.tilt_limit, tilt)


def _touchdown_rate(mission: Mission) -> list[Found]:
    """Return the limit of the angular rate, and the rate that can remain at touchdown."""
    law = mission.vertical_descent
    return [] if law is None else one(mission.lander.rate_limit, _remaining_tilt(mission, law)[1])


DESCENT_CHECKS = (
    Check("approach-path", "path", "", AT_LEAST, 0.0, lambda m: one(1, m.path.is_within_limits),
        "number of planned paths within the limits of tilt and glideslope",
        "the target is out of reach: change approach.max_tilt_deg, glideslope_deg, time_to_go_s or "
        "start.position_m"),
    Check("approach-thrust-max", "throttle", "N", AT_LEAST, 0.05,
        lambda m: one(m.path.thrust.max(), m.lander.thrust_max),
        "maximum thrust against the approach",
        "the lander does not brake as planned: raise vehicle.thrust_max_n or "
        "approach.time_to_go_s"),
    Check("approach-thrust-min", "throttle", "N", AT_MOST, 0.0,
        lambda m: one(m.path.thrust.min(), m.lander.thrust_min),
        "minimum thrust against the approach",
        "the lander flies above its path: lower vehicle.thrust_min_n, or change "
        "start.velocity_m_s"),
    Check("terminal-thrust-max", "throttle", "N", AT_LEAST, 0.1,
        lambda m: one(m.terminal_thrust, m.lander.thrust_max),
        "maximum thrust against the terminal descent",
        "the lander cannot hold its rate of descent: raise vehicle.thrust_max_n"),
    Check("terminal-thrust-min", "throttle", "N", AT_MOST, 0.05,
        lambda m: one(m.touchdown_mass * (m.gravity - _DOWNWARD_RESERVE_M_S2), m.lander.thrust_min),
        "minimum thrust against the weight at touchdown",
        "the lander climbs as its mass decreases: lower vehicle.thrust_min_n"),
    Check("terminal-tilt", "throttle", "deg", AT_LEAST, 0.0, _terminal_tilt,
        "maximum tilt of the terminal descent against the horizontal motion at its start",
        "the lander misses the site: lower approach.takeover_altitude_m, "
        "end_time_to_go_s or arrival_velocity_m_s"),
    Check("throttle-gap", "throttle", "", AT_MOST, 0.0, _gap,
        "share of the descent with commands inside the throttle gap",
        "the engine alternates between both ends of the gap: move vehicle.engine.gap_lower_n and "
        "gap_upper_n away from the weight at touchdown, or change approach.time_to_go_s"),
    Check("engine-lag", "throttle", "s", AT_LEAST, 1.0,
        lambda m: one(m.lander.thrust_lag, m.terminal_time),
        "duration of the terminal descent against the lag of the engine",
        "the lander cannot correct its speed: lower vehicle.thrust_lag_s, or raise "
        "approach.vertical_altitude_m"),
    Check("propellant-nominal", "propellant", "kg", AT_LEAST, 0.05,
        lambda m: one(nominal_propellant(m), m.lander.propellant_mass),
        "propellant for approach and reserve",
        "the tanks are empty before touchdown: raise vehicle.propellant_mass_kg, lower "
        "approach.reserve_kg, or start closer to the target"),
    Check("propellant-divert", "propellant", "kg", AT_LEAST, 0.05, _divert_propellant,
        "propellant for the same descent with a divert to the edge of the map",
        "safe sites near the edge of the map are refused for lack of propellant: raise "
        "vehicle.propellant_mass_kg, or lower approach.reserve_kg or size_m of the map"),
    Check("hold-end", "propellant", "kg", AT_LEAST, 0.0, _hold_end,
        "propellant that ends a hold of the height against the descent from there",
        "the tanks are empty before touchdown: raise terminal_descent.hold_propellant_kg"),
    Check("hold-start", "propellant", "kg", AT_MOST, 0.0, _hold_start,
        "propellant that ends a hold of the height against that left at touchdown",
        "the lander never holds its height near the terrain: lower "
        "terminal_descent.hold_propellant_kg, or raise vehicle.propellant_mass_kg"),
    Check("divert-reach", "propellant", "m", AT_LEAST, 0.99, _reach,
        "radius in reach at the first decision against half the radius of the map",
        "most of the mapped sites are out of reach: raise decisions.first_altitude_m, "
        "approach.max_tilt_deg or vehicle.thrust_max_n"),
    Check("tip-over-speed", "gear", "m/s", AT_LEAST, 0.25, _tip_over,
        "horizontal speed that tips the lander over on {slope:.3g} deg",
        "the lander tips over at a speed or on a slope that counts as safe: lower "
        "vehicle.horizontal_speed_limit_m_s or com_height_m, or raise vehicle.leg_radius_m"),
    Check("touchdown-speed", "gear", "m/s", AT_MOST, 0.1, _touchdown_speed,
        "vertical speed at touchdown",
        "landings violate the limit: lower approach.descent_speed_m_s, vehicle.engine.dead_band_n "
        "or throttle_step_n"),
    Check("touchdown-drift", "gear", "m/s", AT_MOST, 0.1, _touchdown_drift,
        "horizontal speed at which the terminal descent touches down",
        "landings violate the limit: lower terminal_descent.tolerated_speed_m_s"),
    Check("touchdown-tilt", "gear", "deg", AT_MOST, 0.25, _touchdown_tilt,
        "tilt that guidance and attitude control allow at touchdown",
        "landings violate the limit, or the lander drifts: lower control.dead_band_deg, raise "
        "control.frequency_rad_s, or move vehicle.com_dry_m to the engine's axis"),
    Check("touchdown-rate", "gear", "deg/s", AT_MOST, 0.25, _touchdown_rate,
        "angular rate that guidance and attitude control allow at touchdown",
        "landings violate the limit: raise terminal_descent.upright_time_s"),
    Check("belly-clearance", "maps", "m", AT_LEAST, 0.0,
        lambda m: one(m.lander.roughness_limit, m.lander.belly_clearance),
        "clearance under the body against the roughness limit",
        "rocks that count as safe touch the body: raise vehicle.belly_clearance_m"),
)  # fmt: skip
