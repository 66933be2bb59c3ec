"""Convexified and not: the same propellant."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.optimal.collocation import collocate
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from tests.optimal.cases import mars, moon


def gap(descent, duration=None) -> float:
    """Return by what share both ways differ."""
    planner = Planner(40)
    path = planner.at_time(descent, duration) if duration else minimize_propellant(planner, descent)
    return collocate(descent, 40, duration=duration).propellant / path.propellant - 1.0


def test_a_few_descents_take_the_same_propellant():
    assert abs(gap(mars(), 72.0)) < 1e-3
    assert abs(gap(moon(np.random.default_rng(1)))) < 1e-3


def test_what_comes_out_moves_by_its_own_thrust():
    """Integrated again with the thrust that it says, by Heun's rule."""
    d = mars()
    found = collocate(d, 30, duration=72.0)
    state = np.concatenate((d.position, d.velocity, [d.mass]))
    step = 72.0 / 30 / 200

    def rate(x, thrust):
        burn = np.linalg.norm(thrust) / d.exhaust_velocity
        return np.concatenate((x[3:6], thrust / x[6] - [0.0, 0.0, d.gravity], [-burn]))

    for thrust in np.repeat(found.thrust, 200, axis=0):
        first = rate(state, thrust)
        state = state + 0.5 * step * (first + rate(state + step * first, thrust))
    assert np.linalg.norm(state[:3]) < 0.05
    assert np.linalg.norm(state[3:6]) < 0.01
    assert state[6] == pytest.approx(d.mass - found.propellant, abs=1e-3)


@pytest.mark.slow
def test_fifty_random_descents_take_the_same_propellant():
    rng = np.random.default_rng(2)
    defects = np.array([gap(moon(rng)) for _ in range(50)])
    assert np.abs(defects).max() < 2e-3, defects


def test_what_it_does_not_know_is_refused_and_failures_are_reported():
    with pytest.raises(InputError, match="region"):
        collocate(mars(region=10.0))
    with pytest.raises(InputError, match="duration"):
        collocate(mars(), duration=-1.0)
    for duration in ("a", True, np.array([1.0, 2.0])):
        with pytest.raises(InputError, match="duration"):
            collocate(mars(), 10, duration=duration)
    for intervals in (0, 2.5, "a", None):
        with pytest.raises(InputError, match="intervals"):
            collocate(mars(), intervals)
    with pytest.raises(SolverError, match="IPOPT"):
        collocate(mars(), 10, max_iterations=2)
