"""Test the rejection of inertial outliers, singly and in complete flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.messages.measurements import InertialSamples
from lunarsim.models.inertial_unit import TACTICAL_ACCELEROMETERS, TACTICAL_GYROSCOPES
from lunarsim.models.lander import Lander
from lunarsim.onboard.navigation.imu_outlier_rejection import ImuOutlierDetector, ImuSampleLimits
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

STEP = 0.01
LANDER = Lander()
LIMITS = ImuSampleLimits.of(LANDER, STEP, TACTICAL_GYROSCOPES, TACTICAL_ACCELEROMETERS)
SCENARIO = Path(__file__).parents[3] / "scenarios" / "instruments.toml"


def test_limits_are_those_of_thrusters_and_engine():
    # 600 N m on 1100 kg m^2; 6000 N on 1100 kg, of which a tenth of the lag lets 9.5 % through.
    assert LIMITS.max_change[0] >= 600.0 / 1100.0 * STEP
    assert LIMITS.max_change[0] <= 1.5 * 600.0 / 1100.0 * STEP
    assert LIMITS.max_change[5] >= 6000.0 / 1100.0 * 0.0951
    assert LIMITS.max_change[5] <= 1.5 * 6000.0 / 1100.0 * 0.0952
    at_once = ImuSampleLimits.of(
        replace(LANDER, thrust_lag=0.0),
        STEP,
        TACTICAL_GYROSCOPES,
        TACTICAL_ACCELEROMETERS,
        slew=0.25,
    )
    assert at_once.max_change[5] >= 6000.0 / 1100.0
    assert at_once.max_change[0] >= 0.5


def manoeuvres(rng, n=4000):
    """Return increments with thrusters and engine at random extremes."""
    torque = np.repeat(rng.choice([-1.0, 1.0], (n // 10, 3)), 10, axis=0)
    torque *= np.array([600.0, 600.0, 300.0]) / np.array([1100.0, 1100.0, 1300.0])
    rate = np.cumsum(torque, axis=0) * STEP
    asked = np.repeat(rng.choice([0.5, 5.4], n // 10), 10)
    push = np.zeros(n)
    for k in range(1, n):
        push[k] = asked[k] + (push[k - 1] - asked[k]) * np.exp(-STEP / 0.1)
    force = np.column_stack((np.zeros((n, 2)), push))
    angle = rate * STEP + TACTICAL_GYROSCOPES.random_walk * np.sqrt(STEP) * rng.standard_normal(
        (n, 3)
    )
    gained = force * STEP + TACTICAL_ACCELEROMETERS.random_walk * np.sqrt(
        STEP
    ) * rng.standard_normal((n, 3))
    return angle, gained


@pytest.mark.parametrize("length", [1, 3, 10])
def test_extreme_manoeuvres_are_accepted(length):
    rng = np.random.default_rng(3)
    guard = ImuOutlierDetector(LIMITS, STEP)
    angle, velocity = manoeuvres(rng)
    found = [guard.screen(angle[k : k + length], velocity[k : k + length])
             for k in range(0, len(angle), length)]  # fmt: skip
    assert sum(f.rejected for f in found) == 0
    assert not any(f.is_missing.any() or f.jump.any() for f in found)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("at", [0, 4, 9, 37])
def test_a_spike_is_refused_and_nothing_else(at, axis):
    rng = np.random.default_rng(4)
    guard = ImuOutlierDetector(LIMITS, STEP)
    angle, velocity = manoeuvres(rng, 100)
    both = np.hstack((angle, velocity))
    both[at, axis] += (
        2.5 * (LIMITS.max_change + LIMITS.max_noise)[axis] * STEP * (1 + 9 * (at == 0))
    )
    found = [guard.screen(both[k : k + 10, :3], both[k : k + 10, 3:]) for k in range(0, 100, 10)]
    is_missing = np.concatenate([f.is_missing for f in found])
    assert np.flatnonzero(is_missing).tolist() == [at]
    assert not any(f.jump.any() for f in found)


def test_persistent_jump_is_accepted_and_bias_inflated():
    rng = np.random.default_rng(5)
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = StrapdownState(np.zeros(3), np.zeros(3), upright, 1.622, limits=LIMITS)
    angle, velocity = manoeuvres(rng, 40)
    velocity[20:, 1] += 3.0 * STEP
    _, before = state.propagate(angle[:20], velocity[:20])
    _, after = state.propagate(angle[20:], velocity[20:])
    assert before[7, 7] < 1e-6
    assert np.sqrt(after[7, 7]) == pytest.approx(3.0, abs=0.1)
    told = dict(state.pop_events())
    assert told["samples-rejected"] == {"count": 2}
    assert told["samples-jump"]["force"] == pytest.approx(3.0, abs=0.1)
    assert state.pop_events() == []


def test_rate_jump_inflates_bias_and_attitude():
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = StrapdownState(np.zeros(3), np.zeros(3), upright, 1.622, limits=LIMITS)
    angle, velocity = manoeuvres(np.random.default_rng(8), 40)
    velocity[20:, 1] += 3.0 * STEP
    angle[20:, 2] += 0.5 * STEP
    state.propagate(angle[:20], velocity[:20])
    _, after = state.propagate(angle[20:], velocity[20:])
    honest = StrapdownState(np.zeros(3), np.zeros(3), upright, 1.622, limits=LIMITS)
    _, before = honest.propagate(*(a[:20] for a in manoeuvres(np.random.default_rng(8), 40)))
    raise_variances = np.sqrt(np.diag(after)[[7, 14]] - np.diag(before)[[7, 14]])
    assert raise_variances == pytest.approx([3.0, 0.5], abs=0.1)
    # Velocity and attitude were integrated with the wrong samples for a while.
    assert after[4, 4] > 2.0 * before[4, 4]
    assert after[11, 11] > 2.0 * before[11, 11]
    # 20 samples and the 3 that it took to be believed, with all of the jump.
    summed = np.sqrt(np.diag(after)[[4, 11]] - np.diag(before)[[4, 11]])
    assert summed == pytest.approx(np.array([3.0, 0.5]) * 23 * STEP, rel=0.15)


def test_spikes_that_agree_but_do_not_follow_each_other_are_refused():
    guard = ImuOutlierDetector(LIMITS, STEP)
    angle, velocity = np.zeros((60, 3)), np.zeros((60, 3))
    angle[5::4, 0] = 3.0 * LIMITS.max_change[0] * STEP * 4.0
    found = guard.screen(angle, velocity)
    assert found.is_missing.tolist() == (angle[:, 0] > 0.0).tolist()
    assert not found.jump.any()


@pytest.mark.parametrize("step", [0.0, -0.01, np.nan, np.inf])
def test_impossible_steps_are_refused(step):
    with pytest.raises(InputError, match="step"):
        ImuSampleLimits.of(LANDER, step, TACTICAL_GYROSCOPES, TACTICAL_ACCELEROMETERS)
    with pytest.raises(InputError, match="step"):
        ImuOutlierDetector(LIMITS, step)


@pytest.mark.parametrize("slew", [-1.0, np.nan, np.inf])
def test_impossible_slews_are_refused(slew):
    with pytest.raises(InputError, match="slew"):
        ImuSampleLimits.of(LANDER, STEP, TACTICAL_GYROSCOPES, TACTICAL_ACCELEROMETERS, slew=slew)


@pytest.mark.parametrize("name", ["max_change", "max_noise", "maximum"])
@pytest.mark.parametrize("wrong", [np.nan, -1.0])
def test_impossible_limits_are_refused(name, wrong):
    with pytest.raises(InputError, match=f"limits.{name}"):
        ImuOutlierDetector(replace(LIMITS, **{name: np.full(6, wrong)}), STEP)


def test_missing_samples_let_the_lander_have_moved_meanwhile():
    rng = np.random.default_rng(6)
    guard = ImuOutlierDetector(LIMITS, STEP)
    angle, velocity = (np.zeros((60, 3)) for _ in range(2))
    angle[:, 0] = np.cumsum(np.full(60, 600.0 / 1100.0 * STEP)) * STEP
    angle += 1e-6 * rng.standard_normal((60, 3))
    angle[10:50] = np.nan
    found = guard.screen(angle, velocity)
    assert found.rejected == 0
    assert found.is_missing.sum() == 40


@pytest.mark.parametrize("limits", [LIMITS, ImuSampleLimits.unknown()])
@pytest.mark.parametrize("missing", [0, 1])
def test_a_sample_with_one_number_missing_counts_as_missing(limits, missing):
    given = np.zeros((20, 3)), np.full((20, 3), 0.01)
    given[missing][4, 1] = np.nan
    judged = ImuOutlierDetector(limits, STEP).screen(*given)
    assert list(np.flatnonzero(judged.is_missing)) == [4] and judged.rejected == 0


def test_without_a_vehicle_only_what_no_lander_can_do_is_refused():
    guard = ImuOutlierDetector(ImuSampleLimits.unknown(), STEP)
    angle, velocity = np.zeros((4, 3)), np.zeros((4, 3))
    angle[1, 2], velocity[2, 0] = 10.0 * STEP, 600.0 * STEP
    found = guard.screen(angle, velocity)
    assert found.is_missing.tolist() == [False, False, True, False]
    assert found.rejected == 1


def flown(which: str, axis: int, size: float, when: float) -> tuple[float, list[str]]:
    """Return the maximum error in sigmas up to 2 s after a spike, and the events."""
    scenario = Scenario.load(SCENARIO).changed(
        sensors={"flash": None}, tasking={"flash": None}, mappers={"dem": None},
        terrain={"size_m": 400.0},
    )  # fmt: skip
    simulation = Simulation(scenario, 4, None)
    navigation = simulation.computer.navigation
    honest, done = navigation.take, []

    def take(sensor: str, m: object, time: float) -> None:
        if isinstance(m, InertialSamples) and time >= when - 1e-9 and not done:
            done.append(time)
            array = getattr(m, which).copy()
            place = axis + (0 if which == "angle" else 3)
            limit = (LIMITS.max_change + LIMITS.max_noise)[place] * STEP
            array[4, axis] = array[3, axis] + size * limit
            m = replace(m, **{which: array})
        honest(sensor, m, time)

    navigation.take = take
    worst = 0.0
    while simulation.time < when + 2.0:
        simulation.move()
        worst = max(worst, float(np.abs(error(simulation)).max()))
    return worst, [name for _, name, _ in simulation.computer.telemetry]


def error(simulation: Simulation) -> np.ndarray:
    """Return errors of velocity and attitude in the site frame (6,), in sigmas."""
    found = simulation.computer.navigation.estimate_in_site(simulation.time, 1.0)
    state = simulation.state
    turn = quat_to_rotation_vector(quat_multiply(found.attitude, quat_conjugate(state.attitude)))
    off = np.concatenate((found.velocity - state.velocity, turn))
    return off / np.sqrt(np.diag(found.covariance)[3:])


@pytest.mark.parametrize("when", [0.1, 3.3])
@pytest.mark.parametrize(
    ("which", "axis", "size"),
    [("angle", 0, 0.98), ("angle", 2, -0.98), ("velocity", 0, 0.98), ("velocity", 2, -0.98),
     ("angle", 1, 1e3), ("velocity", 2, 1e2)],
)  # fmt: skip
def test_the_worst_spike_under_the_limit_is_no_silent_error(which, axis, size, when):
    """At both sides of the limit: rejections are reported, accepted samples are harmless."""
    worst, told = flown(which, axis, size, when)
    assert worst < 5.0
    assert "lost" not in told
    if abs(size) > 1.0:
        assert "samples-rejected" in told


def test_steps_of_the_converter_are_noise_too():
    fine, coarse = (
        ImuSampleLimits.of(
            LANDER, STEP, replace(TACTICAL_GYROSCOPES, quantum=q), TACTICAL_ACCELEROMETERS
        )
        for q in (0.0, 1e-4)
    )
    assert coarse.max_noise[:3] - fine.max_noise[:3] == pytest.approx(np.full(3, 2e-4 / STEP))
    assert coarse.max_noise[3:] == pytest.approx(fine.max_noise[3:])
