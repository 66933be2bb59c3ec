"""The design check names planted misdesigns, and its values agree with closed forms."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.evaluation.vehicle_check import check_vehicle
from lunarsim.evaluation.vehicle_check.attitude import (
    guidance_delay,
    offset_torques,
    slosh_torque,
    trim_angles,
)
from lunarsim.evaluation.vehicle_check.descent_checks import tip_over_speed
from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.frames import attitude_from_thrust, quat_rotate
from lunarsim.models.jet_lander import DescentEngine, JetLander
from lunarsim.models.lander import Lander
from lunarsim.models.slosh import Slosh
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.guidance.rotation import RotationLimits, delay_margin
from lunarsim.scenario import Scenario, shipped
from lunarsim.scenario.changes import with_changes

JETS = ("vehicle.kind=jet-lander", "control.kind=phase-plane")
# A lander of 1.9 t on a steep approach from 2 km, with thrusters near its axis.
RIDGE = (
    *JETS, "vehicle.dry_mass_kg=1560", "vehicle.propellant_mass_kg=340",
    "vehicle.thrust_min_n=2500", "vehicle.thrust_max_n=10000", "vehicle.thrust_lag_s=0.15",
    "vehicle.specific_impulse_s=320", "vehicle.leg_radius_m=1.6", "vehicle.pad_diameter_m=0.35",
    "vehicle.com_height_m=1.3", "vehicle.belly_clearance_m=0.35", "vehicle.slope_limit_deg=12",
    "vehicle.roughness_limit_m=0.3", "vehicle.thrusters.cluster_radius_m=1.1",
    "start.position_m=[-2800, 0, 2000]", "start.velocity_m_s=[65, 0, -42]",
    "approach.throttle_margin=0", "approach.max_tilt_deg=50", "decisions.first_altitude_m=600",
    "sensors.flash.rows=128", "sensors.flash.cols=128",
    "tasking.flash.altitudes_m=[700, 500, 350, 200, 120]",
)  # fmt: skip
SLOSH = (
    "vehicle.slosh.tanks_m=[[0, 0, -1.6]]", "vehicle.slosh.radius_m=1",
    "vehicle.slosh.height_m=0.3",
)  # fmt: skip
TANKS = ("vehicle.com_full_m=[0.05, 0, 0]", "vehicle.com_dry_m=[-0.05, 0, 0]")
BESIDE = ("vehicle.com_full_m=[0.1, 0, 0]", "vehicle.com_dry_m=[0.1, 0, 0]")
TURNS = {"approach-rotation-time", "divert-rotation-time", "terminal-loop-delay"}
# Each misdesign of the scenario `instruments`: changes, violated rows that name it, and other rows
# that may be violated because they follow from it. Those marked "flown" did not land
# safely in each of two or three flights; rotations were not limited in these flights yet.
MISDESIGNS = {
    "weak thrusters": ((*RIDGE, "vehicle.thrusters.force_n=50"), {"divert-rotation-time"}, TURNS),
    "weak thrusters without diverts (flown)": (
        (*JETS, "vehicle.thrusters.force_n=15", "policy.kind=no-divert"),
        {"approach-rotation-time"}, set(),
    ),
    "short lever arm (flown)": (
        (*JETS, "vehicle.thrusters.cluster_radius_m=0.15"), TURNS - {"terminal-loop-delay"}, set(),
    ),
    "large moments of inertia (flown)": (
        ("vehicle.inertia_dry_kg_m2=[20000, 20000, 20000]",), {*TURNS, "control-braking"}, set(),
    ),
    "slow slew (flown)": (
        ("control.slew_limit_deg_s=4",), {"divert-rotation-time", "terminal-loop-delay"}, set(),
    ),
    "slow attitude loop": (("control.frequency_rad_s=0.5",), {"touchdown-tilt"}, set()),
    "bandwidth too high for the torque": (
        ("control.frequency_rad_s=12",), {"control-braking"}, set(),
    ),
    "control assumes more torque": (
        (JETS[0], "control.kind=quaternion-feedback", "control.braking_rad_s2=0.5"),
        {"control-braking"}, set(),
    ),
    "limit of the rate below what attitude control leaves": (
        ("vehicle.rate_limit_deg_s=1",), {"touchdown-rate"}, set(),
    ),
    "wide dead band (flown)": ((*JETS, "control.dead_band_deg=5"), {"touchdown-tilt"}, set()),
    "slow control (flown)": ((*JETS, "control.period_s=1"), {"control-period"}, set()),
    "strong thrusters (flown)": (
        (*JETS, "vehicle.thrusters.force_n=3000"), {"control-period"}, set(),
    ),
    "minimum thrust above the weight": (
        ("vehicle.thrust_min_n=2450",), {"terminal-thrust-min"},
        {"approach-thrust-min", "divert-reach"},
    ),
    "maximum thrust below the weight": (
        ("vehicle.thrust_max_n=2300",), {"terminal-thrust-max"},
        {"approach-thrust-max", "divert-reach"},
    ),
    "engine too weak for the fixed time": (
        ("vehicle.thrust_max_n=2600", "approach.time_to_go_s=38"), {"approach-thrust-max"},
        {"divert-reach"},
    ),
    "slow engine (flown)": (("vehicle.thrust_lag_s=6",), {"engine-lag"}, set()),
    "coarse throttle (flown)": (
        (*JETS, "vehicle.engine.dead_band_n=2500"), {"touchdown-speed"}, set(),
    ),
    "throttle gap at hover (flown)": (
        (*JETS, "vehicle.engine.gap_lower_n=2000", "vehicle.engine.gap_upper_n=2800"),
        {"throttle-gap"}, set(),
    ),
    "throttle gap on the approach (flown)": (
        (*JETS, "vehicle.engine.gap_lower_n=2500", "vehicle.engine.gap_upper_n=5900"),
        {"throttle-gap"}, set(),
    ),
    "centre of mass off axis": (
        (*JETS, "vehicle.com_full_m=[0.3, 0, 0]"), {"offset-torque"}, {"touchdown-tilt"},
    ),
    "offset without gimbal": (
        (*JETS, "vehicle.com_full_m=[0, 0.1, 0]", "vehicle.engine.gimbal_limit_deg=0",
         "vehicle.thrust_min_n=100"), {"offset-torque"}, set(),
    ),
    "offset with empty tanks": (
        (*JETS, "vehicle.com_dry_m=[0.3, 0, 0]"), {"offset-torque"}, {"touchdown-tilt"},
    ),
    "slow gimbal": (
        (*JETS, *BESIDE, "vehicle.engine.gimbal_rate_deg_s=0.05"), {"offset-torque"},
        {"touchdown-tilt"},
    ),
    "gimbal without a rate (flown)": (
        (*JETS, *BESIDE, "vehicle.engine.gimbal_rate_deg_s=0"), {"offset-torque"}, set(),
    ),
    "tilt of a trimmed gimbal (flown)": (
        (*JETS, *BESIDE, "vehicle.tilt_limit_deg=5"), {"touchdown-tilt"}, set(),
    ),
    "heavy slosh, weak thrusters": (
        (*JETS, *SLOSH, "vehicle.thrusters.force_n=25"), {"slosh-torque"}, TURNS,
    ),
    "propellant too little for a divert": (
        ("vehicle.propellant_mass_kg=46.5",), {"propellant-divert"}, set(),
    ),
    "propellant too little for the approach": (
        ("vehicle.propellant_mass_kg=30",), {"propellant-nominal", "propellant-divert"},
        {"hold-start"},
    ),
    "thrusters with little propellant": (
        (*JETS, "vehicle.thrusters.propellant_kg=0.05"), {"thruster-propellant"}, set(),
    ),
    "small offset torque for the complete descent": (
        (*JETS, "vehicle.com_full_m=[0.02, 0, 0]", "vehicle.com_dry_m=[0.02, 0, 0]",
         "vehicle.engine.gimbal_limit_deg=0", "vehicle.thrusters.propellant_kg=1"),
        {"thruster-propellant"}, set(),
    ),
    "hold that ends with empty tanks": (
        ("terminal_descent.kind=vertical", "terminal_descent.hold_propellant_kg=0"), {"hold-end"},
        set(),
    ),
    "hold that never begins": (
        ("terminal_descent.kind=vertical", "terminal_descent.hold_propellant_kg=395"),
        {"hold-start"}, set(),
    ),
    "reserve above the propellant": (
        ("approach.reserve_kg=500",), {"propellant-nominal", "propellant-divert"}, set(),
    ),
    "start out of reach": (("start.position_m=[-8000, 0, 600]",), {"approach-path"}, set()),
    "start below the glideslope": (("start.position_m=[-800, 0, 50]",), {"approach-path"}, set()),
    "long time-to-go": (("approach.time_to_go_s=300",), {"approach-path"}, set()),
    "takeover before the site (flown)": (
        ("approach.takeover_altitude_m=60",), {"terminal-tilt"}, set(),
    ),
    "LiDAR range below the tasking": (
        ("sensors.flash.max_range_m=400",), {"range-flash"}, {"footprint-map"},
    ),
    "dim LiDAR": (("sensors.flash.photons=0.1",), {"range-flash"}, set()),
    "LiDAR that needs steep views": (
        ("sensors.flash.max_incidence_deg=10",), {"incidence-flash"}, set(),
    ),
    "fixed LiDAR": (("sensors.flash.gimbal_limit_deg=1",), {"pointing-flash"}, set()),
    "narrow field of view": (
        ("sensors.flash.half_fov_tangent=0.01",), {"footprint-map"}, set(),
    ),
    "large map": (("mappers.dem.size_m=400",), {"footprint-map"}, set()),
    "scans below the approach": (
        ("tasking.flash.altitudes_m=[8]",), {"first-map-altitude"}, {"divert-reach"},
    ),
    "scan after the last decision": (
        ("tasking.flash.altitudes_m=[45]",), {"first-map-altitude"}, {"footprint-map"},
    ),
    "few pixels": (("sensors.flash.rows=5", "sensors.flash.cols=5"), {"spacing-domain-dem"}, set()),
    "noisy LiDAR": (("sensors.flash.noise_ratio=1e-3",), {"noise-domain-dem"}, set()),
    "short altimeter": (("sensors.altimeter.max_range_m=300",), {"range-altimeter"}, set()),
    "short velocimeter": (("sensors.velocimeter.max_range_m=450",), {"range-velocimeter"}, set()),
    "pad smaller than a map cell": (("vehicle.pad_diameter_m=0.1",), {"posting-dem"}, set()),
    "slope limit outside the calibrated domain": (
        ("vehicle.slope_limit_deg=24",), {"slope-domain-dem"}, set(),
    ),
    "low body": (("vehicle.belly_clearance_m=0.1",), {"belly-clearance"}, set()),
    "high centre of mass on narrow legs": (
        ("vehicle.leg_radius_m=1", "vehicle.com_height_m=2.5"), {"tip-over-speed"}, set(),
    ),
    "long pulses of the engine": (
        (*JETS, "vehicle.engine.continuous_min_n=6000", "vehicle.engine.pulse_period_s=3"),
        {"touchdown-speed"}, set(),
    ),
    "tolerated drift above the limit of the gear": (
        ("vehicle.horizontal_speed_limit_m_s=0.2",), {"touchdown-drift"}, set(),
    ),
    "fast terminal descent": (
        ("approach.vertical_speed_m_s=3.5",), {"touchdown-speed"}, set(),
    ),
}  # fmt: skip
# True findings about packaged scenarios: morpheus has a roughness limit above its clearance, and
# hovers with 7 kg/s, so that a hold down to 10 kg ends with empty tanks;
# few_sites has little propellant on purpose.
FINDINGS = {"morpheus": {"belly-clearance", "hold-end"}, "few_sites": {"propellant-divert"}}


@cache
def checked(name, changes=()):
    return check_vehicle(with_changes(Scenario.load(shipped.path_of(name)), changes))


def violated(found):
    return {row.name for row in found.with_status("violated")}


@pytest.mark.parametrize("case", MISDESIGNS)
def test_a_planted_misdesign_is_named(case):
    changes, named, others = MISDESIGNS[case]
    found = violated(checked("instruments", changes))
    assert named <= found
    assert found <= named | others


@pytest.mark.parametrize(
    "changes",
    [
        (), JETS, (*RIDGE, "vehicle.thrusters.force_n=150"), ("vehicle.thrust_lag_s=1",),
        (*JETS, "control.dead_band_deg=3"), (*JETS, "vehicle.engine.throttle_step_n=2000"),
    ],
)  # fmt: skip
def test_designs_that_land_are_not_violated(changes):
    assert violated(checked("instruments", changes)) == set()


@pytest.mark.parametrize("name", shipped.names())
def test_packaged_scenarios_have_known_findings_only(name):
    assert violated(checked(name)) == FINDINGS.get(name, set())


def test_values_of_the_approach_are_those_of_its_polynomial():
    # A vertical approach: height, speed and acceleration are polynomials of time.
    changes = (
        "start.position_m=[0, 0, 500]", "start.velocity_m_s=[0, 0, -20]",
        "approach.time_to_go_s=40", "approach.reserve_kg=0", "policy.kind=no-divert",
    )  # fmt: skip
    found = checked("instruments", changes)
    t_end, g, v_e = 40.0, 1.622, 311.0 * 9.80665
    # Apollo law: a = k1 tau + k2 tau^2 with z = 500 to 11.6 m and w = -20 to -2 m/s in 40 s.
    system = np.array([[-(t_end**2) / 2, -(t_end**3) / 3], [t_end**3 / 6, t_end**4 / 12]])
    k = np.linalg.solve(system, [-20.0 + 2.0, 500.0 - 11.6 - 2.0 * t_end])
    up = lambda t: k @ [t_end - t, (t_end - t) ** 2] + g  # noqa: E731
    rate = solve_ivp(
        lambda t, m: [-m[0] * abs(up(t)) / v_e], (0.0, t_end), [1500.0], rtol=1e-10, atol=1e-8,
        t_eval=np.linspace(0.0, t_end, 2001),
    )  # fmt: skip
    thrust, end = rate.y[0] * [up(t) for t in rate.t], rate.y[0, -1]
    # Then 10 m at a constant 2 m/s.
    touchdown = end * np.exp(-g * 5.0 / v_e)
    expected = {
        "propellant-nominal": 1500.0 - touchdown, "approach-thrust-max": thrust.max(),
        "approach-thrust-min": thrust.min(), "terminal-thrust-max": end * g,
        "terminal-thrust-min": touchdown * (g - 0.15),
    }  # fmt: skip
    for name, value in expected.items():
        assert found.named(name).required == pytest.approx(value, rel=1e-4)


def test_values_of_scans_are_those_of_the_geometry():
    # A vertical approach: the first scan is due at 350 m and the last at 160 m.
    changes = ("start.position_m=[0, 0, 500]", "start.velocity_m_s=[0, 0, -20]")
    found = checked("instruments", changes)
    top = found.named("range-flash").required
    assert top == pytest.approx(351.6, rel=0.01)
    assert found.named("footprint-map").available == pytest.approx(0.1 * top)
    assert found.named("footprint-map").required == 25.0
    assert found.named("pointing-flash").required == pytest.approx(0.0, abs=1e-9)
    # 0.1 of the range is half the side of 256 pixels; noise of 3 sigma = 5 cm at 500 m.
    low = 161.6
    expected = {"spacing-domain-dem": 0.2 / 256 * low / 2.35, "noise-domain-dem": low / 3e4 / 0.25}
    for name, value in expected.items():
        assert found.named(name).available == pytest.approx(value, rel=0.02)
    dim = checked("instruments", (*changes, "sensors.flash.photons=1"))
    assert dim.named("range-flash").available == pytest.approx(500.0 / np.sqrt(np.log(2.0)))


def test_three_beams_of_a_velocimeter_have_returns_within_its_range():
    scenario = Scenario.load(shipped.path_of("instruments"))
    mission = Mission(scenario)
    k = mission.path.index_at(400.0)  # first decision, above the first scan
    attitude = attitude_from_thrust(mission.path.direction[k], scenario.start.make().heading)
    beams = quat_rotate(attitude, np.array(mission.sensors["velocimeter"].calibration().directions))
    ranges = mission.path.position[k, 2] / -beams[:, 2]
    reach = checked("instruments").named("range-velocimeter").required
    assert (ranges <= reach * (1.0 + 1e-9)).sum() == 3


@pytest.mark.parametrize(("k_r", "k_v"), [(12.0, 6.0), (6.0, 4.0), (0.36, 1.32)])
def test_delay_margin_is_where_the_delayed_loop_oscillates(k_r, k_v):
    # At the margin, s^2 + (k_v s + k_r) exp(-s d) has a root on the imaginary axis.
    d = delay_margin(k_r, k_v)
    w = np.linspace(0.1, 20.0, 1_000_000)
    assert np.abs(-(w**2) + (k_v * 1j * w + k_r) * np.exp(-1j * w * d)).min() < 1e-3


@pytest.mark.parametrize(("kind", "k_r", "k_v"), [("apollo", 12.0, 6.0), ("e-guidance", 6.0, 4.0)])
def test_rotations_may_take_twice_the_delay_that_guidance_tolerates(kind, k_r, k_v):
    base = Scenario.load(shipped.path_of("instruments"))
    mission = Mission(with_changes(base, (f"guidance.kind={kind}",)))
    # The response time of the control is 2 z / f.
    assert guidance_delay(mission, 10.0) == pytest.approx(10.0 * delay_margin(k_r, k_v) + 0.45)
    row = checked("instruments", (f"guidance.kind={kind}",)).named("divert-rotation-time")
    allowed = [4.0 * guidance_delay(mission, d.time_to_go) for d in mission.reachable]
    assert np.abs(np.array(allowed) - row.available).min() < 1e-9
    without = checked("instruments", ("policy.kind=no-divert",))
    assert "divert-rotation-time" not in {r.name for r in without.rows}


def test_braking_is_that_of_the_linear_loop():
    row = checked("instruments").named("control-braking")
    # 600 N m on 1400 kg m^2; the rate f e / (2 z) falls from w = 15 deg/s to 0 in the angle e.
    assert row.required == pytest.approx(np.rad2deg(600.0 / 1400.0))
    error = 15.0 * 2.0 * 0.9 / 4.0
    assert row.available == pytest.approx(15.0**2 / (2.0 * error))


def test_offset_torque_is_what_the_gimbal_leaves():
    engine = DescentEngine(pivot_depth=0.8, gimbal_limit=np.deg2rad(3.0))
    lander = JetLander(com_dry=(0.1, 0.02, 0.1), engine=engine, thrust_min=100.0)
    thrust, d = 2000.0, np.deg2rad(3.0)
    push, arm = thrust * np.array([np.sin(d), 0.0, np.cos(d)]), np.array([-0.1, -0.02, -0.9])
    about_y = np.cross(arm, [push[0], 0.0, push[2]])[1]
    # About body x, the gimbal removes all.
    expected = [0.0, abs(about_y)]
    assert offset_torques(lander, 1100.0, thrust) == pytest.approx(expected, abs=1e-9)


def test_a_gimbal_trims_at_its_rate():
    """Half a second at 2 deg/s, then its limit of 3 deg; about body x there is nothing to trim."""
    engine = DescentEngine(
        pivot_depth=0.8, gimbal_limit=np.deg2rad(3.0), gimbal_rate=np.deg2rad(2.0)
    )
    lander = JetLander(com_dry=(0.1, 0.0, 0.1), engine=engine, thrust_min=100.0)
    angles = trim_angles(lander, 1100.0, np.array([0.0, 0.5, 60.0]))
    assert np.rad2deg(angles) == pytest.approx(np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 3.0]]))
    torques = offset_torques(lander, 1100.0, np.array([2000.0, 3000.0]), np.array([0.0, 0.5]))
    d = np.deg2rad(1.0)
    late = 3000.0 * (0.1 * np.cos(d) - 0.9 * np.sin(d))
    assert torques == pytest.approx(np.array([[0.0, 200.0], [0.0, late]]))


def test_a_trimmed_gimbal_tilts_the_hovering_lander():
    row = checked("instruments", (*JETS, "vehicle.com_dry_m=[0.03, 0.04, 0]",
                                  "vehicle.com_full_m=[0.03, 0.04, 0]"))  # fmt: skip
    dead_band = checked("instruments", JETS).named("touchdown-tilt").available
    trim = np.rad2deg(np.hypot(np.arctan2(0.04, 0.8), np.arctan2(0.03, 0.8)))
    assert row.named("touchdown-tilt").available == pytest.approx(dead_band + trim)


def test_slosh_torque_is_that_of_a_pendulum():
    slosh = Slosh(tanks=((0.0, 0.0, -0.9),), radius=0.5, height=0.5)
    lander = JetLander(slosh=slosh)
    masses, lengths, bobs = slosh.pendulums(0.5, lander.propellant_mass)
    hinge = bobs[0, 2] + lengths[0]
    # Fast rotation: the pendulum stays and the angle of the rotation is its swing.
    expected = masses[0] * 2.0 * abs(hinge) * np.sin(0.3)
    assert slosh_torque(lander, 0.5, 2.0, 0.3, 0.0) == pytest.approx(expected)
    # Slow rotation: swing of an undamped oscillator after a ramp, at most angle * 2 / (w t).
    w = np.sqrt(2.0 / lengths[0])
    swing = 0.3 * 2.0 / (w * 20.0)
    expected = masses[0] * 2.0 * abs(hinge) * np.sin(swing)
    assert slosh_torque(lander, 0.5, 2.0, 0.3, 20.0) == pytest.approx(expected)


def test_tip_over_speed_lifts_the_centre_of_mass_over_an_edge():
    lander, slope, mass, g = Lander(leg_radius=1.4, com_height=2.0), np.deg2rad(8.0), 1200.0, 1.622
    arm = 1.4 * np.cos(np.pi / 4)
    length, tip = np.hypot(arm, 2.0), np.arctan(arm / 2.0) - slope
    about_edge = lander.inertia(mass)[0] + mass * length**2
    energy = mass * g * length * (1.0 - np.cos(tip))
    expected = np.sqrt(2.0 * energy * about_edge) / (mass * 2.0)
    assert tip_over_speed(lander, mass, slope, g) == pytest.approx(expected, rel=1e-9)
    assert tip_over_speed(lander, mass, np.deg2rad(27.0), g) == 0.0


def test_errors_at_touchdown_follow_from_control_and_throttle():
    row = checked("instruments", (*JETS, "vehicle.engine.throttle_step_n=1000",
                                  "vehicle.engine.dead_band_n=300"))  # fmt: skip
    mass = 1500.0 - row.named("propellant-nominal").required
    expected = 2.0 + 800.0 / (1.5 * mass)
    assert row.named("touchdown-speed").available == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("frequency", [0.3, 0.8, 1.5, 4.0])
@pytest.mark.parametrize("upright", [0.3, 2.0])
def test_tilt_and_rate_at_touchdown_are_those_of_a_lag(frequency, upright):
    """Integrate the lag: 12 deg above 8 m to 2 deg at touchdown, at 2 m/s, then to zero."""
    checks = checked(
        "instruments",
        (f"control.frequency_rad_s={frequency}", 'terminal_descent.kind="vertical"',
         f"terminal_descent.upright_time_s={upright}"),
    )  # fmt: skip
    lag, step, tilt, rate = 1.8 / frequency, 1e-3, 12.0, 0.0
    for left in np.arange(15.0 * lag, 0.0, -step):
        command = min(2.0 + 10.0 * 2.0 * left / 8.0, 12.0) * min(left / upright, 1.0)
        rate = (tilt - command) / lag
        tilt -= step * rate
    assert checks.named("touchdown-tilt").available == pytest.approx(tilt, rel=0.01)
    assert checks.named("touchdown-rate").available == pytest.approx(rate, rel=0.01)


def test_a_phase_plane_leaves_its_dead_band_at_touchdown():
    row = checked("instruments", (*JETS, "control.dead_band_deg=1.5")).named("touchdown-tilt")
    assert row.available == pytest.approx(2.0 + 1.5)


def test_speed_error_of_pulses_is_half_of_their_ripple():
    found = checked("instruments", (*JETS, "vehicle.engine.continuous_min_n=6000",
                                    "vehicle.engine.pulse_period_s=0.5"))  # fmt: skip
    mass = 1500.0 - found.named("propellant-nominal").required
    on = 0.5 * mass * 1.622 / 6000.0
    # In free fall between two pulses, the speed changes by g times the time without thrust.
    expected = 2.0 + 0.5 * 1.622 * (0.5 - on)
    assert found.named("touchdown-speed").available == pytest.approx(expected, rel=0.01)


def test_propellant_of_thrusters_is_that_of_three_rotations_and_the_offset_torque():
    changes = (*JETS, "policy.kind=no-divert", "vehicle.engine.gimbal_limit_deg=0")
    offset = ("vehicle.com_full_m=[0.02, 0, 0]", "vehicle.com_dry_m=[0.02, 0, 0]")
    base = checked("instruments", changes)
    mission = Mission(with_changes(Scenario.load(shipped.path_of("instruments")), changes))
    # Two clusters push along z at 1.6 m from the axis that they turn about, seen along a diagonal.
    per_impulse = 1.0 / (1.6 / np.sqrt(2.0)) / (290.0 * 9.80665)
    limits = RotationLimits.of(mission.lander, mission.software.control)
    peak = min(limits.max_rate, np.sqrt(limits.acceleration(1500.0) * mission.largest_rotation))
    rotations = 6.0 * 1400.0 * peak * per_impulse
    assert base.named("thruster-propellant").required == pytest.approx(rotations, rel=1e-6)
    turned = checked("instruments", (*changes, *offset)).named("thruster-propellant")
    time = mission.path.time[-1] + mission.terminal_time
    torque = 0.02 * mission.terminal_thrust * time * per_impulse
    assert turned.required == pytest.approx(rotations + torque, rel=1e-6)


def test_propellant_of_a_hold_suffices_for_the_descent_from_it():
    # Without a reserve, the nominal propellant is that until touchdown.
    found = checked("instruments", ("approach.reserve_kg=0",))
    mass = 1500.0 - found.named("propellant-nominal").required
    # From 3 m at a quarter of 2 m/s.
    needed = mass * (1.0 - np.exp(-1.622 * 3.0 / 0.5 / (311.0 * 9.80665)))
    assert found.named("hold-end").required == pytest.approx(needed, rel=0.01)
    assert found.named("hold-end").available == found.named("hold-start").available == 10.0
    assert found.named("hold-start").required == pytest.approx(mass - 1100.0, rel=0.01)
    for kind in ("gravity-turn", "velocity-null"):
        other = checked("instruments", (f"terminal_descent.kind={kind}",))
        assert not {"hold-end", "hold-start", "touchdown-drift"} & {row.name for row in other.rows}


def test_overshoot_in_a_control_period_is_that_of_the_law():
    thrusters, changes = Thrusters(force=3000.0), (*JETS, "vehicle.thrusters.force_n=3000")
    row = checked("instruments", changes).named("control-period")
    control = with_changes(Scenario.load(shipped.path_of("instruments")), JETS).control.make()
    authority = np.full(3, ThrusterAllocation(thrusters).authority[0] / 1100.0)
    worst = 0.0
    for beyond in np.linspace(1e-4, 0.05, 2000):
        error = np.full(3, -1.25 * control.dead_band - beyond)
        change = control.rate_change(error, np.zeros(3), authority, np.full(3, 1e-9))
        worst = max(worst, abs(change[0]) * control.period - beyond)
    assert row.available == pytest.approx(np.rad2deg(worst), rel=0.01)
    assert row.required == pytest.approx(2.0 * np.rad2deg(control.dead_band))


def test_horizontal_motion_after_a_takeover_needs_a_tilt():
    changes = (
        "start.position_m=[-60, 0, 200]", "start.velocity_m_s=[0, 0, -20]",
        "approach.takeover_altitude_m=150", "policy.kind=no-divert",
    )  # fmt: skip
    mission = Mission(with_changes(Scenario.load(shipped.path_of("instruments")), changes))
    at, v, t = mission.path.position[-1], mission.path.velocity[-1], mission.terminal_time
    # A linear acceleration c0 + c1 t that brings both to 0.
    c0, c1 = np.linalg.solve([[t, t**2 / 2], [t**2 / 2, t**3 / 6]], [-v[0], -at[0] - v[0] * t])
    assert at[0] + v[0] * t + c0 * t**2 / 2 + c1 * t**3 / 6 == pytest.approx(0.0, abs=1e-9)
    lift = 1.622 + (v[2] ** 2 - 4.0) / (2.0 * (at[2] - 1.6))
    row = checked("instruments", changes).named("terminal-tilt")
    assert row.required == pytest.approx(np.rad2deg(np.arctan(abs(c0) / lift)), rel=1e-6)


def test_a_start_that_is_too_low_is_refused():
    changes = ("approach.takeover_altitude_m=900",)
    with pytest.raises(InputError, match=r"must be above 901\.6 m"):
        checked("instruments", changes)


def test_only_gear_and_maps_are_checked_without_a_path():
    found = checked("instruments", ("start.velocity_m_s=[-2000, 0, 500]",))
    assert {row.subject for row in found.rows} == {"path", "gear", "maps"}
    assert any("no path" in note for note in found.not_checked)


def test_custom_and_ideal_parts_are_checked_as_far_as_possible():
    found = checked("instruments", ("guidance.kind=optimal", "terminal_descent.kind=gravity-turn"))
    assert any("guidance 'optimal'" in note for note in found.not_checked)
    ideal = violated(checked("shadow_nominal", ("control.kind=ideal",)))
    assert ideal <= {"divert-rotation-time"}
    none = checked("instruments", ("mappers={}", "tasking={}", "policy.kind=no-divert"))
    assert violated(none) == set()


def test_command_prints_findings_and_writes_all_rows(tmp_path):
    file = tmp_path / "rows.json"
    done = CliRunner().invoke(main, [
        "vehicle", "check", "instruments", "--set", "vehicle.pad_diameter_m=0.1",
        "--json", str(file),
    ])  # fmt: skip
    assert done.exit_code == 1, done.output
    assert "violated: pad diameter against the posting of map 'dem' must be at least" in done.output
    rows = json.loads(file.read_text())
    assert rows["format"] == "lunarsim vehicle check 1"
    assert rows["violated"] == ["posting-dem"]
    assert len(rows["rows"]) == len(checked("instruments").rows)
    assert [p.name for p in tmp_path.iterdir()] == ["rows.json"]


def test_command_succeeds_without_violations():
    done = CliRunner().invoke(main, ["vehicle", "check", "instruments"])
    assert done.exit_code == 0, done.output
    assert "0 violated" in done.output


def test_scenario_check_prints_the_findings_after_its_own_text():
    done = CliRunner().invoke(main, ["scenario", "check", "few_sites"])
    assert done.exit_code == 0
    assert "vehicle check: violated: propellant" in done.stderr
    assert done.stderr.index("estimate:") < done.stderr.index("vehicle check:")
    assert "vehicle check" not in done.stdout


def test_an_approach_with_a_jerk_and_no_time_is_planned():
    scenario = Scenario.from_dict(
        {
            "name": "jerk",
            "approach": {"jerk_m_s3": 0.05, "arrival_velocity_m_s": [3.0, 0.0]},
            "start": {"position_m": [-600.0, 0.0, 400.0], "velocity_m_s": [28.0, 0.0, -12.0]},
        }
    )
    # The vertical descent cannot stop 3 m/s over the site: two such flights landed 16 m away.
    assert violated(check_vehicle(scenario)) == {"terminal-tilt"}
