"""Valves, gimbal and throttle: momentum, energy and propellant of what they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.models.jet_lander import DescentEngine, JetLander
from lunarsim.models.lander import STANDARD_GRAVITY, Lander
from lunarsim.models.thrusters import Thrusters
from lunarsim.vehicle import Dynamics, State
from lunarsim.vehicle.actuators import Actuators
from lunarsim.vehicle.faults import Faults

STEP, ALMOST_NOTHING = 0.01, 1e-12
LANDER = JetLander(thrust_lag=0.0)
NO_SWING = np.zeros(2)


def start(lander: Lander, **changes) -> State:
    state = State(
        np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), lander.wet_mass
    )
    return replace(state, **changes)


def orders(lander: JetLander, **seconds: float) -> np.ndarray:
    on = np.zeros(lander.thrusters.count)
    for name, time in seconds.items():
        on[int(name[1:])] = time
    return on


def run(actuators, steps, state, throttle=0.0, gravity=ALMOST_NOTHING, step=STEP):
    dynamics = Dynamics(actuators.lander, gravity, step)
    states = [state]
    for _ in range(steps):
        states.append(actuators.advance(dynamics, states[-1], throttle))
    return states


def test_a_pulse_gives_its_impulse_however_it_falls_on_the_steps():
    actuators = Actuators(LANDER, STEP)
    on = 0.0537  # five steps and a part of one
    actuators.command(orders(LANDER, j0=on, j4=on), NO_SWING)  # both push up, on either side
    end = run(actuators, 10, start(LANDER))[-1]
    torque = LANDER.thrusters.torques[[0, 4]].sum(axis=0)
    assert np.linalg.norm(torque) > 100.0
    inertia = np.array(LANDER.inertia_full)
    assert inertia * end.rate == pytest.approx(torque * on, rel=1e-3)
    momentum = quat_to_matrix(end.attitude) @ (inertia * end.rate)
    assert momentum == pytest.approx(torque * on, rel=1e-3)
    # Velocity and propellant by the rocket equation.
    speed = 290.0 * STANDARD_GRAVITY * np.log(LANDER.wet_mass / end.mass)
    assert end.velocity[2] == pytest.approx(speed, rel=1e-3)
    burnt = 2.0 * 60.0 * on / (290.0 * STANDARD_GRAVITY)
    assert actuators.spent == pytest.approx(burnt, rel=1e-12)
    assert LANDER.wet_mass - end.mass == pytest.approx(burnt, rel=1e-9)
    assert actuators.on_time[[0, 4]] == pytest.approx(on)
    assert actuators.firings.tolist() == [1, 0, 0, 0, 1] + [0] * 11


def test_the_work_of_thrusters_is_the_energy_of_the_turn():
    lander = replace(
        LANDER, inertia_full=(900.0, 1400.0, 1900.0), inertia_dry=(900.0, 1400.0, 1900.0)
    )
    actuators = Actuators(lander, 0.002)
    state, work = start(lander, rate=np.array([0.1, -0.2, 0.15])), 0.0
    inertia = np.array(lander.inertia_full)
    first = 0.5 * inertia @ state.rate**2
    dynamics = Dynamics(lander, ALMOST_NOTHING, 0.002)
    for on in (orders(lander, j0=1.0, j2=1.0, j7=1.0), orders(lander, j5=1.0, j3=1.0)):
        actuators.command(on, NO_SWING)
        torque = (on > 0.0) @ lander.thrusters.torques
        for _ in range(500):
            before, state = state, actuators.advance(dynamics, state, 0.0)
            work += 0.002 * torque @ (0.5 * (before.rate + state.rate))
    last = 0.5 * inertia @ state.rate**2
    assert abs(last - first) > 3.0
    assert last - first == pytest.approx(work, rel=1e-6)


def test_valves_stay_open_for_their_least_time():
    actuators = Actuators(LANDER, STEP)
    actuators.command(orders(LANDER, j0=0.001), NO_SWING)
    run(actuators, 5, start(LANDER))
    assert actuators.on_time[0] == pytest.approx(0.02)
    again = Actuators(LANDER, STEP)
    again.command(orders(LANDER, j0=0.1), NO_SWING)
    state = run(again, 1, start(LANDER))[-1]
    again.command(orders(LANDER), NO_SWING)  # called back after a step
    run(again, 5, state)
    assert again.on_time[0] == pytest.approx(0.02)
    # A valve that opens again has its least time again.
    state = run(again, 5, state)[-1]
    again.command(orders(LANDER, j0=0.1), NO_SWING)
    state = run(again, 1, state)[-1]
    again.command(orders(LANDER), NO_SWING)
    run(again, 5, state)
    assert again.on_time[0] == pytest.approx(0.04)


def test_empty_thruster_tanks_push_no_more():
    lander = replace(LANDER, thrusters=Thrusters(propellant=0.01))
    actuators = Actuators(lander, STEP)
    actuators.command(orders(lander, j0=5.0), NO_SWING)
    states = run(actuators, 500, start(lander))
    assert actuators.spent == pytest.approx(0.01, rel=1e-9)
    assert lander.wet_mass - states[-1].mass == pytest.approx(0.01, rel=1e-6)
    assert states[-1].velocity == pytest.approx(states[-50].velocity, abs=1e-10)


def test_main_tanks_run_dry_at_their_own_mass_whatever_thrusters_have_burnt():
    lander = replace(LANDER, propellant_mass=2.0)
    actuators = Actuators(lander, STEP)
    actuators.command(orders(lander, j0=10.0, j1=10.0, j4=10.0, j5=10.0), NO_SWING)
    states = run(actuators, 400, start(lander), throttle=3000.0)
    dry = next(s for s in states if s.thrust == 0.0 and s is not states[0])
    left = dry.mass - lander.dry_mass
    assert left < -0.05  # the dry mass counts what thrusters have burnt since
    assert states[-1].mass == pytest.approx(lander.dry_mass - actuators.spent, abs=1e-9)
    gained = lander.exhaust_velocity * np.log(lander.wet_mass / (lander.wet_mass - 2.0))
    assert states[-1].velocity[2] == pytest.approx(gained, rel=5e-3)


def test_the_gimbal_turns_at_its_rate_up_to_its_limit():
    lander = replace(LANDER, engine=DescentEngine(gimbal_limit=0.1, gimbal_rate=0.05))
    actuators = Actuators(lander, STEP)
    actuators.command(orders(lander), np.array([1.0, -0.03]))
    run(actuators, 40, start(lander))
    assert actuators.gimbal == pytest.approx([0.02, -0.02])
    run(actuators, 400, start(lander))
    assert actuators.gimbal == pytest.approx([0.1, -0.03])


def test_a_swung_engine_turns_the_lander_by_force_times_arm():
    lander = replace(
        LANDER,
        engine=DescentEngine(gimbal_rate=1e3),
        com_dry=(0.0, 0.0, 0.2),
        com_full=(0.0, 0.0, 0.2),
    )
    actuators = Actuators(lander, STEP)
    actuators.command(orders(lander), np.array([0.05, 0.0]))
    end = run(actuators, 10, start(lander), throttle=4000.0)[-1]
    arm = lander.engine.pivot_depth + 0.2
    expected = -4000.0 * np.sin(0.05) * arm / lander.inertia_full[0] * 0.1
    assert end.rate == pytest.approx([expected, 0.0, 0.0], rel=1e-3, abs=1e-9)
    assert end.velocity[1] == pytest.approx(
        -4000.0 * np.sin(0.05) / lander.wet_mass * 0.1, rel=0.02
    )


def test_the_centre_of_mass_moves_with_the_propellant():
    lander = replace(LANDER, com_dry=(0.0, 0.01, 0.0), com_full=(0.04, 0.01, -0.3))
    assert lander.com(lander.wet_mass) == pytest.approx([0.04, 0.01, -0.3])
    assert lander.com(lander.dry_mass + 0.5 * lander.propellant_mass) == pytest.approx(
        [0.02, 0.01, -0.15]
    )
    assert Lander().com(1300.0).tolist() == [0.0, 0.0, 0.0]
    end = run(Actuators(lander, STEP), 10, start(lander), throttle=3000.0)[-1]
    expected = 3000.0 * np.array([-0.01, 0.04, 0.0]) / np.array(lander.inertia_full) * 0.1
    assert end.rate == pytest.approx(expected, rel=2e-3, abs=1e-9)


def test_throttle_steps_dead_band_and_gap():
    engine = DescentEngine(throttle_step=50.0, dead_band=30.0, gap_lower=3600.0, gap_upper=5500.0)
    actuators = Actuators(replace(LANDER, engine=engine), STEP)
    # An engine that does not run is started however little is asked for.
    assert actuators.set_throttle(20.0) == LANDER.thrust_min
    assert actuators.set_throttle(2020.0) == 2000.0
    assert actuators.set_throttle(2029.0) == 2000.0
    assert actuators.set_throttle(2031.0) == 2050.0
    assert actuators.set_throttle(10.0) == LANDER.thrust_min
    assert actuators.set_throttle(3700.0) == 3600.0
    assert actuators.set_throttle(5000.0) == 5500.0
    assert actuators.set_throttle(1e9) == 5500.0
    assert actuators.set_throttle(0.0) == 0.0
    # No step leads into the gap: 3579 is nearer to 3600 than to 3500.
    uneven = DescentEngine(throttle_step=100.0, gap_lower=3580.0, gap_upper=5500.0)
    assert Actuators(replace(LANDER, engine=uneven), STEP).set_throttle(3579.0) == 3580.0


def test_what_fails_is_not_what_is_ordered():
    faults = Faults(jets_stuck_shut=(0,), jets_stuck_open=(1,), jets_stuck_from=0.05)
    actuators = Actuators(LANDER, STEP, faults)
    actuators.command(orders(LANDER, j0=0.1), NO_SWING)
    run(actuators, 10, start(LANDER))
    assert actuators.on_time[0] == pytest.approx(0.05)
    assert actuators.on_time[1] == pytest.approx(0.05)
    stuck = Actuators(LANDER, STEP, Faults(engine_stuck_from=0.03))
    assert stuck.set_throttle(2000.0) == 2000.0
    run(stuck, 4, start(LANDER))
    assert stuck.set_throttle(4000.0) == 2000.0
    shut = Actuators(LANDER, STEP, Faults(engine_stuck_from=0.0, engine_stuck_at=1500.0))
    assert shut.set_throttle(4000.0) == 1500.0


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Faults(jets_stuck_shut=(1,), jets_stuck_open=(1,)), "faults.jets_stuck_open"),
        (lambda: Faults(engine_stuck_at=100.0), "faults.engine_stuck_at"),
        (lambda: Actuators(LANDER, STEP, Faults(jets_stuck_shut=(16,))), "faults.jets_stuck_shut"),
        (lambda: Thrusters(positions=((1.0, 0.0, 0.0),)), "thrusters.directions"),
        (
            lambda: Thrusters(
                positions=((1.0, 0.0, 0.0),) * 4, directions=((0.0, 0.0, 1.0),) * 4
            ),
            "thrusters.positions",
        ),
        (lambda: Thrusters(force=float("nan")), "thrusters.force"),
        (lambda: DescentEngine(gap_lower=3000.0), "engine.gap_upper"),
        (
            lambda: JetLander(engine=DescentEngine(gap_lower=3000.0, gap_upper=9000.0)),
            "vehicle.engine.gap_upper_n",
        ),
        (
            lambda: JetLander(thrusters=Thrusters(propellant=2000.0)),
            "vehicle.thrusters.propellant_kg",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make, field):
    with pytest.raises(InputError) as refused:
        make()
    assert refused.value.field == field


def test_clusters_stand_as_on_the_lunar_module():
    """550 ft lb about pitch and roll from 100 lbf at 66.1 in off both axes."""
    thrusters = Thrusters(force=444.82, cluster_radius=66.1 * 0.0254 * np.sqrt(2.0))
    torques = thrusters.torques
    assert np.abs(torques[0, :2]) == pytest.approx(550.0 * 0.3048 * 4.44822, rel=3e-3)
    assert thrusters.count == len(torques) == 16
    assert torques.sum(axis=0) == pytest.approx(0.0, abs=1e-9)
    assert thrusters.forces.sum(axis=0) == pytest.approx(0.0, abs=1e-9)
    assert JetLander(thrusters=thrusters).torque_max == pytest.approx(
        (4 * 746.8, 4 * 746.8, 4 * 746.8), rel=1e-3
    )


@pytest.mark.parametrize(("throttle", "min_pulse"), [(700.0, 0.0), (700.0, 0.04), (2700.0, 0.04)])
def test_an_engine_in_pulses_has_the_commanded_mean_thrust(throttle, min_pulse):
    """The engine is on or off; times shorter than a pulse are added to the next one."""
    engine = DescentEngine(continuous_min=3000.0, pulse_period=0.1, min_pulse=min_pulse)
    lander = replace(LANDER, engine=engine, thrust_max=3000.0, thrust_min=300.0, thrust_lag=0.0)
    actuators = Actuators(lander, STEP)
    assert actuators.set_throttle(throttle) == throttle
    states = run(actuators, 400, start(lander), throttle=throttle)
    burnt = lander.wet_mass - states[-1].mass
    assert burnt == pytest.approx(throttle / lander.exhaust_velocity * 400 * STEP, rel=5e-3)
    flows = -np.diff([s.mass for s in states]) / STEP * lander.exhaust_velocity
    on = np.flatnonzero(np.diff(flows > 1.0))  # steps before the engine starts or stops
    assert len(on) > 15
    assert np.diff(on).min() * STEP >= min_pulse - 1e-9


@pytest.mark.parametrize("period", [0.3 * STEP, 1.5 * STEP, 4.2 * STEP])
def test_pulses_have_the_commanded_mean_thrust_at_every_period(period):
    """A pulse begins with a step, so a period of 4.2 steps lasts 5 steps."""
    engine = DescentEngine(continuous_min=3000.0, pulse_period=period)
    lander = replace(LANDER, engine=engine, thrust_max=3000.0, thrust_min=300.0, thrust_lag=0.0)
    states = run(Actuators(lander, STEP), 400, start(lander), throttle=1200.0)
    burnt = lander.wet_mass - states[-1].mass
    assert burnt == pytest.approx(1200.0 / lander.exhaust_velocity * 400 * STEP, rel=5e-3)


def test_pulses_have_the_true_thrust_and_start_afresh_after_continuous_thrust():
    """At 1.1 times the nominal thrust; 0.1 s of full thrust lies between two pulses."""
    engine = DescentEngine(continuous_min=3000.0, pulse_period=0.5)
    lander = replace(LANDER, engine=engine, thrust_max=3000.0, thrust_min=300.0, thrust_lag=0.0)
    lander = replace(lander, thrust_scale=1.1)
    actuators, state, burnt = Actuators(lander, STEP), start(lander), []
    for throttle, steps in ((1500.0, 25), (3000.0, 10), (600.0, 15)):
        end = run(actuators, steps, state, throttle=throttle)[-1]
        burnt.append((state.mass - end.mass) * lander.exhaust_velocity / (steps * STEP))
        state = end
    # A pulse for 1,500 N lasts all of the first 0.25 s, one for 600 N lasts 0.1 of 0.15 s.
    assert burnt == pytest.approx([3300.0, 3300.0, 2200.0], rel=2e-3)


def test_an_engine_throttles_above_its_continuous_minimum():
    engine = DescentEngine(continuous_min=2000.0, pulse_period=0.2)
    lander = replace(LANDER, engine=engine, thrust_lag=0.0)
    states = run(Actuators(lander, STEP), 20, start(lander), throttle=2500.0)
    flows = -np.diff([s.mass for s in states]) / STEP * lander.exhaust_velocity
    assert flows == pytest.approx(np.full(len(flows), 2500.0), rel=1e-3)
    for least in (LANDER.thrust_max + 1.0, LANDER.thrust_min):
        with pytest.raises(InputError, match="continuous_min_n"):
            replace(LANDER, engine=replace(engine, continuous_min=least))
    with pytest.raises(InputError, match="min_pulse"):
        replace(engine, min_pulse=0.15)
    with pytest.raises(InputError, match="gap_upper"):
        replace(engine, gap_lower=2500.0, gap_upper=3000.0)
