"""The design check names planted misdesigns, and its values agree with closed forms."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from lunarsim.cli import main
from lunarsim.core.touchdown import TouchdownParams, tip_margin
from lunarsim.evaluation.vehicle_check import check_vehicle
from lunarsim.evaluation.vehicle_check.attitude import (
    guidance_delay_margin,
    position_loop_delay_margin,
    rotation_time,
    tilt_torque,
)
from lunarsim.evaluation.vehicle_check.gear import tip_over_speed
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.guidance.paths import APOLLO, E_GUIDANCE
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
# Each misdesign of the scenario `instruments`: changes, violated rows that name it, and other rows
# that may be violated because they follow from it.
MISDESIGNS = {
    "weak thrusters": (
        (*RIDGE, "vehicle.thrusters.force_n=50"), {"divert-rotation-time"}, set(),
    ),
    "very weak thrusters": (
        (*JETS, "vehicle.thrusters.force_n=8"), {"divert-rotation-time", "slew-limit-authority"},
        {"pitch-over-time", "terminal-loop-delay"},
    ),
    "slow slew": (
        ("control.slew_limit_deg_s=4",), {"path-rotation-rate", "divert-rotation-time"},
        {"terminal-loop-delay"},
    ),
    "minimum thrust above the weight": (
        ("vehicle.thrust_min_n=2450",), {"terminal-thrust-min"},
        {"approach-thrust-min", "divert-reach"},
    ),
    "engine too weak for the fixed time": (
        ("vehicle.thrust_max_n=2600", "approach.time_to_go_s=38"), {"approach-thrust-max"},
        {"divert-reach"},
    ),
    "centre of mass off axis": (
        (*JETS, "vehicle.com_full_m=[0.3, 0, 0]"), {"offset-torque-full", "gimbal-angle"},
        {"gimbal-rate", "propellant-thrusters"},
    ),
    "gimbal too small": (
        (*JETS, "vehicle.com_full_m=[0.05, 0, 0]", "vehicle.com_dry_m=[0.05, 0, 0]",
         "vehicle.engine.gimbal_limit_deg=1"), {"gimbal-angle"}, set(),
    ),
    "gimbal too slow": (
        (*JETS, *TANKS, "vehicle.engine.gimbal_rate_deg_s=0.001"), {"gimbal-rate"}, set(),
    ),
    "heavy slosh, weak thrusters": (
        (*JETS, *SLOSH, "vehicle.thrusters.force_n=25"), {"slosh-torque"},
        {"divert-rotation-time", "slew-limit-authority"},
    ),
    "propellant too little for a divert": (
        ("vehicle.propellant_mass_kg=46.5",), {"propellant-divert"}, set(),
    ),
    "propellant too little for the approach": (
        ("vehicle.propellant_mass_kg=30",), {"propellant-nominal", "propellant-divert"}, set(),
    ),
    "little propellant for thrusters": (
        (*JETS, "vehicle.thrusters.propellant_kg=0.2"), {"propellant-thrusters"}, set(),
    ),
    "LiDAR range below the tasking": (
        ("sensors.flash.max_range_m=400",), {"range-flash"}, {"footprint-map"},
    ),
    "narrow field of view": (
        ("sensors.flash.half_fov_tangent=0.01",), {"footprint-map"}, set(),
    ),
    "few pixels": (
        ("sensors.flash.rows=12", "sensors.flash.cols=12"), {"spacing-flash"},
        {"spacing-domain-dem"},
    ),
    "short altimeter": (
        ("sensors.altimeter.max_range_m=300",), {"range-altimeter"}, set(),
    ),
    "pad smaller than a map cell": (
        ("vehicle.pad_diameter_m=0.1",), {"posting-pad-dem"}, set(),
    ),
    "slope limit outside the calibrated domain": (
        ("vehicle.slope_limit_deg=24",), {"slope-domain-dem"}, set(),
    ),
    "noisy LiDAR": (
        ("sensors.flash.noise_ratio=1e-3",), {"noise-domain-dem"}, set(),
    ),
    "low body": (
        ("vehicle.belly_clearance_m=0.1",), {"belly-clearance"}, {"smallest-rock"},
    ),
    "high centre of mass on narrow legs": (
        ("vehicle.leg_radius_m=1", "vehicle.com_height_m=2.5"), {"tip-over-speed"}, set(),
    ),
    "centre of mass too high for the slope": (
        ("vehicle.leg_radius_m=1", "vehicle.com_height_m=5"),
        {"tip-over-static", "tip-over-speed"}, set(),
    ),
    "fast terminal descent": (
        ("approach.vertical_speed_m_s=3.5",), {"touchdown-speed"}, set(),
    ),
    "throttle gap at hover": (
        (*JETS, "vehicle.engine.gap_lower_n=1500", "vehicle.engine.gap_upper_n=3500"),
        {"gap-hover"}, {"gap-approach"},
    ),
    "bandwidth too high for the torque": (
        ("control.frequency_rad_s=12",), {"control-bandwidth"}, set(),
    ),
    "control assumes more torque": (
        (JETS[0], "control.kind=quaternion-feedback", "control.braking_rad_s2=0.5"),
        {"control-braking"}, set(),
    ),
}  # fmt: skip
# True findings about packaged scenarios. Their smallest rocks are cubes of 0.3 m, above the
# clearance of 0.25 m; morpheus has a roughness limit above its clearance; few_sites has little
# propellant on purpose.
FINDINGS = {
    "camera_and_lidar": {"smallest-rock"},
    "shadow_modified": {"smallest-rock"},
    "shadow_nominal": {"smallest-rock"},
    "morpheus": {"belly-clearance"},
    "few_sites": {"propellant-divert"},
}


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


@pytest.mark.parametrize("changes", [(), JETS, (*RIDGE, "vehicle.thrusters.force_n=150")])
def test_the_designs_before_the_changes_are_not_violated(changes):
    assert violated(checked("instruments", changes)) == set()


@pytest.mark.parametrize("name", shipped.names())
def test_packaged_scenarios_have_known_findings_only(name):
    assert violated(checked(name)) == FINDINGS.get(name, set())


def test_rows_state_remedies_with_keys():
    for row in checked("instruments", (*JETS, *SLOSH, *TANKS)).rows:
        assert row.advice.startswith("Otherwise ")
        assert row.status in ("ok", "marginal", "violated")
        assert row.name in {r["name"] for r in checked("instruments", ()).as_dict()["rows"]} or (
            row.subject in ("attitude", "disturbance", "throttle", "propellant")
        )


def test_propellant_is_that_of_the_rocket_equation():
    # A vertical approach: height, speed and acceleration are polynomials of time.
    changes = (
        "start.position_m=[0, 0, 500]", "start.velocity_m_s=[0, 0, -20]",
        "approach.time_to_go_s=40", "approach.reserve_kg=0", "policy.kind=no-divert",
    )  # fmt: skip
    found = checked("instruments", changes)
    t_end, g, isp = 40.0, 1.622, 311.0
    # Apollo law: a = k1 tau + k2 tau^2 with z = 500 to 11.6 m and w = -20 to -2 m/s in 40 s.
    system = np.array([[-(t_end**2) / 2, -(t_end**3) / 3], [t_end**3 / 6, t_end**4 / 12]])
    k = np.linalg.solve(system, [-20.0 + 2.0, 500.0 - 11.6 - 2.0 * t_end])
    # Above, v(0) = v_f - int a and z(0) = z_f - v_f T + double integral of a.
    rate = solve_ivp(
        lambda t, m: [-m[0] * abs(k @ [t_end - t, (t_end - t) ** 2] + g) / (isp * 9.80665)],
        (0.0, t_end), [1500.0], rtol=1e-10, atol=1e-8,
    )  # fmt: skip
    approach = 1500.0 - rate.y[0, -1]
    # Then 10 m at a constant 2 m/s, ended by the first control cycle at or below the terrain.
    descent = rate.y[0, -1] * (1.0 - np.exp(-g * 5.0 / (isp * 9.80665)))
    assert found.named("propellant-nominal").required == pytest.approx(approach + descent, rel=2e-3)


def test_rotation_times_are_those_of_a_bang_bang_manoeuvre():
    assert rotation_time(0.8, 0.2, np.inf) == pytest.approx(2.0 * np.sqrt(0.8 / 0.2))
    # With a limit w: acceleration and braking take w / a each and cover w^2 / a.
    w, a = 0.1, 0.2
    coast = (0.8 - w**2 / a) / w
    assert rotation_time(0.8, a, w) == pytest.approx(2.0 * w / a + coast)
    assert rotation_time(w**2 / a, a, w) == pytest.approx(2.0 * w / a)


def test_time_of_the_pitch_over_is_that_of_its_angle():
    # The approach ends with the given total acceleration, and the thrust adds gravity.
    changes = ("approach.arrival_acceleration_m_s2=[0.8, 0, 0]", "control.slew_limit_deg_s=170")
    row = checked("instruments", changes).named("pitch-over-time")
    angle = np.arctan2(0.8, 1.622)
    mass = 1500.0 - checked("instruments", changes).named("propellant-nominal").required
    inertia = 1100.0 + 0.75 * (mass - 1100.0)
    assert row.required == pytest.approx(2.0 * np.sqrt(angle * inertia / 600.0), rel=0.01)


def test_thrusters_on_the_diagonals_are_weakest_about_a_diagonal():
    lander = JetLander(thrusters=Thrusters(force=50.0, cluster_radius=1.1))
    # Two thrusters at the full radius; the other clusters lie on the axis.
    assert tilt_torque(lander) == pytest.approx(2.0 * 50.0 * 1.1, rel=1e-6)


@pytest.mark.parametrize(("shape", "k_r", "k_v"), [(APOLLO, 12.0, 6.0), (E_GUIDANCE, 6.0, 4.0)])
def test_delay_margin_is_where_the_delayed_loop_oscillates(shape, k_r, k_v):
    # At the margin, s^2 + (k_v s + k_r) exp(-s d) has a root on the imaginary axis.
    d = guidance_delay_margin(shape)
    w = np.linspace(0.5, 20.0, 2_000_000)
    size = np.abs(-(w**2) + (k_v * 1j * w + k_r) * np.exp(-1j * w * d))
    assert size.min() < 1e-3
    assert 0.2 < d < 0.3


def test_position_loop_tolerates_the_stated_delay():
    d = position_loop_delay_margin(0.6, 1.1)
    w = np.linspace(0.1, 5.0, 2_000_000)
    assert np.abs(-(w**2) + (1.32j * w + 0.36) * np.exp(-1j * w * d)).min() < 1e-4


def test_tip_over_values_are_closed_forms():
    found = checked("instruments")
    arm = 2.35 * np.cos(np.pi / 4)
    assert found.named("tip-over-static").available == pytest.approx(
        np.degrees(np.arctan(arm / 1.6)), rel=1e-9
    )


def test_tip_over_speed_is_where_the_margin_of_a_touchdown_is_zero():
    lander, slope = Lander(leg_radius=1.4, com_height=2.0), np.deg2rad(8.0)
    speed = tip_over_speed(lander, 1200.0, slope, 1.622)
    inertia = np.array([lander.inertia_dry, lander.inertia_full])
    params = TouchdownParams(
        np.zeros(7), lander.com_height, 1.622, lander.dry_mass, lander.wet_mass, inertia
    )
    legs = lander.pads + [0.0, 0.0, lander.com_height]
    state = np.zeros(15)
    state[9], state[13] = 1.0, 1200.0
    state[3] = speed  # perpendicular to an edge
    assert tip_margin(state, legs, slope, params) == pytest.approx(0.0, abs=1e-9)


def test_minimum_thrust_is_compared_with_the_weight_at_touchdown():
    found = checked("instruments")
    mass = 1500.0 - found.named("propellant-nominal").required + 15.0
    terminal = mass * (1.0 - np.exp(-1.622 * 5.1 / (311.0 * 9.80665)))
    row = found.named("terminal-thrust-min")
    assert row.required == pytest.approx((mass - terminal) * (1.622 - 0.15), rel=1e-3)


def test_a_lander_that_no_path_suits_has_a_row():
    found = checked("instruments", ("approach.max_tilt_deg=3",))
    assert "approach-path" in violated(found)


def test_custom_and_ideal_parts_are_checked_as_far_as_possible():
    found = checked("instruments", ("guidance.kind=optimal", "terminal_descent.kind=gravity-turn"))
    assert any("guidance 'optimal'" in note for note in found.not_checked)
    assert violated(checked("shadow_nominal", ("control.kind=ideal",))) <= {
        "smallest-rock", "divert-rotation-time",
    }  # fmt: skip


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
    assert rows["violated"] == ["posting-pad-dem"]
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
    assert not check_vehicle(scenario).is_violated
