"""Where the lander can still go, against brute force over times and samples."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import PathLimits, divert_cost
from lunarsim.onboard.guidance.paths import APOLLO, E_GUIDANCE, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from tests.reference import divert as plain

G = 1.622
LANDER = Lander()
LIMITS = PathLimits()
DOWN = np.array([0.0, 0.0, -2.0])
MARGIN = LIMITS.throttle_margin * (LANDER.thrust_max - LANDER.thrust_min)


def compared(shape: PathShape, states: int, cells: int, seed: int):
    """Return propellant of the survey and of brute force (states, cells)."""
    rng = np.random.default_rng(seed)
    ours, brute = np.empty((2, states, cells))
    for n in range(states):
        height = rng.uniform(60.0, 500.0)
        r = np.array([*rng.uniform(-1.0, 1.0, 2) * height, height])
        v = np.array([*rng.normal(0.0, 10.0, 2), rng.uniform(-20.0, 0.0)])
        mass = rng.uniform(LANDER.dry_mass + 30.0, LANDER.wet_mass)
        sites = np.column_stack((rng.uniform(-1.0, 1.0, (cells, 2)) * height, np.full(cells, 12.0)))
        here = Estimate(0.0, r, v, np.array([0, 0, 0, 1.0]), np.zeros(3), mass, np.eye(9))
        ours[n] = divert_cost(here, PhaseEnd(sites, DOWN), LANDER, G, shape=shape).propellant
        brute[n] = [
            plain.reachable(
                r, v, site, DOWN, np.zeros(3), G, mass, LANDER.exhaust_velocity,
                LANDER.thrust_min + MARGIN, LANDER.thrust_max - MARGIN, np.tan(LIMITS.max_tilt),
                np.tan(LIMITS.glideslope), LANDER.dry_mass + LIMITS.reserve, shape.powers,
            )
            for site in sites
        ]  # fmt: skip
    return ours, brute


def judge(ours, brute) -> None:
    reach, truly = np.isfinite(ours), np.isfinite(brute)
    assert 0.05 < truly.mean() < 0.95
    # Windows narrower than a step of the first look are missed, and dips between samples.
    assert (reach & ~truly).mean() < 0.01
    assert (truly & ~reach).mean() < 0.02
    both = reach & truly
    ratio = ours[both] / brute[both]
    assert np.median(ratio) < 1.002
    assert np.quantile(ratio, 0.99) < 1.03
    assert ratio.min() > 0.985


@pytest.mark.parametrize("shape", [APOLLO, E_GUIDANCE, PathShape(0.5, 1.2)])
def test_reach_and_cost_are_those_of_brute_force(shape):
    judge(*compared(shape, 20, 10, 3))


def test_a_site_beside_a_fast_low_lander_is_reached_slowly():
    """90 m up at 16 m/s: only paths of over a minute keep the glideslope to a site that is near."""
    r, v = np.array([0.0, 0.0, 90.0]), np.array([4.1, 15.4, -1.8])
    sites = np.array([[x, y, 12.0] for x in (-60.0, 0.0, 60.0) for y in (-80.0, -40.0, 0.0, 60.0)])
    here = Estimate(0.0, r, v, np.array([0, 0, 0, 1.0]), np.zeros(3), 1396.0, np.eye(9))
    ours = divert_cost(here, PhaseEnd(sites, DOWN), LANDER, G)
    brute = np.array([
        plain.reachable(
            r, v, site, DOWN, np.zeros(3), G, 1396.0, LANDER.exhaust_velocity,
            LANDER.thrust_min + MARGIN, LANDER.thrust_max - MARGIN, np.tan(LIMITS.max_tilt),
            np.tan(LIMITS.glideslope), LANDER.dry_mass + LIMITS.reserve, APOLLO.powers,
        )
        for site in sites
    ])  # fmt: skip
    assert np.isfinite(brute).all()
    assert ours.propellant == pytest.approx(brute, rel=0.01)
    gap = np.linalg.norm(sites - r, axis=1)
    assert (ours.time_to_go > 8.0 * gap / np.linalg.norm(v)).sum() >= 4


@pytest.mark.slow
@pytest.mark.parametrize("shape", [APOLLO, E_GUIDANCE])
def test_reach_over_a_thousand_states(shape):
    judge(*compared(shape, 1000, 100, 4))
