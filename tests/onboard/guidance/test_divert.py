from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance import DivertLimits
from lunarsim.onboard.guidance.apollo import terminal_polynomial
from lunarsim.onboard.guidance.divert import divert_cost
from lunarsim.onboard.navigation import Estimate
from lunarsim.sensors.rendering.target import Target

G = 1.622

LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def test_cost_is_the_fuel_integral_of_the_best_trajectory():
    here = estimate()
    site = np.array([0.0, 0.0, 12.0])
    cost = divert_cost(here, site, LANDER, G)
    target = Target(site, np.array([0.0, 0.0, -2.0]))
    path = terminal_polynomial(here.position, here.velocity, target, cost.time_to_go[0])
    up = np.array([0.0, 0.0, G])
    dv = quad(lambda t: np.linalg.norm(path.at(t)[2] + up), 0.0, path.time_to_go)[0]
    propellant = here.mass * (1.0 - np.exp(-dv / LANDER.exhaust_velocity))
    assert cost.propellant[0] == pytest.approx(propellant, rel=1e-4)


def test_admissible_trajectories_keep_their_limits():
    here = estimate()
    limits = DivertLimits()
    sites = np.array([[x, y, 12.0] for x in (-40.0, 0.0, 40.0) for y in (0.0, 60.0)])
    cost = divert_cost(here, sites, LANDER, G, limits=limits)
    assert cost.feasible.any()
    for site, time_to_go in zip(sites[cost.feasible], cost.time_to_go[cost.feasible], strict=True):
        path = terminal_polynomial(
            here.position, here.velocity, Target(site, np.array([0.0, 0.0, -2.0])), time_to_go
        )
        thrust = path.at(np.linspace(0.0, time_to_go, 300))[2] + [0.0, 0.0, G]
        size = np.linalg.norm(thrust, axis=1) * here.mass
        assert size.max() <= LANDER.thrust_max
        assert size.min() >= LANDER.thrust_min
        assert (
            np.arccos(thrust[:, 2] / np.linalg.norm(thrust, axis=1)).max() < limits.max_tilt + 0.01
        )


def test_far_sites_and_empty_tanks_are_out_of_reach():
    assert not divert_cost(estimate(), [[3000.0, 0.0, 12.0]], LANDER, G).feasible[0]
    dry = estimate(mass=LANDER.dry_mass + 16.0)
    assert not divert_cost(dry, [[0.0, 0.0, 12.0]], LANDER, G).feasible[0]
