"""Quaternion feedback and phase plane, against the closed forms of the loops that they close."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import (
    quat_from_rotation_vector,
    quat_rotate,
    quat_to_rotation_vector,
)
from lunarsim.messages.commands import Command
from lunarsim.models.jet_lander import DescentEngine, JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.onboard.control.jets import JetLoop
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.control.quaternion_feedback import QuaternionFeedback
from lunarsim.onboard.control.throttle import ThrottleRegions

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def step_response(law, angle: float, seconds: float, dt: float = 0.001) -> np.ndarray:
    """Return angle left about body y (n,) after a step, with torques that act at once."""
    inertia = np.array(Lander().inertia_full)
    left, rate, out = angle, 0.0, []
    for _ in range(round(seconds / dt)):
        torque = law.torque(np.array([0.0, left, 0.0]), np.array([0.0, rate, 0.0]), inertia)
        rate += dt * torque[1] / inertia[1]
        left -= dt * rate
        out.append(left)
    return np.array(out)


@pytest.mark.parametrize(
    "law", [ProportionalDerivative(2.0, 0.6), QuaternionFeedback(2.0, 0.6, braking=50.0)]
)
def test_a_small_step_is_that_of_a_damped_oscillator(law):
    angle, dt = 1e-3, 0.001
    found = step_response(law, angle, 4.0, dt)
    t = dt * np.arange(1, len(found) + 1)
    damped = 2.0 * np.sqrt(1.0 - 0.6**2)
    closed = angle * np.exp(-1.2 * t) * (np.cos(damped * t) + 1.2 / damped * np.sin(damped * t))
    assert found == pytest.approx(closed, abs=3e-3 * angle)


def test_a_large_turn_keeps_its_axis_and_its_rate():
    law, inertia = QuaternionFeedback(slew_limit=0.1), np.array([900.0, 1400.0, 1900.0])
    q, rate, dt = LEVEL.copy(), np.zeros(3), 0.01
    axis = np.array([0.48, -0.6, 0.64])
    target = quat_from_rotation_vector(1.2 * axis)
    fastest, off = 0.0, 0.0
    for _ in range(3000):
        error = quat_to_rotation_vector(_between(q, target))
        torque = law.torque(error, rate, inertia)
        rate = rate + dt * (torque - np.cross(rate, inertia * rate)) / inertia
        q = _product(q, quat_from_rotation_vector(rate * dt))
        fastest = max(fastest, float(np.linalg.norm(rate)))
        turned = quat_to_rotation_vector(q)
        off = max(off, float(np.linalg.norm(np.cross(turned, axis))))
    assert 0.095 < fastest < 0.1001
    assert off < 1e-3
    assert np.linalg.norm(quat_to_rotation_vector(_between(q, target))) < 1e-4


def _product(p, q):
    from scipy.spatial.transform import Rotation

    return (Rotation.from_quat(p) * Rotation.from_quat(q)).as_quat()


def _between(q, target):
    from scipy.spatial.transform import Rotation

    return (Rotation.from_quat(q).inv() * Rotation.from_quat(target)).as_quat()


def test_braking_stops_a_turn_within_the_torque_that_is_counted_on():
    law, inertia, most = QuaternionFeedback(slew_limit=1.0, braking=0.03), np.full(3, 1000.0), 0.05
    left, rate, least, dt = 1.0, 0.0, 0.0, 0.01
    for _ in range(3000):
        torque = law.torque(np.array([left, 0.0, 0.0]), np.array([rate, 0.0, 0.0]), inertia)[0]
        rate += dt * float(np.clip(torque / 1000.0, -most, most))
        left -= dt * rate
        least = min(least, left)
    assert abs(left) < 1e-3
    assert least > -0.02  # the plain law with these thrusters would swing far past


def coasting(law, least, disturbance, seconds, angle, rate, dt=0.002, a=0.05):
    """Return angle and rate (n, 2) of one axis under pulses at once, and when they came."""
    rows, pulses = [], []
    every = round(law.period / dt)
    for n in range(round(seconds / dt)):
        if n % every == 0:
            change = law.rate_change(
                np.array([-angle, 0.0, 0.0]),
                np.array([rate, 0.0, 0.0]),
                np.full(3, a),
                np.full(3, least),
            )[0]
            rate += change
            if change:
                pulses.append((n * dt, change))
        angle += dt * (rate + 0.5 * dt * disturbance)
        rate += dt * disturbance
        rows.append((angle, rate))
    return np.array(rows), np.array(pulses)


def test_the_limit_cycle_goes_from_edge_to_edge_at_half_a_pulse():
    law, least = PhasePlane(dead_band=0.005, rate_band=0.01, period=0.02), 1e-3
    rows, pulses = coasting(law, least, 0.0, 200.0, 0.0, 0.5 * least)
    assert np.abs(pulses[:, 1]) == pytest.approx(least)
    assert np.all(np.diff(np.sign(pulses[:, 1])) != 0)
    period = 2.0 * np.diff(pulses[:, 0]).mean()
    # A look every 20 ms sees the edge up to a period late, twice a cycle.
    assert period == pytest.approx(8.0 * law.dead_band / least, rel=0.01)
    assert np.abs(rows[:, 0]).max() == pytest.approx(law.dead_band, abs=0.02 * least)
    assert np.abs(rows[:, 1]).max() == pytest.approx(0.5 * least, rel=1e-6)


@pytest.mark.parametrize("disturbance", [2e-5, -1e-4])
def test_under_a_steady_torque_the_limit_cycle_bounces_on_one_edge(disturbance):
    law, least = PhasePlane(dead_band=0.005, rate_band=0.01, period=0.02), 1e-3
    rows, pulses = coasting(law, least, disturbance, 400.0, 0.0, 0.0)
    late = pulses[pulses[:, 0] > 200.0]
    assert np.all(np.sign(late[:, 1]) == -np.sign(disturbance))
    # What is fired balances the torque: a closed form whatever the law.
    span = late[-1, 0] - late[0, 0]
    assert late[1:, 1].sum() == pytest.approx(-disturbance * span, rel=0.02)
    assert np.diff(late[:, 0]).mean() == pytest.approx(least / abs(disturbance), rel=0.15)
    settled = rows[round(200.0 / 0.002) :, 0] * np.sign(disturbance)
    swing = least**2 / (8.0 * abs(disturbance))
    assert np.ptp(settled) == pytest.approx(swing, rel=0.35)
    assert settled.max() == pytest.approx(law.dead_band, abs=0.05 * law.dead_band)


def test_a_large_error_is_turned_out_within_rate_and_dead_band():
    law = PhasePlane(slew_limit=0.05, period=0.02)
    rows, _ = coasting(law, 1e-3, 0.0, 60.0, 0.8, 0.0)
    assert np.abs(rows[:, 1]).max() < 0.05 + 2e-3
    assert rows[:, 0].min() > -2.0 * law.dead_band
    assert np.abs(rows[-1000:, 0]).max() < 1.1 * law.dead_band


def loop(law, lander=None, thrust=2400.0, target=LEVEL) -> JetLoop:
    made = JetLoop(law, lander or JetLander(), 0.01)
    made.start_cycle(Command(thrust, np.asarray(target)), LEVEL, 1300.0)
    return made


def test_small_torques_are_carried_until_they_make_a_pulse():
    class Steady:
        period = 0.1

        def torque(self, error, rate, inertia):
            return np.array([0.0, 0.0, 2.0])

    made = loop(Steady())
    sums = np.zeros(3)
    for _ in range(400):
        due = made.is_due
        made.torque()
        made.propagate(np.zeros(3))
        sums += made.allocation.impulse(made.on_times) * due
    assert sums == pytest.approx([0.0, 0.0, 2.0 * 4.0], abs=made.allocation.min_impulse[2])


def test_the_gimbal_takes_over_a_steady_torque():
    """Thrusters hold a torque of 30 N m; the engine's swing must come to make it."""
    lander = JetLander(engine=DescentEngine(gimbal_rate=0.1))
    holding = np.array([30.0, -20.0, 0.0])

    class Holding:
        period = 0.1
        taken = np.zeros(3)

        def torque(self, error, rate, inertia):
            return holding - self.taken

    law = Holding()
    made = loop(law, lander)
    for _ in range(4000):
        made.torque()
        made.propagate(np.zeros(3))
        x, y = made.gimbal
        law.taken = 2400.0 * lander.engine.pivot_depth * np.array([-x, -y, 0.0])
    assert law.taken == pytest.approx(holding, rel=0.05, abs=1.0)


def test_recorded_increments_give_the_firings_again():
    rng = np.random.default_rng(4)
    increments = rng.normal(0.0, 2e-4, (60, 3))
    target = quat_from_rotation_vector([0.05, -0.02, 0.01])
    for law in (QuaternionFeedback(), PhasePlane(), ProportionalDerivative(1.0)):
        first, again = loop(law, target=target), loop(law, target=target)
        torques = []
        for increment in increments:
            torques.append(first.torque())
            first.propagate(increment)
        assert again.replay(increments).tobytes() == np.array(torques).tobytes()
        assert again.propellant_used == first.propellant_used > 0.0


def test_throttle_regions_do_not_chatter():
    regions = ThrottleRegions(DescentEngine(gap_lower=3000.0, gap_upper=5000.0))
    asked = [2900.0, 3100.0, 3149.0, 3151.0, 2900.0, 2851.0, 2849.0, 3100.0]
    given = [2900.0, 3000.0, 3000.0, 5000.0, 5000.0, 5000.0, 2849.0, 3000.0]
    assert [regions.select_thrust(a) for a in asked] == given
    assert ThrottleRegions(DescentEngine()).select_thrust(4321.0) == 4321.0


def test_allocation_serves_every_axis_of_the_loop():
    least = ThrusterAllocation(JetLander().thrusters).min_impulse
    for axis in range(3):
        for sign in (1.0, -1.0):
            angle = np.zeros(3)
            angle[axis] = sign * 0.05
            made = loop(PhasePlane(), target=quat_from_rotation_vector(angle))
            made.torque()
            impulse = made.allocation.impulse(made.on_times)
            assert sign * impulse[axis] > least[axis]
            others = np.delete(impulse, axis)
            assert np.abs(others).max() < 1e-9


def one_axis(law, angle, rate, a, least):
    """Return the rate change that is asked for about body x; `angle` is how far it is off."""
    given = [np.array([v, 0.0, 0.0]) for v in (-angle, rate)]
    return law.rate_change(*given, np.full(3, a), np.full(3, least))[0]


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_switching_lines_of_the_phase_plane(sense):
    """Each line from either side: rate alone in the band, parabola, return from outside."""
    law = PhasePlane(dead_band=0.005, rate_band=0.02, slew_limit=0.3)
    a, least = 0.01, 1e-3

    def asked(angle, rate):
        return sense * one_axis(law, sense * angle, sense * rate, a, least)

    # Within the band: to where rate^2 / 2a takes it, and by its rate alone when it comes back.
    edge = np.sqrt(2.0 * a * law.dead_band)
    assert asked(1e-12, 0.95 * edge) == 0.0
    assert asked(1e-12, 1.05 * edge) == pytest.approx(-(1.05 * edge + 0.5 * least))
    assert asked(0.004, -0.95 * law.rate_band) == 0.0
    assert asked(0.004, -1.5 * law.rate_band) == pytest.approx(1.5 * law.rate_band - 0.5 * least)
    # Outside: it comes back with half of the acceleration kept in hand, no faster than the slew.
    for angle in (0.05, 0.5, 40.0):
        back = min(law.slew_limit, np.sqrt(a * (angle - 1.25 * law.dead_band)))
        assert asked(angle, -back) == 0.0
        assert asked(angle, -0.9 * back) == pytest.approx(-(0.1 * back + 0.5 * least))
        assert asked(angle, -back - 0.95 * law.rate_band) == 0.0
        too_fast = back + 1.5 * law.rate_band
        assert asked(angle, -too_fast) == pytest.approx(too_fast - back - 0.5 * least)


class Asking:
    """A law that asks for a torque that tests choose."""

    period = 0.1

    def __init__(self, torque):
        self.wanted = np.asarray(torque, float)

    def torque(self, error, rate, inertia):
        return self.wanted


def test_the_gimbal_swings_no_faster_than_it_can_and_by_the_arm_of_the_mass():
    """The pivot lies as far below the centre of mass as that lies above the body's origin."""
    com = (0.0, 0.0, 0.4)
    for rate in (1e3, 1e-3):
        lander = JetLander(engine=DescentEngine(gimbal_rate=rate), com_dry=com, com_full=com)
        law = Asking([30.0, -20.0, 0.0])
        made = loop(law, lander)
        made.torque()
        given = made.allocation.impulse(made.on_times)
        for _ in range(made.period_steps):  # the lander does not rotate: a torque is compensated
            made.propagate(np.zeros(3))
            made.torque()
        arm = lander.engine.pivot_depth + 0.4
        free = -given[:2] / (2400.0 * arm * 4.0)  # taken over in 4 s
        assert (np.abs(free) > 2e-4).all()
        most = rate * made.period
        assert made.gimbal == pytest.approx(np.clip(free, -most, most), rel=1e-9)


def test_the_gimbal_does_not_move_in_a_slew():
    """The thrusters' impulse changes the rate as it should: no torque is left to take over."""
    law = Asking([30.0, -20.0, 0.0])
    made, rate = loop(law), np.zeros(3)
    for _ in range(200):
        made.torque()
        rate = (
            rate + made.allocation.impulse(made.on_times) / made.period * made.step / made.inertia
        )
        made.propagate(rate * made.step)
    assert np.abs(rate[:2]).min() > 0.01
    assert np.abs(made.gimbal).max() < 2e-5


def test_what_thrusters_could_not_give_is_forgotten_but_for_a_pulse():
    """After seconds beyond reach nothing is fired on and on."""
    law = Asking([0.0, 5e4, 0.0])
    made = loop(law)
    for _ in range(300):
        made.torque()
        made.propagate(np.zeros(3))
    law.wanted = np.zeros(3)
    sums = np.zeros(3)
    while not made.is_due:
        made.torque()
    for _ in range(200):
        due = made.is_due
        made.torque()
        made.propagate(np.zeros(3))
        sums += made.allocation.impulse(made.on_times) * due
    assert np.abs(sums).max() <= made.allocation.min_impulse.max() * (1.0 + 1e-9)


def test_the_watch_receives_rotations_about_the_centre_of_mass():
    com = np.array([0.1, -0.2, 0.5])
    lander = JetLander(com_dry=tuple(com), com_full=tuple(com))
    made, told = loop(Asking([40.0, 25.0, -30.0]), lander), []
    made.failure_detector.update = lambda change, known, turns, period: told.append(turns) or []
    for _ in range(2 * made.period_steps + 1):
        on_times = made.on_times.copy()
        made.torque()
        made.propagate(np.zeros(3))
    where, along = lander.thrusters.layout
    force = lander.thrusters.force * along
    wanted = on_times[:, None] * np.cross(where - com, force) / lander.inertia(1300.0)
    assert (on_times > 0.0).sum() >= 3
    assert told[-1] == pytest.approx(wanted, abs=1e-12)


def test_an_allocation_that_cannot_turn_every_way_is_not_taken_over():
    made = loop(Asking([40.0, 25.0, -30.0]))
    before = made.allocation

    def all_that_push_up_and_down(change, known, turns, period):
        made.failure_detector.failed = [0, 4, 8, 12, 1, 5, 9, 13]
        return made.failure_detector.failed

    made.failure_detector.update = all_that_push_up_and_down
    for _ in range(2 * made.period_steps + 1):
        made.torque()
        made.propagate(np.zeros(3))
    assert made.allocation is before


COM = (0.06, -0.04, 0.3)


def test_a_mass_beside_the_engines_line_leans_the_body_and_not_the_thrust():
    """Swung through the centre of mass from the first command on; thrust is where it was asked."""
    lander = JetLander(com_dry=COM, com_full=COM)
    target = quat_from_rotation_vector([0.1, -0.2, 0.4])
    made = loop(QuaternionFeedback(), lander, target=target)
    x, y = made.gimbal
    push = np.array([np.sin(y) * np.cos(x), -np.sin(x), np.cos(y) * np.cos(x)])
    lever = np.array([0.0, 0.0, -lander.engine.pivot_depth]) - COM
    assert np.cross(lever, push) == pytest.approx(np.zeros(3), abs=1e-12)
    assert quat_rotate(made.target, push) == pytest.approx(
        quat_rotate(target, [0, 0, 1]), abs=1e-12
    )
    straight = loop(QuaternionFeedback(), JetLander(com_dry=(0, 0, 0.3), com_full=(0, 0, 0.3)),
                    target=target)  # fmt: skip
    assert np.array_equal(straight.target, target)
    assert not straight.gimbal.any()
    fixed = JetLander(com_dry=COM, com_full=COM, engine=DescentEngine(gimbal_limit=0.0))
    assert np.array_equal(loop(QuaternionFeedback(), fixed, target=target).target, target)
    short = JetLander(com_dry=COM, com_full=COM, engine=DescentEngine(gimbal_limit=0.02))
    assert np.abs(loop(QuaternionFeedback(), short).gimbal) == pytest.approx([0.02, 0.02])


def test_what_the_engine_is_swung_by_is_set_once():
    """From then on the trim moves it; the body leans by what the mass now asks for."""
    lander = JetLander(com_dry=COM, com_full=(-0.05, 0.02, 0.3))
    target = quat_from_rotation_vector([0.1, -0.2, 0.4])
    made = loop(QuaternionFeedback(), lander, target=target)
    before = made.target.copy()
    made.gimbal = np.array([0.01, -0.02])
    made.start_cycle(Command(2400.0, target), LEVEL, 1100.0)
    assert made.gimbal.tolist() == [0.01, -0.02]
    assert np.abs(made.target - before).max() > 1e-3
    # An engine above the centre of mass is not swung: it would have to push the other way.
    high = JetLander(
        com_dry=COM, com_full=COM, engine=DescentEngine(pivot_depth=0.0, gimbal_limit=0.1)
    )
    object.__setattr__(high, "com_dry", (0.06, -0.04, -0.3))
    object.__setattr__(high, "com_full", (0.06, -0.04, -0.3))
    above = loop(QuaternionFeedback(), high, target=target)
    assert not above.gimbal.any()
    assert np.array_equal(above.target, target)


@pytest.mark.parametrize("name", ["com_dry", "com_full"])
def test_a_centre_of_mass_that_nothing_holds_is_refused(name):
    """About an engine at its least thrust: swung to its limit, and thrusters against the rest."""
    plain = JetLander()
    for axis, torque in ((1, plain.torque_max[0]), (0, plain.torque_max[1])):
        most = 0.8 * np.tan(plain.engine.gimbal_limit) + torque / plain.thrust_min
        for sense in (1.0, -1.0):
            com = np.zeros(3)
            com[axis] = sense * (most - 1e-6)
            JetLander(**{name: tuple(com)})
            com[axis] = sense * (most + 1e-6)
            with pytest.raises(InputError, match="engine's axis") as refused:
                JetLander(**{name: tuple(com)})
            assert refused.value.field == f"vehicle.{name}_m[{axis}]"
    JetLander(**{name: (0.0, 0.0, -0.79)})
    JetLander(**{name: (0.0, 0.0, -0.81)}, engine=DescentEngine(gimbal_limit=0.0))
    with pytest.raises(InputError, match="pivot"):
        JetLander(**{name: (0.0, 0.0, -0.81)})


def test_the_watch_knows_what_a_swung_engine_does_about_the_mass():
    """Against the moment written out: pivot less mass, times thrust."""
    lander = JetLander(com_dry=COM, com_full=COM)
    made, told = loop(Asking([0.0, 0.0, 0.0]), lander), []
    made.failure_detector.update = lambda change, known, turns, period: told.append(known) or []
    x, y = 0.02, -0.03
    for _ in range(made.period_steps):
        made.torque()
        made.propagate(np.zeros(3))
    made.gimbal = np.array([x, y])
    made.torque()
    push = np.array([np.sin(y) * np.cos(x), -np.sin(x), np.cos(y) * np.cos(x)])
    lever = np.array([0.0, 0.0, -lander.engine.pivot_depth]) - COM
    moment = 2400.0 * np.cross(lever, push) * made.period / lander.inertia(1300.0)
    assert told[-1] == pytest.approx(moment, rel=2e-3, abs=1e-6)
