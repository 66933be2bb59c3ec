"""When navigation is accurate enough to land."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.models.lander import Lander
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.navigation.landing_accuracy import allows_landing

LANDER = Lander(vertical_speed_limit=3.0, horizontal_speed_limit=1.5)


def estimate(velocity_covariance) -> Estimate:
    covariance = np.eye(9) * 1e6
    covariance[3:6, 3:6] = velocity_covariance
    return Estimate(
        0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1.0, covariance
    )


@pytest.mark.parametrize(
    ("sigmas", "allowed"),
    [
        ((0.49, 0.49, 0.99), True),
        ((0.51, 0.0, 0.0), False),
        ((0.0, 0.51, 0.0), False),
        ((0.0, 0.0, 1.01), False),
        ((np.inf, np.inf, np.inf), False),
    ],
)
def test_three_sigma_of_the_velocity_are_within_the_limits_at_touchdown(sigmas, allowed):
    assert allows_landing(estimate(np.diag(np.square(sigmas))), LANDER) == allowed


@pytest.mark.parametrize(("sigma", "allowed"), [(0.49, True), (0.51, False)])
def test_the_horizontal_velocity_counts_in_its_worst_direction(sigma, allowed):
    north_east = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    assert allows_landing(estimate(sigma**2 * np.outer(north_east, north_east)), LANDER) == allowed
