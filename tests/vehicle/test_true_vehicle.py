"""The true lander may differ from the lander that the onboard computer assumes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import STANDARD_GRAVITY, Lander
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.vehicle import Dynamics, State, evaluate_touchdown
from lunarsim.vehicle.actuators import Actuators
from lunarsim.vehicle.dynamics import build_rig
from lunarsim.vehicle.legs import Legs, settle
from lunarsim.vehicle.true_vehicle import VehicleDeviations
from tests.worlds import SMALL_FLIGHT

JETS = {"vehicle": {"kind": "jet-lander"}, "control": {"kind": "phase-plane"}}
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def at_rest(mass):
    return State(np.zeros(3), np.zeros(3), UPRIGHT, np.zeros(3), mass, 0.0)


def moved(deviations, thrust=3000.0, torque=(0.0, 0.0, 0.0), steps=100, nominal=None):
    """State after `steps` of 10 ms of a plain lander without lag, from rest."""
    nominal = nominal or Lander(thrust_lag=0.0)
    lander = VehicleDeviations(**deviations).true_lander(nominal)
    dynamics = Dynamics(lander, 1.622, 0.01)
    state = at_rest(lander.wet_mass)
    for _ in range(steps):
        state = dynamics.advance(state, thrust, np.array(torque))
    return lander, state


@pytest.fixture(scope="module")
def small():
    return Scenario.from_dict(SMALL_FLIGHT)


@pytest.fixture(scope="module")
def flown(small):
    """One simulation to touchdown by deviations of the true lander (a tuple of items)."""
    done = {}

    def fly(jets=False, **deviations):
        key = (jets, *deviations.items())
        if key not in done:
            tables = JETS if jets else {}
            scenario = small.changed(truth={"vehicle": deviations}, **tables)
            done[key] = Simulation(scenario, 3, "no-divert")
            done[key].run()
        return done[key]

    return fly


def test_no_deviation_is_the_nominal_lander():
    for nominal in (Lander(), JetLander()):
        assert VehicleDeviations().true_lander(nominal) == nominal


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_propellant_follows_the_rocket_equation_with_the_true_specific_impulse(scale):
    lander, state = moved({"specific_impulse_scale": scale})
    burnt = 3000.0 * 1.0 / (311.0 * scale * STANDARD_GRAVITY)
    assert lander.wet_mass - state.mass == pytest.approx(burnt, rel=1e-9)
    exhaust = 311.0 * scale * STANDARD_GRAVITY
    gained = exhaust * np.log(lander.wet_mass / state.mass) - 1.622
    assert state.velocity[2] == pytest.approx(gained, rel=1e-9)


def test_thrust_scale_acts_on_the_limited_command():
    lander, state = moved({"thrust_scale": 0.9}, thrust=1e5)
    assert state.thrust == pytest.approx(0.9 * lander.thrust_max)
    _, idle = moved({"thrust_scale": 0.9}, thrust=1.0)
    assert idle.thrust == pytest.approx(0.9 * lander.thrust_min)
    _, off = moved({"thrust_scale": 0.9}, thrust=0.0)
    assert off.thrust == 0.0


def test_a_misaligned_thrust_axis_pushes_sideways():
    """A rotation about +x turns the thrust from +z to -y, one about +y to +x."""
    angle = np.deg2rad(1.0)
    _, about_x = moved({"thrust_misalignment": (angle, 0.0)})
    _, about_y = moved({"thrust_misalignment": (0.0, angle)})
    _, straight = moved({})
    lift = straight.velocity[2] + 1.622
    assert about_x.velocity[1] == pytest.approx(-lift * np.sin(angle), rel=1e-9)
    assert about_y.velocity[0] == pytest.approx(lift * np.sin(angle), rel=1e-9)
    assert about_x.velocity[2] + 1.622 == pytest.approx(lift * np.cos(angle), rel=1e-9)
    assert np.all(about_x.rate == 0.0)


def test_thrust_beside_the_centre_of_mass_turns_the_lander():
    """A centre of mass at +x makes the thrust along +z turn the lander about +y."""
    lander, state = moved({"com_offset": (0.05, 0.0, 0.0)}, steps=1)
    moment = lander.inertia(lander.wet_mass)[1]
    assert state.rate[1] == pytest.approx(3000.0 * 0.05 / moment * 0.01, rel=1e-4)
    np.testing.assert_allclose(lander.com(1300.0), (0.05, 0.0, 0.0))


def test_an_offset_moves_the_centre_of_mass_with_full_and_with_empty_tanks():
    nominal = JetLander(com_dry=(0.02, 0.0, 0.1), com_full=(0.0, -0.03, 0.2))
    lander = VehicleDeviations(com_offset=(0.01, 0.02, -0.05)).true_lander(nominal)
    np.testing.assert_allclose(lander.com(nominal.dry_mass), (0.03, 0.02, 0.05))
    np.testing.assert_allclose(lander.com(nominal.wet_mass), (0.01, -0.01, 0.15))


def test_a_gimballed_engine_is_misaligned_about_the_angle_of_its_gimbal():
    """The thrust axis is the third column of the rotation by gimbal angle plus misalignment."""
    angles = np.deg2rad([1.5, -0.7])
    true = VehicleDeviations(thrust_misalignment=tuple(angles)).true_lander(JetLander())
    rig = Actuators(true, 0.01).rig(np.zeros(3), 0.0)
    expected = Rotation.from_euler("xy", angles).as_matrix()[:, 2]
    wanted = build_rig(engine=expected, pivot=(0.0, 0.0, -true.engine.pivot_depth))
    np.testing.assert_allclose(rig, wanted, atol=2e-4)
    straight = Actuators(JetLander(), 0.01).rig(np.zeros(3), 0.0)
    assert np.abs(rig - straight).max() > 0.02


def test_inertia_and_control_torque_scale_the_angular_acceleration():
    _, nominal = moved({}, torque=(10.0, 0.0, 0.0), steps=1)
    _, heavy = moved({"inertia_scale": (2.0, 1.0, 1.0)}, torque=(10.0, 0.0, 0.0), steps=1)
    _, weak = moved({"thruster_scale": 0.8}, torque=(1e6, 0.0, 0.0), steps=1)
    _, full = moved({}, torque=(1e6, 0.0, 0.0), steps=1)
    assert heavy.rate[0] == pytest.approx(0.5 * nominal.rate[0], rel=1e-6)
    assert weak.rate[0] == pytest.approx(0.8 * full.rate[0], rel=1e-9)


def test_weak_thrusters_keep_their_propellant_flow():
    lander = VehicleDeviations(thruster_scale=0.8).true_lander(JetLander())
    nominal = JetLander()
    np.testing.assert_allclose(lander.thrusters.torques, 0.8 * nominal.thrusters.torques)
    assert lander.thrusters.propellant_flow == pytest.approx(nominal.thrusters.propellant_flow)


def test_masses_and_lag_are_those_of_the_true_lander():
    lander = VehicleDeviations(
        dry_mass_scale=1.1, propellant_mass_scale=0.9, thrust_lag_scale=3.0
    ).true_lander(Lander())
    assert (lander.dry_mass, lander.propellant_mass) == pytest.approx((1210.0, 360.0))
    assert lander.thrust_lag == pytest.approx(0.3)
    assert lander.inertia_dry == Lander().inertia_dry


@pytest.mark.parametrize("jets", [False, True])
def test_the_computer_does_not_know_a_low_specific_impulse(flown, jets):
    """The lander burns 2 % more on the same path; the computer's mass shows none of it."""
    true, nominal = flown(jets=jets, specific_impulse_scale=0.98), flown(jets=jets)
    for simulation in (true, nominal):
        assert simulation.outcome.safe
        assert simulation.computer.lander == simulation.scenario.vehicle.make()
    wet = nominal.lander.wet_mass
    jet_propellant = [s.plant.actuators.spent if jets else 0.0 for s in (true, nominal)]
    burnt = [
        wet - s.state.mass - used for s, used in zip((true, nominal), jet_propellant, strict=True)
    ]
    assert burnt[0] / burnt[1] == pytest.approx(1.0 / 0.98, rel=2e-3)
    missed = true.computer.mass - true.state.mass
    assert missed == pytest.approx(0.02 * burnt[0], rel=0.05)
    assert abs(nominal.computer.mass - nominal.state.mass) < 0.1 * missed


def test_the_true_lander_starts_the_flight_and_empties_its_own_tanks(small):
    scenario = small.changed(truth={"vehicle": {"dry_mass_scale": 1.02, "thrust_scale": 0.95}})
    simulation = Simulation(scenario, 3, "no-divert")
    nominal = Simulation(small, 3, "no-divert")
    assert simulation.state.mass == pytest.approx(1.02 * 1100.0 + 400.0)
    assert simulation.state.thrust == pytest.approx(0.95 * nominal.state.thrust)
    assert simulation.computer.mass == nominal.computer.mass
    assert simulation.lander.dry_mass == pytest.approx(1122.0)


@pytest.mark.parametrize("jets", [False, True])
def test_other_control_torque_changes_the_flight(flown, jets):
    weak, nominal = flown(jets=jets, thruster_scale=0.8), flown(jets=jets)
    assert weak.outcome.safe
    assert not np.array_equal(weak.state.position, nominal.state.position)


@pytest.mark.parametrize(
    ("deviations", "field"),
    [
        ({"thrust_scale": 0.0}, "truth.vehicle.thrust_scale"),
        ({"thrust_scale": "low"}, "truth.vehicle.thrust_scale"),
        ({"com_offset_m": [0.0, 2.0, 0.0]}, "truth.vehicle.com_offset_m"),
        ({"inertia_scale": [1.0, 3.0, 0.5]}, "truth.vehicle"),
        ({"isp": 0.9}, "truth.vehicle.isp"),
    ],
)
def test_impossible_deviations_are_refused_with_their_key(small, deviations, field):
    with pytest.raises(InputError) as caught:
        small.changed(truth={"vehicle": deviations})
    assert caught.value.field.startswith(field)


def test_a_lander_that_cannot_balance_its_engine_is_refused(small):
    with pytest.raises(InputError, match=r"^truth\.vehicle: must give a possible lander"):
        small.changed(truth={"vehicle": {"com_offset_m": [0.9, 0.0, 0.0]}}, **JETS)


@pytest.mark.parametrize("nominal", [Lander(com_height=0.5), JetLander(com_height=0.5)])
def test_a_centre_of_mass_below_the_pads_is_refused(nominal):
    VehicleDeviations(com_offset=(0.0, 0.0, -0.49)).true_lander(nominal)
    with pytest.raises(InputError, match=r"^truth\.vehicle\.com_offset_m\[2\]: must be above -0.5"):
        VehicleDeviations(com_offset=(0.0, 0.0, -0.5)).true_lander(nominal)


@dataclass(frozen=True)
class LanderWithComputedMass(Lander):
    """Lander of a user whose dry mass is not an argument."""

    dry_mass: float = field(init=False, default=900.0)


def test_a_class_that_cannot_be_copied_flies_without_deviations_only():
    nominal = LanderWithComputedMass()
    assert VehicleDeviations().true_lander(nominal) is nominal
    with pytest.raises(InputError, match=r"^truth\.vehicle: must be omitted for this class"):
        VehicleDeviations(thrust_scale=0.9).true_lander(nominal)


@pytest.mark.parametrize("offset", [-0.8, 0.8])
def test_a_high_centre_of_mass_tips_over_as_in_the_lander_built_so(offset):
    """Horizontal touchdown on level ground at 1.5 m/s: same margin as with that com_height."""
    terrain = SimpleNamespace(elevation=lambda xy: np.zeros(np.shape(xy)[:-1]))
    true = VehicleDeviations(com_offset=(0.0, 0.0, offset)).true_lander(Lander())
    built = replace(Lander(), com_height=Lander().com_height + offset)
    position = np.array([0.0, 0.0, built.com_height])
    state = State(position, np.array([1.5, 0.0, -1.0]), UPRIGHT, np.zeros(3), 1200.0, 0.0)
    margins = [
        evaluate_touchdown(lander, state, terrain, 1.622).touchdown.tip_margin
        for lander in (true, built)
    ]
    assert margins[0] == pytest.approx(margins[1], rel=1e-9)
    rest = [
        settle(Legs(), Dynamics(lander, 1.622), state, terrain).tipped for lander in (true, built)
    ]
    assert rest[0] == rest[1]
