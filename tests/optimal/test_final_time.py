"""Final times that a search has to find: far from the first guess, or where the slope is level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.optimal.cone_program import FallbackSolver
from lunarsim.optimal.errors import InfeasibleError, RelaxationError, SolverError
from lunarsim.optimal.final_time import (
    is_flyable,
    minimize_landing_error,
    minimize_propellant,
    minimum_effort_time,
    remaining_log_mass,
    search_near,
    search_nearest_end,
)
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.transcription import HalfSpaces
from tests.optimal.cases import mars, moon

FAR = {"position": (2000.0, 500.0, 1500.0), "velocity": (100.0, 40.0, -75.0)}


def level_slope() -> Descent:
    """An engine that cannot hover at all: the slope is more than gravity and nearly constant."""
    return Descent(
        [-258.69, 129.53, 260.76], [7.0, -7.8, -102.18], 1153.886, np.zeros(3), np.zeros(3), 9.81,
        45301.9, 50335.4, 3138.03, 288.47, np.deg2rad(80.0), 0.22006, 0.5,
    )  # fmt: skip


def lean_little(tilt: float) -> Descent:
    """Thrust that leans little moves a lander aside slowly."""
    return Descent(
        [200.0, 0.0, 200.0], [0.0, 0.0, -5.0], 1500.0, np.zeros(3), [0.0, 0.0, -1.0], 1.622,
        0.0, 6000.0, 3050.0, 600.0, tilt,
    )  # fmt: skip


def effort(d: Descent, time: float) -> float:
    """Return the integral of the squared thrust over mass of the straight law to both ends."""
    gap = -d.displacement - d.velocity * time + 0.5 * np.array([0.0, 0.0, d.gravity]) * time**2
    speed = d.end_velocity - d.velocity + np.array([0.0, 0.0, d.gravity]) * time
    b = (6.0 * speed * time - 12.0 * gap) / time**3
    a = speed / time - 0.5 * b * time
    return float(a @ a * time + a @ b * time**2 + b @ b * time**3 / 3.0)


def test_the_first_final_time_is_that_of_least_effort():
    rng = np.random.default_rng(2)
    for _ in range(10):
        d = moon(rng, end_velocity=rng.normal(0.0, 5.0, 3))
        first = minimum_effort_time(d)
        assert effort(d, first) < min(effort(d, first * s) for s in (0.98, 1.02))
        far = np.linspace(0.3 * first, 3.0 * first, 60)
        assert effort(d, first) <= min(effort(d, t) for t in far)


def test_a_slope_that_hardly_changes_is_followed_to_its_end():
    """Direct collocation of 30 intervals takes 82.58 kg."""
    path = minimize_propellant(Planner(30), level_slope())
    assert path.propellant == pytest.approx(82.58, rel=2e-3)
    assert path.loss < 1e-3
    assert path.converged


def test_a_slow_descent_is_found_far_from_the_first_guess():
    d, planner = lean_little(np.deg2rad(0.5)), Planner(20)
    path = minimize_propellant(planner, d)
    assert path.miss < 0.1
    others = [planner.at_time(d, s * path.duration) for s in (0.97, 0.99, 1.01, 1.03)]
    assert path.propellant < 1.001 * min(p.propellant for p in others if p is not None)


@pytest.mark.parametrize("region", [383.5, 400.0])
def test_a_region_that_holds_the_nearest_end_is_reached(region):
    """The nearest end is 382.5 m off: few final times lead into a region little wider than that."""
    path = minimize_propellant(Planner(40), mars(**FAR, glideslope=np.deg2rad(4.0), region=region))
    assert path.miss < region + 0.01
    assert path.loss < 1e-3


def test_a_search_whose_solves_run_out_says_so():
    d = moon()
    far = 1.6 * minimum_effort_time(d)
    short = search_near(Planner(20), d, iter((far,)), max_solves=2)
    assert not short.converged
    assert search_near(Planner(20), d, iter((far,)), max_solves=16).converged


def test_solves_are_counted_from_the_first_final_time_that_can_be_flown():
    """What is spent on final times out of reach leaves the search as many as without them."""
    d, planner = moon(), Planner(20)
    first = minimize_propellant(planner, d).duration
    alone = search_near(planner, d, iter((1.2 * first,)), max_solves=3)
    found = search_near(planner, d, iter((0.5 * first, 0.6 * first, 1.2 * first)), max_solves=3)
    assert found.duration == alone.duration < 1.2 * first


class Moody(FallbackSolver):
    """A solver that gives up the first time."""

    def solve(self, program):
        answer = super().solve(program)
        first, self.met = not hasattr(self, "met"), True
        return replace(answer, status="failed") if first else answer


def test_a_failure_at_one_final_time_does_not_end_the_search():
    path = minimize_propellant(Planner(20, Moody), moon())
    assert path.delta_v == pytest.approx(minimize_propellant(Planner(20), moon()).delta_v, 1e-3)


def test_a_path_that_the_engine_cannot_fly_is_reported_not_returned():
    """An engine that can hardly be throttled: relaxed, thrust falls far below the least."""
    d = Descent(
        [-189.4, -133.6, 3431.6], [16.6, -19.0, -83.3], 11597.5, np.zeros(3), np.zeros(3), 9.81,
        250297.0, 255405.0, 2684.9, 1159.7, np.deg2rad(80.0), np.deg2rad(83.55),
        max_final_tilt=np.deg2rad(10.0),
    )  # fmt: skip
    with pytest.raises(RelaxationError, match="violates the thrust limits by"):
        minimize_propellant(Planner(20), d)
    assert issubclass(RelaxationError, SolverError)
    bound = minimize_propellant(Planner(20), d, allow_lossy=True)
    assert not is_flyable(bound)
    assert bound.excess > 0.05
    assert is_flyable(minimize_propellant(Planner(20), moon()))


def test_a_start_under_the_glideslope_is_out_of_reach_and_the_nearest_end_keeps_above():
    low = moon(position=(-600.0, 0.0, 60.0), velocity=(28.0, 0.0, 5.0))
    assert low.violates_glideslope
    assert not replace(low, region=400.0).violates_glideslope
    assert not moon().violates_glideslope
    with pytest.raises(InfeasibleError) as found:
        minimize_propellant(Planner(20), low)
    gap = low.position - found.value.nearest
    assert gap[2] + low.apex_depth > np.tan(low.glideslope) * abs(gap[0]) - 0.01
    assert found.value.miss > 200.0
    assert Planner(20).at_time(low, 30.0) is None


def test_the_nearest_end_is_that_of_all_the_thrust_there_is():
    fast = {"position": (-250.0, 0.0, 200.0), "velocity": (45.0, 0.0, -25.0)}
    short, spared = (
        search_nearest_end(Planner(20), moon(**fast, thrust_slack=s)) for s in (0.0, 400.0)
    )
    assert spared.miss < 1.0
    assert short.miss > 40.0


def test_of_all_ends_as_near_the_one_of_least_propellant_is_taken():
    low = moon(position=(-600.0, 0.0, 60.0), velocity=(28.0, 0.0, 5.0))
    near, best = search_nearest_end(Planner(20), low), minimize_landing_error(Planner(20), low)
    assert best.miss == pytest.approx(near.miss, rel=5e-3)
    assert best.delta_v < 0.98 * near.delta_v


def test_half_spaces_that_leave_no_way_are_not_answered_by_a_nearest_end_that_breaks_them():
    up = np.broadcast_to([0.0, 0.0, 1.0], (20, 1, 3))
    with pytest.raises(InfeasibleError, match="no end at that height") as found:
        minimize_propellant(
            Planner(20), moon(), half_spaces=HalfSpaces(up, np.full((20, 1), 2000.0))
        )
    assert found.value.nearest is None


def test_walls_that_stand_stay_where_they_are_while_the_end_moves():
    """A wall at x = -400 m stays there; one that goes with the end leaves no way to any."""
    n = 20
    east = np.broadcast_to([-1.0, 0.0, 0.0], (n, 1, 3))
    d = moon(position=np.array([-600.0, 0.0, 60.0]), velocity=np.array([28.0, 0.0, 5.0]))
    free = search_nearest_end(Planner(n), d)
    assert free.position[-1, 0] < -200.0
    offsets = np.full((n, 1), 400.0)
    path = search_nearest_end(Planner(n), d, half_spaces=HalfSpaces(east, offsets, moves=False))
    control = path.position[:-1, 0] + 0.5 * path.step * path.velocity[:-1, 0]
    assert control[1:-1].max() < -400.0 + 0.1
    assert search_nearest_end(Planner(n), d, half_spaces=HalfSpaces(east, offsets)) is None


def test_what_is_left_of_a_path_begins_where_it_is():
    path = minimize_propellant(Planner(20), mars(glideslope=0.0))
    left = remaining_log_mass(path, 0.5 * path.duration, 10)
    assert np.allclose(left, np.log(path.mass[10:-1] / path.mass[10]) - 0.5 * np.log(
        path.mass[10:-1] / path.mass[11:]), atol=1e-6)  # fmt: skip
    assert np.allclose(remaining_log_mass(path, 0.0, 20), path.log_mass, atol=1e-6)


@pytest.mark.parametrize("elapsed", [np.nan, -5.0, "a", None])
def test_a_time_elapsed_that_cannot_be_is_refused(elapsed):
    with pytest.raises(InputError, match=r"optimal\.elapsed"):
        minimize_propellant(Planner(20), moon(), elapsed=elapsed)
