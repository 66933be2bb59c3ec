"""Rigid bodies: the simulator's equations, two ways to one cost, and what the simulator flies."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.evaluation.open_loop import simulate_open_loop
from lunarsim.models.lander import Lander
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.six_dof import compiled_solver, successive
from lunarsim.optimal.six_dof.guess import initial_guess, remaining_guess
from lunarsim.optimal.six_dof.motion import (
    SHARES,
    control_units,
    interval_function,
    state_units,
    vehicle_parameters,
)
from lunarsim.optimal.six_dof.path import RigidPath, evaluate_violations
from lunarsim.optimal.six_dof.problem import RigidDescent, SiteVisibility
from lunarsim.optimal.six_dof.shooting import shoot
from lunarsim.optimal.six_dof.successive import SuccessiveConvexification
from lunarsim.optimal.units import Units
from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.state import State

N = 30


def start(rng: np.random.Generator) -> State:
    """Return a lander on its approach, which leans and turns a little and heads anywhere."""
    height = rng.uniform(150.0, 600.0)
    position = np.array([*rng.uniform(-1.0, 1.0, 2) * height, height])
    velocity = np.array(
        [*(-0.05 * position[:2] + rng.normal(0.0, 4.0, 2)), rng.uniform(-25.0, -5.0)]
    )
    lean = [rng.uniform(0.0, 360.0), *rng.normal(0.0, 8.0, 2)]
    attitude = Rotation.from_euler("zyx", lean, degrees=True).as_quat()
    return State(position, velocity, attitude, rng.normal(0.0, 0.017, 3), 1500.0, 2400.0)


def descent(rng: np.random.Generator, **changes) -> RigidDescent:
    """Return an approach of the default lander with all limits but sight."""
    given = {
        "lander": Lander(), "start": start(rng), "end_position": np.array([0.0, 0.0, 11.6]),
        "end_velocity": np.array([0.0, 0.0, -2.0]), "thrust_min": 1032.0, "thrust_max": 5568.0,
        "max_tilt": np.deg2rad(40.0), "max_rate": np.deg2rad(15.0), "glideslope": np.deg2rad(8.0),
    }  # fmt: skip
    return RigidDescent(**{**given, **changes})


def held(d: RigidDescent, path: RigidPath) -> None:
    """Check a path by what the simulator makes of its commands."""
    found = evaluate_violations(d, *simulate_open_loop(path))
    assert found.miss < 0.05 and found.velocity < 0.01, found
    assert np.rad2deg([found.final_tilt, found.final_rate]).max() < 0.05, found
    assert np.rad2deg([found.tilt, found.rate]).max() < 0.3, found
    assert found.glideslope < 0.0 and np.rad2deg(found.sight) < 0.5, found


@pytest.mark.parametrize("lag", [0.0, 0.1, 1.0])
def test_an_interval_moves_a_body_as_the_simulator_does(lag):
    rng = np.random.default_rng(4)
    for _ in range(5):
        d = descent(rng, lander=Lander(thrust_lag=lag))
        units = Units(rng.uniform(100.0, 900.0), rng.uniform(10.0, 40.0), 1400.0)
        thrust, torque = rng.uniform(1000.0, 5500.0), rng.uniform(-150.0, 150.0, 3)
        dynamics = Dynamics(d.lander, d.gravity, step=0.0025)
        state = d.start
        for _ in range(400):
            state = dynamics.advance(state, thrust, torque)
        states = np.asarray(
            interval_function()(
                d.start.as_vector() / state_units(units),
                np.array([thrust, *torque]) / control_units(units), 1.0 / units.time,
                vehicle_parameters(d, units),
            )
        )  # fmt: skip
        off = states[:, -1] * state_units(units) - state.as_vector()
        # Within a step the thrust is its mean: that moves the body by no more than a centimetre.
        assert np.abs(off[:3]).max() < 1e-2 and np.abs(off[3:6]).max() < 1e-3
        assert np.abs(off[6:13]).max() < 1e-6 and abs(off[13]) < 1e-4 and abs(off[14]) < 0.2
        assert states.shape == (15, len(SHARES))


def test_both_ways_take_the_same_propellant_and_the_simulator_flies_it():
    rng = np.random.default_rng(1)
    programs = SuccessiveConvexification(N)
    for near in (1e-3, 5e-3):  # the first settles where programs save nothing more
        d = descent(rng)
        first, second = shoot(d, N), programs.solve(d)
        assert second.propellant == pytest.approx(first.propellant, rel=near)
        point = minimize_propellant(Planner(N), d.as_point()).propellant
        # A body that has to turn cannot do better than a point, but for the end's cone of tilt.
        assert first.propellant > 0.995 * point
        held(d, first)
        held(d, second)


def test_a_sensor_sees_the_site_for_as_long_as_it_is_asked_to():
    d = descent(np.random.default_rng(2))
    constrained = replace(
        d, sight=SiteVisibility(np.array([0.0, 0.0, -1.0]), np.deg2rad(55.0), 0.6)
    )
    free, path = (
        SuccessiveConvexification(N).solve(d),
        SuccessiveConvexification(N).solve(constrained),
    )
    assert (
        np.rad2deg(evaluate_violations(constrained, *simulate_open_loop(free)).sight) > 5.0
    )  # nobody asked
    held(constrained, path)
    assert path.propellant > 1.1 * free.propellant


def test_a_tighter_limit_costs_more_and_the_guess_may_be_an_answer():
    d = descent(np.random.default_rng(3))
    free = SuccessiveConvexification(N).solve(d)
    slow = SuccessiveConvexification(N).solve(replace(d, max_rate=np.deg2rad(6.0)))
    assert slow.propellant > free.propellant
    assert evaluate_violations(slow.descent, *simulate_open_loop(slow)).rate == pytest.approx(
        0.0, abs=2e-3
    )  # all of it is had
    weak = SuccessiveConvexification(N).solve(replace(d, torque_share=0.1))
    share = np.abs(weak.torque).max(axis=0) / np.asarray(d.lander.torque_max)
    assert share.max() == pytest.approx(0.1, rel=1e-3)
    held(weak.descent, weak)
    guess = initial_guess(d, 12)
    assert len(guess.resample(N).thrust) == N
    again = SuccessiveConvexification(N).solve(d, guess)
    assert again.propellant == pytest.approx(free.propellant, rel=5e-3)


def test_what_cannot_be_is_refused():
    rng = np.random.default_rng(5)
    for changes, name in (
        ({"max_tilt": -0.1}, "max_tilt"), ({"max_rate": 0.0}, "max_rate"),
        ({"thrust_max": 9000.0}, "thrust_max"), ({"thrust_min": 5600.0}, "thrust_max"),
        ({"torque_share": 1.5}, "torque_share"), ({"gravity": np.nan}, "gravity"),
        ({"end_position": [0.0, np.nan, 0.0]}, "end_position"), ({"reserve": 400.0}, "mass"),
        ({"apex_depth": -1.0}, "apex_depth"), ({"glideslope": 2.0}, "glideslope"),
        ({"start": State(np.full(3, np.nan), np.zeros(3), np.array([0, 0, 0, 1.0]), np.zeros(3),
                         1500.0)}, r"start\.position\[0\]: must be finite, got nan"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=name):
            descent(rng, **changes)
    far = descent(rng, max_tilt=None, max_rate=None, glideslope=None)
    ahead = SiteVisibility(np.array([1.0, 0.0, 0.0]), 0.01)
    for changes, name in (
        ({"max_tilt": 1e-3}, "start.attitude"), ({"max_rate": 1e-4}, "start.rate"),
        ({"glideslope": 1.55}, "start.position"), ({"sight": ahead}, "sight.half_angle"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=name):
            replace(far, **changes)
    for axis, half, share in (([0, 0, 0], 0.5, 0.5), ([0, 0, 1], 0.0, 0.5), ([0, 0, 1], 0.5, 0.0)):
        with pytest.raises(InputError, match="sight"):
            SiteVisibility(np.array(axis, dtype=float), half, share)
    for intervals in (1, 3, "a", 2.5, True):
        for solve in (shoot, lambda d, n: SuccessiveConvexification(n)):
            with pytest.raises(InputError, match="intervals"):
                solve(far, intervals)
    for max_programs in (0, 1.5, None):
        with pytest.raises(InputError, match="max_programs"):
            SuccessiveConvexification(N, max_programs)
    for changes, name in (
        ({"lander": None}, "lander"), ({"start": None}, "start"), ({"start": 3}, "start"),
        ({"gravity": "a"}, "gravity"), ({"max_tilt": True}, "max_tilt"),
        ({"reserve": np.nan}, "reserve"), ({"thrust_min": "a"}, "thrust_max"),
        ({"end_position": "a"}, "end_position"), ({"max_rate": "a"}, "max_rate"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=name):
            replace(far, **changes)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        (("a", 0.5), "axis"), (((0.0, 0.0, 0.0), 0.5), "axis"), (((0.0, 0.0, -1.0), "a"), "half_"),
        (((0.0, 0.0, -1.0), True), "half_"), (((0.0, 0.0, -1.0), 0.5, None), "visible_fraction"),
    ],
)  # fmt: skip
def test_a_sensor_that_cannot_be_is_refused_by_name(given, field):
    with pytest.raises(InputError, match=rf"optimal\.sight\.{field}"):
        SiteVisibility(*given)


def test_what_is_no_sensor_is_refused():
    with pytest.raises(InputError, match=r"optimal\.sight: must be a SiteVisibility or None"):
        descent(np.random.default_rng(1), sight=3)


@pytest.mark.slow
def test_neither_way_burns_what_is_to_be_kept():
    """A path that takes 3 % more than there is lands nowhere, though the guess would."""
    d = descent(np.random.default_rng(1))
    free, guess = SuccessiveConvexification(N).solve(d), initial_guess(d, N)
    held_back = d.start.mass - d.lander.dry_mass - free.propellant
    roomy = replace(d, reserve=held_back - 0.01 * free.propellant)
    path = SuccessiveConvexification(N).solve(roomy, guess)
    assert path.states[-1, 13] >= roomy.dry_mass
    assert path.propellant == pytest.approx(free.propellant, rel=1e-3)
    short = replace(d, reserve=held_back + 0.03 * free.propellant)
    with pytest.raises(SolverError):
        shoot(short, N, guess=guess)
    with pytest.raises(SolverError):
        SuccessiveConvexification(N, max_programs=12).solve(short, guess)


def test_a_path_is_given_only_once_its_intervals_are_joined(monkeypatch):
    """Paths of made gaps, that all burn alike: the first that is joined is given."""

    def point(apart, passed=0.0):
        return SimpleNamespace(
            propellant_used=0.1, max_defect=apart, violation=passed, x=np.zeros((2, 15)),
            merit=0.1 + apart + passed,
        )  # fmt: skip

    for row, given in (
        ((1e-3, 1e-4, 1e-6, 0.0), 2), ((1e-3, 1e-6, 0.0), 1),
        ((1e-3, (1e-6, 0.02), 1e-6), 2),
    ):  # fmt: skip
        made = [point(*np.atleast_1d(p)) for p in row]
        programs = SuccessiveConvexification(N)
        monkeypatch.setattr(programs, "_layout", SimpleNamespace(
            build=lambda *given: None, split=lambda *given: (None, None, None)))  # fmt: skip
        monkeypatch.setattr(programs, "_solve", lambda program: np.zeros(1))
        coming = iter(made)
        monkeypatch.setattr(successive.LinearisedPath, "at", lambda *given, c=coming: next(c))
        path, count = programs.iterate(None, point(2e-3))
        assert path is made[given]
        assert count == given + 1


def test_failures_of_solvers_are_reported():
    d = descent(np.random.default_rng(1))
    with pytest.raises(SolverError, match="IPOPT"):
        shoot(d, N, max_iterations=2)
    with pytest.raises(SolverError, match="does not converge in 1 programs"):
        SuccessiveConvexification(N, max_programs=1).solve(d)


def test_without_a_compiler_it_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert compiled_solver.find_compiler() is None
    with pytest.raises(InputError, match="compiler"):
        compiled_solver.compiled_library("none", lambda: None)


def test_a_path_is_solved_for_again_from_where_it_has_led():
    d = descent(np.random.default_rng(1))
    programs = SuccessiveConvexification(N)
    path = programs.solve(d)
    times, states = simulate_open_loop(path)
    here = replace(d, start=State.from_vector(states[np.searchsorted(times, 2.0)]))
    left = remaining_guess(path, 2.0)
    again = programs.solve(here, left)
    rest = path.propellant - (path.states[0, 13] - here.start.mass)
    # Other nodes: what commands are held over is not the same.
    assert again.propellant == pytest.approx(rest, rel=0.02)
    assert again.duration == pytest.approx(path.duration - 2.0, rel=0.05)
    held(here, again)
    with pytest.raises(InputError, match="elapsed"):
        remaining_guess(path, path.duration)


@pytest.mark.slow
def test_a_compiled_program_gives_the_same_path(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    d = descent(np.random.default_rng(1))
    plain, fast = shoot(d, 12), shoot(d, 12, compiled=True)
    assert fast.propellant == pytest.approx(plain.propellant, rel=1e-6)
    assert [p.suffix for p in (tmp_path / "lunarsim" / "optimal").iterdir()] == [".so"]


@pytest.mark.slow
def test_thirty_descents_take_the_same_propellant_both_ways():
    rng, programs, defects = np.random.default_rng(6), SuccessiveConvexification(N), []
    for k in range(30):
        d = descent(rng)
        if k % 3 == 0:
            d = replace(d, sight=SiteVisibility(np.array([0.0, 0.0, -1.0]), np.deg2rad(65.0), 0.4))
        first, second = shoot(d, N), programs.solve(d)
        held(d, first)
        held(d, second)
        defects.append(second.propellant / first.propellant - 1.0)
    assert np.abs(defects).max() < 5e-3, defects
