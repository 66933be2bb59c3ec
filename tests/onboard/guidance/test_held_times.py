"""What a path takes whose time-to-go is given, against the same path sampled plainly."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import PathLimits, divert_cost
from lunarsim.onboard.guidance.polynomial_laws import EGuidanceLaw, ModifiedApolloLaw
from lunarsim.onboard.navigation.estimate import Estimate
from tests.reference import divert as plain

G = 1.622
LANDER, LIMITS = Lander(), PathLimits()
DOWN = np.array([0.0, 0.0, -2.0])
MARGIN = LIMITS.throttle_margin * (LANDER.thrust_max - LANDER.thrust_min)


def at(r, v, mass):
    r, v = np.asarray(r, float), np.asarray(v, float)
    return Estimate(0.0, r, v, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), mass, np.eye(9))


@pytest.mark.parametrize("law", [ApolloLaw(), EGuidanceLaw()])
def test_it_is_what_the_path_takes_within_all_limits(law):
    rng = np.random.default_rng(8)
    flown = refused = dry = 0
    for _ in range(12):
        height = rng.uniform(80.0, 400.0)
        r = np.array([*rng.uniform(-1.0, 1.0, 2) * height, height])
        v = np.array([*rng.normal(0.0, 8.0, 2), rng.uniform(-20.0, -3.0)])
        mass = rng.uniform(LANDER.dry_mass + LIMITS.reserve + 15.0, LANDER.wet_mass)
        sites = np.column_stack((rng.uniform(-0.8, 0.8, (12, 2)) * height, np.full(12, 12.0)))
        times = rng.uniform(8.0, 90.0, 12)
        cost = law.cost(at(r, v, mass), PhaseEnd(sites, DOWN), LANDER, G, LIMITS, times)
        for n, (site, time) in enumerate(zip(sites, times, strict=True)):
            wanted = plain.best(
                r, v, site, DOWN, np.zeros(3), [time], 24, G, mass, LANDER.exhaust_velocity,
                LANDER.thrust_min + MARGIN, LANDER.thrust_max - MARGIN, np.tan(LIMITS.max_tilt),
                np.tan(LIMITS.glideslope), np.tan(LIMITS.max_tilt), law.shape.powers,
            )  # fmt: skip
            burnt = mass * (1.0 - np.exp(-wanted[0] / LANDER.exhaust_velocity))
            held = burnt <= mass - LANDER.dry_mass - LIMITS.reserve
            dry += np.isfinite(wanted[0]) and not held
            assert cost.feasible[n] == (np.isfinite(wanted[0]) and held)
            if cost.feasible[n]:
                flown += 1
                assert cost.propellant[n] == pytest.approx(burnt, rel=1e-8)
                assert cost.time_to_go[n] == time
                assert cost.peak_thrust[n] == pytest.approx(wanted[2], rel=1e-8)
                assert np.tan(cost.peak_tilt[n]) == pytest.approx(wanted[3], rel=1e-8)
            else:
                refused += 1
                assert np.isnan(cost.time_to_go[n]) and cost.propellant[n] == np.inf
    assert flown > 20 and refused > 20 and dry > 2


def test_the_cheapest_time_takes_what_the_cheapest_path_takes():
    here = at([-200.0, 40.0, 260.0], [14.0, -3.0, -12.0], 1480.0)
    sites = np.array([[x, y, 12.0] for x in (-90.0, 0.0, 90.0) for y in (-60.0, 0.0, 60.0)])
    for law in (ApolloLaw(), ModifiedApolloLaw()):
        best = law.cost(here, PhaseEnd(sites, DOWN), LANDER, G)
        again = law.cost(here, PhaseEnd(sites, DOWN), LANDER, G, times=best.time_to_go)
        assert best.feasible.all()
        assert np.array_equal(best.propellant, again.propellant)
        # No other time is cheaper by more than the steps of the search.
        for share in (0.9, 1.1, 1.3):
            other = law.cost(here, PhaseEnd(sites, DOWN), LANDER, G, times=share * best.time_to_go)
            good = other.feasible
            assert (other.propellant[good] > best.propellant[good] * (1.0 - 5e-3)).all()


def test_no_time_undercuts_that_of_a_laws_own_limits_or_a_second():
    here = at([-200.0, 40.0, 260.0], [14.0, -3.0, -12.0], 1480.0)
    end = PhaseEnd(np.array([[0.0, 0.0, 12.0]]), DOWN)
    free, stiff = ApolloLaw(), ModifiedApolloLaw(jerk=0.03, snap=0.005)
    time = 0.5 * (free.cost(here, end, LANDER, G).time_to_go
                  + stiff.cost(here, end, LANDER, G).time_to_go)  # fmt: skip
    assert free.cost(here, end, LANDER, G, times=time).feasible.all()
    assert not stiff.cost(here, end, LANDER, G, times=time).feasible.any()
    # Half a second straight down at the speed that is wanted there: nothing but its length bars it.
    close = at([0.0, 0.0, 13.0], [0.0, 0.0, -2.0], 1480.0)
    for seconds, good in ((0.5, False), (1.0, True)):
        end = PhaseEnd(np.array([[0.0, 0.0, 13.0 - 2.0 * seconds]]), DOWN)
        cost = divert_cost(close, end, LANDER, G, times=np.array([seconds]))
        assert cost.feasible[0] == good
