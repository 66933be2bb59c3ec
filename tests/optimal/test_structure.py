"""What Pontryagin's principle says of an optimum, on random descents."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Cone
from tests.optimal.cases import mars, moon


def check_structure(path) -> int:
    """Check one path; return how often its thrust switches."""
    d = path.descent
    assert path.loss < 1e-4, "the bound is the thrust: nothing was lost by relaxing"
    assert path.excess < 5e-4, "the thrust keeps its limits"
    middle = 0.5 * (d.thrust_min + d.thrust_max)
    span = 0.5 * (d.thrust_max - d.thrust_min)
    between = np.abs(path.forces - middle) < 0.98 * span
    high = path.forces[~between] > middle
    switches = int((high[1:] != high[:-1]).sum())
    # An interval in which the thrust switches has a share of both; so may each end of a phase on
    # the glideslope, where it is singular.
    assert between.sum() <= switches + 1, "at a limit but where it switches"
    return switches


def check_primer(path) -> None:
    """The primer is linear in time, thrust lies along it, the Hamiltonian is constant."""
    p = path.primer_vector
    curvature_guess = np.abs(np.diff(p, n=2, axis=0)).max() / np.abs(p).max()
    assert curvature_guess < 1e-5
    size = np.linalg.norm(path.thrust_acceleration, axis=1)
    along = np.einsum("ij,ij->i", path.thrust_acceleration, p) / (size * np.linalg.norm(p, axis=1))
    assert along.min() > 1.0 - 1e-5
    # Of the terms that make up H each is of the order of the thrust over mass.
    assert np.ptp(path.hamiltonian) < 0.1 * size.max()
    assert abs(path.hamiltonian.mean() + path.slope) < 1e-12


def structures(count: int, seed: int) -> list[int]:
    """Return the switches of so many random descents, each of them checked."""
    rng = np.random.default_rng(seed)
    planner, out = Planner(40), []
    while len(out) < count:
        path = minimize_propellant(planner, moon(rng, max_tilt=None, glideslope=None))
        check_primer(path)
        out.append(check_structure(path))
    return out


def test_thrust_switches_at_most_twice_between_its_limits():
    switches = structures(12, 3)
    assert max(switches) <= 2
    assert 1 in switches or 2 in switches


@pytest.mark.slow
def test_two_hundred_random_descents_are_bang_bang():
    switches = structures(200, 4)
    assert max(switches) <= 2


@pytest.mark.slow
def test_two_hundred_random_descents_within_tilt_and_glideslope():
    rng, planner, allow_lossy = np.random.default_rng(5), Planner(40), 0
    for _ in range(200):
        path = minimize_propellant(planner, moon(rng))
        size = np.linalg.norm(path.thrust_acceleration, axis=1)
        # On the glideslope the thrust may be singular, and the relaxation then loses a little.
        loose = path.bound > size * (1.0 + 1e-4)
        allow_lossy += loose.any()
        assert loose.sum() <= 2
        assert path.bound.max() * path.mass.min() < path.descent.thrust_max * 1.05
    assert allow_lossy <= 4


def test_the_hamiltonian_is_constant_and_zero_at_the_best_final_time():
    """The finer the intervals, the more so."""
    for descent, duration in ((mars(), 72.0), (moon(max_tilt=None, glideslope=None), 30.0)):
        coarse, fine = (
            np.ptp(Planner(n).at_time(descent, duration).hamiltonian) for n in (20, 160)
        )
        assert fine < 0.15 * coarse
        assert fine < 0.02 * descent.gravity
    best = minimize_propellant(Planner(80), mars())
    assert abs(best.slope) < 0.02 * 3.7114


def test_the_slope_is_the_derivative_of_the_cost():
    low, lean = np.deg2rad(4.0), np.deg2rad(25.0)
    plane = Cone(np.array([[-0.07, 0.0, 1.0]]))
    for descent, duration, intervals in (
        (mars(), 80.0, 40),
        (mars(glideslope=low, max_tilt=np.deg2rad(80.0)), 81.0, 40),
        (mars(glideslope=1.25 * low, dry_mass=1300.0), 79.46, 40),
        (moon(), 30.0, 40),
        (moon(max_tilt=lean), 34.0, 40),
        (moon(thrust_slack=400.0), 27.2, 40),
        # The coarser the intervals, the more of it is the planes'.
        (mars(cone=plane, dry_mass=1300.0), 82.0, 12),
    ):
        planner = Planner(intervals)
        here = planner.at_time(descent, duration)
        step = 3e-4 * duration
        costs = [
            planner.at_time(descent, duration + s, log_mass=here.log_mass).cost
            for s in (-step, step)
        ]
        here = planner.at_time(descent, duration, log_mass=here.log_mass)
        assert here.slope == pytest.approx((costs[1] - costs[0]) / (2.0 * step), rel=5e-3, abs=1e-3)
