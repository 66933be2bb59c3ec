"""Thrusters that do not push: noticed by what turns, never for nothing, and no longer ordered."""

import numpy as np
import pytest

from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.thruster_failure_detector import ThrusterFailureDetector

INERTIA = np.array([1350.0, 1350.0, 1550.0])
PERIOD = 0.1


def watched(dead, periods, *, from_period=0, steady=(0.0, 0.0, 0.0), known=0.0, seed=1):
    """Return a watch, and when it gave up which thrusters; pulses of a small random torque."""
    rng, jets = np.random.default_rng(seed), Thrusters()
    allocation, watch = ThrusterAllocation(jets), ThrusterFailureDetector(jets.count)
    found = []
    for n in range(periods):
        times = allocation.on_times(rng.normal(0.0, 12.0, 3), PERIOD)
        pushed = times.copy()
        if n >= from_period:
            pushed[list(dead)] = 0.0
        turns = times[:, None] * jets.torques / INERTIA
        engine = known * rng.normal(0.0, 1.0, 3)
        change = pushed @ (jets.torques / INERTIA) + PERIOD * np.array(steady) + engine
        change += rng.normal(0.0, 2e-4, 3)
        found += [(n, j) for j in watch.update(change, engine, turns, PERIOD)]
    return watch, found


@pytest.mark.parametrize("dead", [0, 3, 6, 13])
def test_one_that_is_dead_is_noticed_and_no_other(dead):
    watch, found = watched([dead], 600)
    assert [j for _, j in found] == [dead]
    assert found[0][0] < 200
    assert watch.failed == [dead]
    assert watch.effectiveness[dead] < 0.25
    others = np.delete(watch.effectiveness, dead)
    assert others == pytest.approx(np.ones(15), abs=0.25)


def test_one_that_dies_late_is_noticed_late():
    _, found = watched([5], 1_200, from_period=600)
    assert [j for _, j in found] == [5]
    assert 600 <= found[0][0] < 900


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_none_is_abandoned_without_a_reason(seed):
    steady = (0.01, -0.006, 0.003)
    watch, found = watched([], 3_000, steady=steady, known=2e-3, seed=seed)
    assert found == []
    assert watch.effectiveness == pytest.approx(np.ones(16), abs=0.2)
    assert (watch.sigma < 0.12).all()


def test_what_the_engine_turns_is_not_blamed_on_thrusters():
    """The same pulses with the engine's part left out are another story."""
    rng, jets = np.random.default_rng(4), Thrusters()
    watch = ThrusterFailureDetector(jets.count)
    jet = jets.torques[0] * 0.02 / INERTIA
    turns = np.zeros((16, 3))
    blamed, found = ThrusterFailureDetector(jets.count), []
    for _ in range(300):
        # A pulse now and then, each of which the engine undoes.
        turns[0] = jet * (rng.random() < 0.3)
        seen = rng.normal(0.0, 1e-4, 3)
        watch.update(seen, -turns[0], turns, PERIOD)
        found += blamed.update(seen, 0.0 * jet, turns, PERIOD)
    assert watch.effectiveness[0] == pytest.approx(1.0, abs=0.1)
    assert watch.failed == []
    assert found == [0]


@pytest.mark.parametrize("out", [[0], [2], [5, 11], [0, 1, 2, 3]])
def test_torques_are_made_without_the_dead(out):
    rng, jets = np.random.default_rng(2), Thrusters()
    left = ThrusterAllocation(jets, out)
    assert left.spans_all_torques
    for _ in range(50):
        torque = rng.normal(0.0, 15.0, 3)
        times = left.on_times(torque, 1.0)
        assert (times[out] == 0.0).all()
        # Pulses under half the shortest are left out.
        assert times @ jets.torques == pytest.approx(torque, abs=4.0)


def test_thrusters_that_cannot_turn_every_way_are_reported():
    up = [0, 4, 8, 12, 1, 5, 9, 13]  # all that push along body z
    assert not ThrusterAllocation(Thrusters(), up).spans_all_torques
    assert ThrusterAllocation(Thrusters()).spans_all_torques


def test_a_guess_is_no_outcome_and_what_is_not_seen_is_not_forgotten():
    """An estimate under a half is not enough while it may be wrong; doubt stops growing."""
    watch, nothing = ThrusterFailureDetector(16), np.zeros((16, 3))
    faint = nothing.copy()
    faint[3, 0] = 4e-3  # little beside the steady torque that there may be
    assert watch.update(np.array([-1e-3, 0.0, 0.0]), np.zeros(3), faint, PERIOD) == []
    assert watch.effectiveness[3] < 0.5
    idle = ThrusterFailureDetector(16)
    for _ in range(4_000):
        idle.update(np.zeros(3), np.zeros(3), nothing, PERIOD)
    assert idle.sigma == pytest.approx(np.full(16, 0.5), rel=1e-9)
    # What nobody can mistake: it was ordered, and nothing turned.
    clear = nothing.copy()
    clear[3] = 2e-2, -1e-2, 3e-2
    found = [watch.update(np.zeros(3), np.zeros(3), clear, PERIOD) for _ in range(12)]
    assert [j for new in found for j in new] == [3]
