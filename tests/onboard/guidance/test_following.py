from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.path_guidance import PathGuidance
from lunarsim.onboard.guidance.paths import APOLLO
from lunarsim.onboard.navigation.estimate import Estimate

G = 1.622


def estimate(position, velocity, mass=1500.0) -> Estimate:
    return Estimate(
        0.0, np.asarray(position, float), np.asarray(velocity, float),
        np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def test_closed_loop_arrives_at_machine_precision():
    """Under perfect actuation re-solving the problem changes nothing: no terminal error."""
    end = PhaseEnd(np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, -2.0]))
    law = PathGuidance(APOLLO, G)
    r, v = np.array([-600.0, 50.0, 500.0]), np.array([28.0, 1.0, -18.0])
    t, dt = 0.0, 0.1
    while t < 40.0 - 1e-9:
        command = law.command(estimate(r, v), end, t, 40.0 - t)
        # Solved afresh until 1.5 s are left, then flown out.
        if 40.0 - t >= law.min_time_to_go:
            since, trajectory = t, APOLLO.path(r, v, end, 40.0 - t)
        r, v, _ = trajectory.at(t - since + dt)
        assert np.allclose(command, trajectory.at(t - since)[2] + [0.0, 0.0, G], atol=1e-12)
        t += dt
    assert np.allclose(r, end.position, atol=1e-8)
    assert np.allclose(v, end.velocity, atol=1e-9)


def test_command_includes_gravity():
    law = PathGuidance(APOLLO, G)
    still = estimate([0.0, 0.0, 10.0], [0.0, 0.0, 0.0])
    hover = law.command(still, PhaseEnd(np.array([0.0, 0.0, 10.0])), 0.0, 10.0)
    assert np.allclose(hover, [0.0, 0.0, G])


def test_lead_makes_up_for_a_first_order_lag():
    """With the lag modelled the terminal speed error is a small part of what it is without."""
    lag = 0.4
    target = PhaseEnd(np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, -2.0]))

    def miss(lead: float) -> tuple[float, float]:
        law = PathGuidance(APOLLO, G, lag=lead)
        y = np.array([-60.0, 40.0, 120.0, 9.0, 0.0, -12.0, 0.0, 0.0, 0.0])
        for n in range(140):
            command = law.command(estimate(y[:3], y[3:6]), target, 0.1 * n, 14.0 - 0.1 * n)
            wanted = command - np.array([0.0, 0.0, G])

            def motion(_, s, wanted=wanted):
                return np.concatenate((s[3:6], s[6:9], (wanted - s[6:9]) / lag))

            y = solve_ivp(motion, (0.0, 0.1), y, rtol=1e-9, atol=1e-9).y[:, -1]
        position = np.linalg.norm(y[:3] - target.position)
        return float(position), float(np.linalg.norm(y[3:6] - target.velocity))

    with_lead, without = miss(lag), miss(0.0)
    assert with_lead[0] < 0.5 * without[0]
    assert with_lead[1] < 0.1 * without[1]


def test_time_to_go_must_be_positive():
    with pytest.raises(ValueError, match="time_to_go"):
        APOLLO.path(np.zeros(3), np.zeros(3), PhaseEnd(np.ones(3)), 0.0)
