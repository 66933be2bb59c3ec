"""Programs that are updated, solvers that fail, and what is asked amiss."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.optimal.cone_program import (
    ClarabelSolver,
    FallbackSolver,
    QocoOnlySolver,
    QocoSolver,
    SolverResult,
)
from lunarsim.optimal.errors import InfeasibleError, SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Cone
from lunarsim.optimal.transcription import HalfSpaces, ProgramStructure
from tests.optimal.cases import mars, moon


def test_an_updated_program_is_solved_as_one_made_again_and_by_another_solver():
    rng = np.random.default_rng(7)
    kept, other = Planner(30), Planner(30, ClarabelSolver)
    for _ in range(4):
        descent = moon(rng, mass=rng.uniform(1300.0, 1500.0))
        duration = minimize_propellant(kept, descent).duration
        paths = [p.at_time(descent, duration) for p in (kept, Planner(30), other)]
        for path in paths[1:]:
            assert path.delta_v == pytest.approx(paths[0].delta_v, rel=1e-6)
            assert np.allclose(path.position, paths[0].position, atol=0.1)
            assert path.slope == pytest.approx(paths[0].slope, abs=0.02)


def test_flights_repeat_bit_for_bit():
    """Whatever was solved before by another planner."""
    rng = np.random.default_rng(8)
    descents = [moon(rng) for _ in range(3)]
    runs = []
    for _ in range(2):
        planner = Planner(25)
        runs.append(
            [minimize_propellant(planner, d).thrust_acceleration.tobytes() for d in descents]
        )
        minimize_propellant(Planner(25), mars())
    assert runs[0] == runs[1]


def test_a_path_keeps_everything_between_its_nodes():
    d = moon()
    path = minimize_propellant(Planner(40), d)
    t = np.linspace(0.0, path.duration, 4001)
    r, v, push = path.at(t)
    gap = r - d.end_position
    above = gap[:, 2] + d.apex_depth - np.tan(d.glideslope) * np.hypot(gap[:, 0], gap[:, 1])
    assert above[t > path.step].min() > -1e-3
    tilt = np.arccos(push[:, 2] / np.linalg.norm(push, axis=1))
    assert tilt.max() < d.max_tilt + 1e-5
    force = path.mass_at(t) * np.linalg.norm(push, axis=1)
    assert force.max() < d.thrust_max * 1.01
    assert force.min() > d.thrust_min * 0.99
    assert np.allclose(r[-1], d.end_position, atol=1e-3)
    assert np.allclose(v[-1], d.end_velocity, atol=1e-4)
    assert np.allclose(np.gradient(r, t, axis=0)[1:-1], v[1:-1], atol=0.02)
    assert path.mass_at(path.duration) == pytest.approx(path.mass[-1])


def test_a_glideslope_that_binds_is_kept_between_the_nodes():
    """The path touches the cone; asked of its nodes alone it would sag through."""
    slope = np.deg2rad(4.0)
    path = Planner(20).at_time(mars(glideslope=slope), 81.0)
    r = path.at(np.linspace(0.0, path.duration, 2001))[0]
    above = r[:, 2] - np.tan(slope) * np.hypot(r[:, 0], r[:, 1])
    assert above.min() > -1e-3
    control = path.position[:-1] + 0.5 * path.step * path.velocity[:-1]
    skims = control[:, 2] - np.tan(slope) * np.hypot(control[:, 0], control[:, 1]) < 0.05
    assert skims[1:-1].any()


def test_a_last_solution_leaves_four_solves_at_most():
    planner = Planner(40)
    first = minimize_propellant(planner, moon())
    worst = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        r, v, _ = first.at(1.0)
        here = moon(
            position=r + rng.normal(0.0, 0.5, 3), velocity=v + rng.normal(0.0, 0.1, 3),
            mass=float(first.mass_at(1.0)),
        )  # fmt: skip
        warm = minimize_propellant(planner, here, last=first, elapsed=1.0)
        cold = minimize_propellant(planner, here)
        worst = max(worst, warm.solves)
        assert warm.delta_v == pytest.approx(cold.delta_v, rel=1e-3)
    assert worst <= 4


def test_the_end_may_have_to_be_upright():
    upright = minimize_propellant(Planner(40), moon(max_final_tilt=np.deg2rad(5.0)))
    free = minimize_propellant(Planner(40), moon())
    tilts = [
        np.arccos(p.thrust_acceleration[-1, 2] / np.linalg.norm(p.thrust_acceleration[-1]))
        for p in (upright, free)
    ]
    assert tilts[0] < np.deg2rad(10.0) < np.deg2rad(30.0) < tilts[1]
    assert free.delta_v < upright.delta_v < 1.05 * free.delta_v


def test_spare_thrust_is_left_alone_while_there_is_another_way():
    calm = minimize_propellant(Planner(40), moon(thrust_slack=400.0))
    assert calm.forces.max() < 5568.0 * (1.0 + 1e-4)
    planner = Planner(40)
    short = 0.96 * calm.duration
    assert planner.at_time(moon(), short) is None
    hard = planner.at_time(moon(thrust_slack=400.0), short)
    assert 5568.0 * 1.002 < hard.forces.max() < 5968.0


def test_spare_thrust_has_its_price_and_counts_among_the_limits():
    hard = Planner(40).at_time(moon(thrust_slack=400.0, thrust_slack_penalty=8.0), 26.8)
    share = (hard.forces.max() - 5568.0) / 400.0
    assert 0.05 < share < 1.0
    assert hard.cost - hard.delta_v == pytest.approx(8.0 * share, rel=0.02)
    assert hard.excess < 1e-3
    tight = replace(hard, descent=moon(thrust_slack=0.5 * share * 400.0))
    assert tight.excess == pytest.approx(0.5 * share * 400.0 / 5568.0, rel=0.02)


def test_tips_under_the_end_are_the_drop_lower():
    slope = np.deg2rad(4.0)
    path = Planner(20).at_time(mars(glideslope=slope, apex_depth=12.0), 81.0)
    gap = path.position[:-1] + 0.5 * path.step * path.velocity[:-1]
    above = gap[:, 2] - np.tan(slope) * np.hypot(gap[:, 0], gap[:, 1])
    assert above[1:-1].min() == pytest.approx(-12.0, abs=0.05)
    planes = Cone(np.array([[-0.09, 0.0, 1.0], [0.0, 0.0, 1.0]]), 12.0)
    path = Planner(20).at_time(mars(cone=planes, dry_mass=1300.0), 81.0)
    gap = path.position[:-1] + 0.5 * path.step * path.velocity[:-1]
    assert (gap @ planes.normals.T)[1:-1].min() == pytest.approx(-12.0, abs=0.05)


def test_masses_that_are_off_are_solved_for_again():
    """Taken as they are, limits of thrust would be off by as much."""
    planner, none = Planner(20), np.zeros(20)
    path = planner.at_time(moon(), 30.0, log_mass=none)
    assert path.solves == planner.solves == 2
    exact = planner.at_time(moon(), 30.0, log_mass=path.log_mass)
    assert exact.solves == 1
    assert path.delta_v == pytest.approx(exact.delta_v, rel=1e-5)


class Failing:
    """A solver that gives up."""

    def solve(self, program):
        nothing = np.zeros(0)
        return SolverResult("failed", nothing, nothing, nothing, 7, "failing")


def test_infeasible_and_failed_are_distinguished():
    with pytest.raises(SolverError, match="failing fails after 7 iterations"):
        minimize_propellant(Planner(20, Failing), moon())
    assert Planner(20).at_time(moon(), 5.0) is None
    with pytest.raises(SolverError, match="qoco fails after 2"):
        Planner(20, lambda: QocoSolver(2)).at_time(moon(), 30.0)
    assert Planner(20, lambda: QocoOnlySolver(2)).at_time(moon(), 30.0) is None
    fallback_count = FallbackSolver(2)
    path = Planner(20, lambda: fallback_count).at_time(moon(), 30.0)
    assert path.solver == "clarabel"
    assert fallback_count.fallback_count >= 1
    below = moon(position=np.array([-600.0, 0.0, 5.0]))
    with pytest.raises(InfeasibleError):
        minimize_propellant(Planner(20), below)


class Stuck(ClarabelSolver):
    """A judge that fails at what it is asked first."""

    met = 0

    def solve(self, program):
        self.met += 1
        answer = super().solve(program)
        return replace(answer, status="failed") if self.met == 1 else answer


@pytest.mark.parametrize(("duration", "why"), [(30.0, SolverError), (5.0, None)])
def test_a_judge_that_fails_is_asked_whether_wider_cones_hold_something(duration, why):
    """Nothing is told infeasible that is not proven so."""
    judged = FallbackSolver(2)
    judged.fallback = Stuck()
    planner = Planner(20, lambda: judged)
    if why is None:
        assert planner.at_time(moon(), duration) is None
    else:
        with pytest.raises(why, match="clarabel fails"):
            planner.at_time(moon(), duration)
    assert judged.fallback.met == 2


def test_after_a_failure_the_solver_begins_again():
    planner = Planner(20, QocoOnlySolver)
    before = planner.at_time(moon(), 30.0)
    assert planner.at_time(moon(), 5.0) is None
    after = planner.at_time(moon(), 30.0)
    assert after.thrust_acceleration.tobytes() == before.thrust_acceleration.tobytes()


def test_infeasible_errors_travel_between_processes():
    error = InfeasibleError(np.zeros(3), "why", np.array([3.0, 4.0, 0.0]))
    again = pickle.loads(pickle.dumps(error))
    assert (again.miss, str(again)) == (5.0, str(error))
    assert "(3.0, 4.0, 0.0), 5.0 m away" in str(again)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"position": np.array([np.nan, 0.0, 1.0])}, "position"),
        ({"velocity": np.zeros(2)}, "velocity"),
        ({"mass": np.nan}, "mass"),
        ({"mass": 1000.0}, "mass"),
        ({"gravity": 0.0}, "gravity"),
        ({"thrust_min": 6000.0}, "thrust_min"),
        ({"thrust_max": np.inf}, "thrust_max"),
        ({"dry_mass": -1.0}, "dry_mass"),
        ({"max_tilt": 1.6}, "max_tilt"),
        ({"glideslope": -0.1}, "glideslope"),
        ({"max_final_tilt": np.nan}, "max_final_tilt"),
        ({"tilt_rate": np.nan}, "tilt_rate"),
        ({"region": np.inf}, "region"),
        ({"region": 5.0, "thrust_slack": 10.0}, "thrust_slack"),
        ({"mass": "abc"}, "mass"),
        ({"mass": None}, "mass"),
        ({"mass": True}, "mass"),
        ({"mass": 1 + 2j}, "mass"),
        ({"position": "abc"}, "position"),
        ({"position": None}, "position"),
        ({"position": [1.0, [2.0], 3.0]}, "position"),
        ({"position": [True, False, True]}, "position"),
        ({"thrust_min": None}, "thrust_min"),
        ({"thrust_min": np.array([1.0, 2.0])}, "thrust_min"),
        ({"max_tilt": "40"}, "max_tilt"),
        ({"max_tilt": True}, "max_tilt"),
        ({"glideslope": [0.1]}, "glideslope"),
        ({"region": True}, "region"),
        ({"thrust_slack_penalty": np.nan}, "thrust_slack_penalty"),
        ({"cone": 3}, "cone"),
        ({"position": np.array([1e200, 0.0, 1e200])}, "position"),
        ({"velocity": np.array([1e300, 0.0, 0.0])}, "velocity"),
        ({"gravity": 1e300}, "gravity"),
        ({"thrust_max": 1e200}, "thrust_max"),
        ({"region": 1e200}, "region"),
        ({"cone": np.eye(3)}, "cone"),
    ],
)
def test_bad_problems_are_refused_by_name(changes, field):
    with pytest.raises(InputError, match=f"optimal.{field}"):
        moon(**changes)


def test_bad_times_cones_and_grids_are_refused():
    for duration in (0.0, -3.0, 1e300, np.nan, np.inf, "a", None, True, np.array([30.0, 31.0])):
        with pytest.raises(InputError, match="duration"):
            Planner(20).at_time(moon(), duration)
    for intervals in (3, "a", None, True, np.inf, 8.0):
        with pytest.raises(InputError, match="intervals"):
            Planner(intervals).at_time(moon(), 30.0)
    for masses in (np.zeros(3), np.full(20, np.nan), "a"):
        with pytest.raises(InputError, match="log_mass"):
            Planner(20).at_time(moon(), 30.0, log_mass=masses)
    with pytest.raises(InputError, match="half_spaces"):
        Planner(20).at_time(
            moon(), 30.0, half_spaces=HalfSpaces(np.ones((5, 1, 3)), np.zeros((5, 1)))
        )
    with pytest.raises(InputError, match="half_spaces"):
        HalfSpaces(np.ones((5, 1, 3)), np.zeros((5, 2)))
    with pytest.raises(InputError, match="thrust_slack"):
        ProgramStructure(20, True, True, 0, True, thrust_slack=True)
    with pytest.raises(InputError, match="cone"):
        Cone(np.zeros((0, 3)))
    with pytest.raises(InputError, match="cone"):
        Cone(np.array([[np.nan, 0.0, 1.0]]))
    for normals, depth in (("a", 0.0), (np.eye(3), -1.0), (np.eye(3), "a"), (None, 0.0)):
        with pytest.raises(InputError, match="cone"):
            Cone(normals, depth)
