"""Where an approach ends."""

from __future__ import annotations

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach

LANDER = Lander(com_height=1.5)


def test_it_ends_above_the_site_at_the_speed_of_the_descent():
    approach = Approach(10.0, 2.5, arrival_acceleration=(0.1, 0.0, -0.2))
    end = approach.end([3.0, 4.0, 5.0], LANDER)
    assert np.array_equal(end.position, [3.0, 4.0, 16.5])
    assert np.array_equal(end.velocity, [0.0, 0.0, -2.5])
    assert np.array_equal(end.acceleration, [0.1, 0.0, -0.2])
    assert end.frame == "local"


def test_many_sites_have_many_ends_and_one_speed():
    sites = np.arange(12.0).reshape(4, 3)
    approach = Approach(20.0)
    end = approach.end(sites, LANDER)
    for n in range(4):
        assert np.array_equal(end.position[n], approach.end(sites[n], LANDER).position)
    assert end.velocity.shape == (3,)


def test_the_descent_ends_with_the_pads_on_the_terrain():
    end = Approach(10.0, 2.5).touchdown_end([3.0, 4.0, 5.0], LANDER)
    assert np.array_equal(end.position, [3.0, 4.0, 6.5])
    assert np.array_equal(end.velocity, [0.0, 0.0, -2.5])


def test_limits_are_its_own():
    limits = Approach(max_tilt=0.5, glideslope=0.2, reserve=7.0, throttle_margin=0.1).limits
    assert (limits.max_tilt, limits.glideslope) == (0.5, 0.2)
    assert (limits.reserve, limits.throttle_margin) == (7.0, 0.1)


def test_a_postponement_is_limited_below_twice_the_altitude_of_the_end():
    approach = Approach(vertical_altitude=10.0, max_late_postponement=5.0)
    allowed = [
        approach.allows_postponement(s, h) for s, h in ((5.1, 19.9), (5.1, 20.1), (5.0, 1.0))
    ]
    assert allowed == [False, True, True]
