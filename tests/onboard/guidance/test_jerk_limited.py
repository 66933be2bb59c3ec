"""Time-to-go and fuel of ranked sites."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.jerk_limited import (
    delta_v,
    max_jerk_and_snap,
    min_times_to_go,
    site_cost,
)
from lunarsim.onboard.guidance.paths import APOLLO
from lunarsim.onboard.navigation.estimate import Estimate
from tests.reference import divert as plain

R, V = np.array([-300.0, 40.0, 200.0]), np.array([15.0, -2.0, -8.0])
END = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -1.0]))


def test_jerk_and_snap_are_the_derivatives_of_the_acceleration():
    path = APOLLO.path(R, V, END, 30.0)
    t = np.linspace(0.0, 30.0, 30_001)
    jerk = np.gradient(path.at(t)[2], t, axis=0)
    snap = np.gradient(jerk, t, axis=0)[2:-2]
    most, fourth = max_jerk_and_snap(path)
    assert most == pytest.approx(np.linalg.norm(jerk, axis=1).max(), rel=1e-3)
    assert fourth == pytest.approx(np.linalg.norm(snap, axis=1).max(), rel=1e-3)


@pytest.mark.parametrize(("jerk", "snap"), [(0.25, 9.0), (9.0, 0.05), (0.25, 0.05), (0.01, 0.01)])
def test_the_least_time_that_keeps_both_limits(jerk, snap):
    time = min_times_to_go(R, V, END, jerk=jerk, snap=snap)[0]
    j, s = max_jerk_and_snap(APOLLO.path(R, V, END, time))
    assert max(j / jerk, s / snap) == pytest.approx(1.0, abs=1e-4)
    for sooner in np.linspace(1.0, 0.999 * time, 50):
        j, s = max_jerk_and_snap(APOLLO.path(R, V, END, sooner))
        assert max(j / jerk, s / snap) > 1.0


@pytest.mark.parametrize(
    ("jerk", "snap", "pull"),
    [(0.25, 0.05, 0.0), (0.03, 9.0, 1.0), (9.0, 2e-3, 1.0), (0.1, 0.01, 1.0)],
)
def test_least_times_of_many_targets_are_those_of_quartics_one_by_one(jerk, snap, pull):
    """None that is a hundredth sooner and over a second keeps both limits."""
    rng = np.random.default_rng(6)
    targets = np.column_stack((rng.uniform(-300.0, 300.0, (37, 2)), rng.normal(0.0, 30.0, 37)))
    targets[20] = np.nan
    targets[36] = 1e9, 0.0, 0.0
    v_f, a_f = np.array([0.4, -0.3, -1.5]), pull * np.array([0.2, -0.1, 0.3])
    times = min_times_to_go(R, V, PhaseEnd(targets, v_f, a_f), jerk=jerk, snap=snap)
    assert np.flatnonzero(np.isnan(times)).tolist() == [20, 36]
    for target, time in zip(targets, times, strict=True):
        if np.isnan(time):
            continue
        j, s = plain.steepness(R, V, target, v_f, a_f, time)
        assert max(j / jerk, s / snap) == pytest.approx(1.0, rel=1e-9)
        for sooner in np.arange(0.99 * time, 1.0, -0.01 * time):
            j, s = plain.steepness(R, V, target, v_f, a_f, sooner)
            assert max(j / jerk, s / snap) > 1.0
    alone = min_times_to_go(R, V, PhaseEnd(targets[5], v_f, a_f), jerk=jerk, snap=snap)
    assert alone[0] == times[5]
    # One that keeps both at once gets the least time that is looked at.
    still = min_times_to_go(np.zeros(3), v_f, PhaseEnd(v_f, v_f), jerk=jerk, snap=snap)
    assert still[0] == 1.0


def test_increment_is_the_integral_of_equation_10():
    path = APOLLO.path(R, V, END, 30.0)
    whole = quad(
        lambda t: np.linalg.norm(path.at(t)[2] + [0.0, 0.0, 9.81]), 0.0, 30.0, epsabs=1e-9
    )[0]
    assert delta_v(path, 9.81) == pytest.approx(whole, rel=1e-9)
    # Hovering costs g times the time.
    still = APOLLO.path(np.zeros(3), np.zeros(3), PhaseEnd(np.zeros(3)), 12.0)
    assert delta_v(still, 1.622) == pytest.approx(12.0 * 1.622, rel=1e-12)


def test_sites_cost_propellant_by_the_rocket_equation():
    estimate = Estimate(0.0, R, V, np.array([0, 0, 0, 1.0]), np.zeros(3), 1800.0, np.eye(9))
    cost = site_cost(
        estimate, [[0.0, 0.0, 0.0], [20.0, 5.0, 0.0]], 9.81, 2157.0, jerk=0.25, snap=0.05
    )
    assert cost.propellant == pytest.approx(1800.0 * (1.0 - np.exp(-cost.delta_v / 2157.0)))
    assert (cost.time_to_go > 5.0).all()
    none = site_cost(estimate, np.zeros((0, 3)), 9.81, 2157.0, jerk=0.25, snap=0.05)
    assert len(none.propellant) == 0
    beyond = site_cost(estimate, [[1e7, 0.0, 0.0]], 9.81, 2157.0, jerk=1e-6, snap=1e-6)
    assert np.isinf(beyond.delta_v[0])
    assert np.isnan(beyond.time_to_go[0])


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"sites": [[np.nan, 0.0, 0.0]]}, "sites"),
        ({"sites": [[0.0, 0.0, np.inf]]}, "sites"),
        ({"gravity": np.nan}, "gravity"),
        ({"exhaust_velocity": np.nan}, "exhaust_velocity"),
        ({"exhaust_velocity": 0.0}, "exhaust_velocity"),
        ({"arrival_velocity": (0.0, 0.0, np.nan)}, "arrival_velocity"),
        ({"jerk": np.nan}, "jerk"),
    ],
)
def test_costs_of_what_is_no_number_are_refused(changes, field):
    estimate = Estimate(
        0.0, np.array(R), np.array(V), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1800.0,
        np.eye(9),
    )  # fmt: skip
    given = {"sites": [[0.0, 0.0, 0.0]], "gravity": 9.81, "exhaust_velocity": 2157.0,
             "jerk": 0.25, "snap": 0.05}  # fmt: skip
    with pytest.raises(InputError, match=f"guidance.{field}"):
        site_cost(estimate, **given | changes)
    lost = replace(estimate, position=np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(InputError, match=r"guidance\.estimate\.position\[0\]"):
        site_cost(lost, **given)


@pytest.mark.parametrize(("jerk", "snap"), [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0)])
def test_limits_must_be_positive(jerk, snap):
    with pytest.raises(InputError, match="guidance"):
        min_times_to_go(R, V, END, jerk=jerk, snap=snap)[0]
