from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, quad

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import PathLimits, divert_cost
from lunarsim.onboard.guidance.paths import APOLLO
from lunarsim.onboard.guidance.polynomial_laws import EGuidanceLaw
from lunarsim.onboard.navigation.estimate import Estimate

G = 1.622

LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


DOWN = np.array([0.0, 0.0, -2.0])


def loads(here, path):
    """Return thrust (N) and lean (rad) along a path, with the mass that is left (n,)."""
    t = np.linspace(0.0, path.time_to_go, 2001)
    pull = path.at(t)[2] + [0.0, 0.0, G]
    size = np.linalg.norm(pull, axis=1)
    burnt = cumulative_trapezoid(size, t, initial=0.0)
    return here.mass * np.exp(-burnt / LANDER.exhaust_velocity) * size, np.arccos(pull[:, 2] / size)


def admissible(here, path, end, limits):
    thrust, tilt = loads(here, path)
    margin = limits.throttle_margin * (LANDER.thrust_max - LANDER.thrust_min)
    r = path.at(np.linspace(0.0, path.time_to_go, 2001))[0] - end.position
    above = r[:, 2] - np.tan(limits.glideslope) * np.hypot(r[:, 0], r[:, 1])
    return (
        thrust.max() <= LANDER.thrust_max - margin
        and thrust.min() >= LANDER.thrust_min + margin
        and tilt.max() <= limits.max_tilt
        and above.min() >= -0.5
    )


def test_cost_is_the_fuel_integral_of_the_best_trajectory():
    here = estimate()
    end = PhaseEnd(np.array([0.0, 0.0, 12.0]), DOWN)
    cost = divert_cost(here, end, LANDER, G)
    path = APOLLO.path(here.position, here.velocity, end, cost.time_to_go[0])
    up = np.array([0.0, 0.0, G])
    dv = quad(lambda t: np.linalg.norm(path.at(t)[2] + up), 0.0, path.time_to_go)[0]
    propellant = here.mass * (1.0 - np.exp(-dv / LANDER.exhaust_velocity))
    assert cost.propellant[0] == pytest.approx(propellant, rel=1e-4)
    # No other admissible time-to-go is cheaper.
    for time_to_go in np.linspace(0.5, 2.0, 31) * cost.time_to_go[0]:
        other = APOLLO.path(here.position, here.velocity, end, time_to_go)
        if admissible(here, other, end, PathLimits()):
            size = np.linalg.norm(other.at(np.linspace(0.0, time_to_go, 2001))[2] + up, axis=1)
            assert np.mean(size) * time_to_go > 0.995 * dv


def test_admissible_trajectories_keep_their_limits():
    here = estimate()
    limits = PathLimits()
    sites = np.array([[x, y, 12.0] for x in (-40.0, 0.0, 40.0) for y in (0.0, 60.0)])
    cost = divert_cost(here, PhaseEnd(sites, DOWN), LANDER, G, limits=limits)
    assert cost.feasible.any()
    for n in np.flatnonzero(cost.feasible):
        path = APOLLO.path(
            here.position, here.velocity, PhaseEnd(sites[n], DOWN), cost.time_to_go[n]
        )
        thrust, tilt = loads(here, path)
        assert thrust.max() <= LANDER.thrust_max
        assert thrust.min() >= LANDER.thrust_min
        assert tilt.max() < limits.max_tilt + 0.01
        # Told at 25 instants, with the mass that is left by then.
        assert cost.peak_thrust[n] == pytest.approx(thrust.max(), rel=2e-3)
        assert cost.peak_tilt[n] == pytest.approx(tilt.max(), abs=2e-3)


def test_far_sites_and_empty_tanks_are_out_of_reach():
    far, near = (PhaseEnd(np.array([[x, 0.0, 12.0]]), DOWN) for x in (3000.0, 0.0))
    assert not divert_cost(estimate(), far, LANDER, G).feasible[0]
    dry = estimate(mass=LANDER.dry_mass + 16.0)
    assert not divert_cost(dry, near, LANDER, G).feasible[0]


def test_the_answer_for_a_site_does_not_depend_on_what_else_is_asked():
    rng = np.random.default_rng(4)
    sites = np.column_stack((rng.uniform(-1200.0, 1200.0, (40, 2)), np.full(40, 12.0)))
    together = divert_cost(estimate(), PhaseEnd(sites, DOWN), LANDER, G)
    assert 5 < together.feasible.sum() < 40
    for n, site in enumerate(sites):
        alone = divert_cost(estimate(), PhaseEnd(site, DOWN), LANDER, G)
        for name in ("propellant", "time_to_go", "peak_thrust", "peak_tilt"):
            a, b = getattr(alone, name)[0], getattr(together, name)[n]
            assert a == b or (np.isnan(a) and np.isnan(b)), (n, name)


def test_reserve_and_throttle_margin_are_kept():
    end = PhaseEnd(np.array([0.0, 0.0, 12.0]), DOWN)
    cost = divert_cost(estimate(), end, LANDER, G, limits=PathLimits(reserve=0.0))
    left = estimate().mass - LANDER.dry_mass - cost.propellant[0]
    assert divert_cost(estimate(), end, LANDER, G, limits=PathLimits(reserve=left - 0.01)).feasible[
        0
    ]
    assert not divert_cost(
        estimate(), end, LANDER, G, limits=PathLimits(reserve=left + 0.01)
    ).feasible[0]


@pytest.mark.parametrize("most_deg", [30.0, 12.0, 6.0])
def test_paths_end_within_the_final_tilt(most_deg):
    """E-guidance ends with any acceleration; with a limit it flies longer and uses more."""
    end = PhaseEnd(np.array([[x, y, 12.0] for x in (-40.0, 40.0) for y in (0.0, 30.0)]), DOWN)
    shape = EGuidanceLaw().shape
    free = divert_cost(estimate(), end, LANDER, G, shape=shape)
    limits = PathLimits(max_final_tilt=np.deg2rad(most_deg))
    cost = divert_cost(estimate(), end, LANDER, G, shape=shape, limits=limits)
    assert cost.feasible.all()
    assert (cost.propellant >= free.propellant * (1.0 - 1e-9)).all()
    tilts = []
    for found in (free, cost):
        for site, time in zip(end.position, found.time_to_go, strict=True):
            one = PhaseEnd(site, DOWN)
            path = shape.path(estimate().position, estimate().velocity, one, time)
            thrust = path.at(np.array([time]))[2][0] + np.array([0.0, 0.0, G])
            tilts.append(np.rad2deg(np.arctan2(np.hypot(*thrust[:2]), thrust[2])))
    assert max(tilts[4:]) <= most_deg + 1e-6
    assert max(tilts[:4]) > 12.0
