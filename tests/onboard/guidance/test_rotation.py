"""Rotation times from closed forms, and diverts that leave time for their first rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.attitude import IdealAttitude, ProportionalDerivative
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.paths import APOLLO, E_GUIDANCE
from lunarsim.onboard.guidance.polynomial_laws import ApolloLaw
from lunarsim.onboard.guidance.rotation import RotationLimits, guidance_delay_margin
from lunarsim.onboard.navigation.estimate import Estimate

G = 1.622
# 41.5 kg may be used: enough for the longer path to one of the sites at 10 N m, not to the others.
APPROACH, LAW = Approach(reserve=158.5), ApolloLaw()
SITES = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, -80.0, 0.0], [300.0, 0.0, 0.0]])


def estimate(tilt_deg=0.0):
    """Return a state 300 m before and 250 m above the sites, pitched back by an angle."""
    attitude = Rotation.from_euler("y", -tilt_deg, degrees=True).as_quat()
    return Estimate(
        0.0, np.array([-300.0, 0.0, 250.0]), np.array([20.0, 0.0, -15.0]), attitude, np.zeros(3),
        1300.0, np.eye(9),
    )  # fmt: skip


def limited(limits, state, sites=SITES):
    """Return the divert costs to `sites` without and with the limits of rotation."""
    arguments = state, APPROACH.end(sites, limits.lander), limits.lander, G, APPROACH.limits
    cost = LAW.cost(*arguments)
    state, end, _, gravity, path_limits = arguments
    return cost, limits.limit(cost, LAW, state, end, gravity, path_limits)


@pytest.mark.parametrize(
    ("angle", "expected"), [(0.0, 0.0), (0.05, 2.0), (0.1, 2.8284), (1.0, 9.0)]
)
def test_rotation_times_are_bang_bang_until_the_rate_limit(angle, expected):
    """0.05 rad/s^2 and 0.2 rad/s: from 0.8 rad on, the lander coasts in between."""
    lander = Lander()
    limits = RotationLimits(0.05 * max(lander.inertia(1300.0)[:2]), 0.2, 0.0, lander)
    assert limits.time(angle, 1300.0) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("max_rate", [0.2, np.inf])
def test_the_angle_that_fits_a_time_is_that_of_the_rotation_time(max_rate):
    lander = Lander()
    limits = RotationLimits(0.05 * max(lander.inertia(1300.0)[:2]), max_rate, 0.0, lander)
    for angle in (0.0, 0.1, 0.8, 1.5):
        assert limits.angle(float(limits.time(angle, 1300.0)), 1300.0) == pytest.approx(angle)
    assert limits.angle(-1.0, 1300.0) == 0.0


def test_the_axis_with_the_largest_inertia_and_the_smallest_torque_limits_rotations():
    lander = Lander(
        inertia_dry=(900.0, 1200.0, 1300.0), inertia_full=(900.0, 1200.0, 1300.0),
        torque_max=(300.0, 600.0, 300.0),
    )  # fmt: skip
    limits = RotationLimits.of(lander, ProportionalDerivative())
    assert limits.acceleration(1300.0) == pytest.approx(300.0 / 1200.0)


def test_each_end_of_the_thrust_range_has_its_own_margin():
    lander = Lander(thrust_min=1000.0, thrust_max=5000.0)
    assert Approach(throttle_margin=0.1).limits.thrust_range(lander) == (1400.0, 4600.0)
    apart = Approach(throttle_margin=0.1, lower_throttle_margin=0.0).limits
    assert apart.thrust_range(lander) == (1000.0, 4600.0)


def test_ideal_attitude_control_rotates_at_its_rate_limit():
    limits = RotationLimits.of(Lander(), IdealAttitude(slew_limit=0.2))
    with np.errstate(all="raise"):
        assert limits.time(np.array([0.0, 0.5]), 1300.0) == pytest.approx([0.0, 2.5])
        assert [limits.angle(t, 1300.0) for t in (-1.0, 0.0, 2.5)] == [0.0, 0.0, 0.5]
        free = RotationLimits(np.inf, np.inf, 0.0, Lander())
        assert [free.angle(t, 1300.0) for t in (0.0, 2.5)] == [0.0, np.inf]


def test_the_phase_plane_uses_the_weakest_axis_and_half_of_it_to_brake():
    """Two of four clusters lie on a diagonal: 0.71 of the torque about body x is left there."""
    lander = JetLander(thrusters=Thrusters(force=50.0))
    limits = RotationLimits.of(lander, PhasePlane())
    assert limits.torque == pytest.approx(2.0 / 3.0 * lander.torque_max[0] / np.sqrt(2.0), rel=0.01)
    assert limits.max_rate == pytest.approx(np.deg2rad(10.0))


def test_delay_margins_of_apollo_and_e_guidance():
    assert guidance_delay_margin(APOLLO) == pytest.approx(0.20, abs=0.005)
    assert guidance_delay_margin(E_GUIDANCE) == pytest.approx(0.29, abs=0.005)


def test_a_strong_lander_keeps_its_cheapest_paths():
    free, kept = limited(RotationLimits.of(Lander(), ProportionalDerivative()), estimate())
    for name in ("propellant", "time_to_go", "peak_thrust", "peak_tilt"):
        assert np.array_equal(getattr(free, name), getattr(kept, name), equal_nan=True)


def test_a_slow_lander_gets_longer_paths_or_none():
    """Every path that is left begins with a rotation that the lander completes in time."""
    lander = Lander()
    limits = RotationLimits(10.0, np.deg2rad(10.0), 0.5, lander)
    state = estimate(20.0)
    free, kept = limited(limits, state)
    assert free.feasible.all()
    assert kept.feasible.tolist() == [False, False, True, False]
    later = kept.time_to_go > free.time_to_go + 20.0
    assert later.any()
    assert (kept.propellant[later] > free.propellant[later]).all()
    for site, time in zip(SITES[kept.feasible], kept.time_to_go[kept.feasible], strict=True):
        path = APOLLO.path(state.position, state.velocity, APPROACH.end(site, lander), time)
        thrust = path.command + [0.0, 0.0, G]
        axis = Rotation.from_quat(state.attitude).apply([0.0, 0.0, 1.0])
        angle = np.arccos(thrust @ axis / np.linalg.norm(thrust))
        delay = 0.5 * float(limits.time(angle, state.mass)) - limits.response_time
        assert delay <= guidance_delay_margin(APOLLO) * time + 1e-6


def test_a_lander_that_already_points_along_its_path_needs_no_more_time():
    lander = Lander()
    limits = RotationLimits(25.0, np.deg2rad(10.0), 0.5, lander)
    away, aligned = (limited(limits, estimate(tilt), SITES[:1])[1] for tilt in (20.0, -20.0))
    assert aligned.time_to_go[0] < away.time_to_go[0]


def test_a_law_without_given_times_loses_the_sites_that_need_a_longer_path():
    class OwnLaw:
        def cost(self, estimate, end, lander, gravity, limits=None):
            return LAW.cost(estimate, end, lander, gravity, limits)

    limits = RotationLimits(25.0, np.deg2rad(10.0), 0.5, Lander())
    state = estimate(20.0)
    end = APPROACH.end(SITES, limits.lander)
    cost = OwnLaw().cost(state, end, limits.lander, G, APPROACH.limits)
    kept = limits.limit(cost, OwnLaw(), state, end, G, APPROACH.limits)
    assert kept.feasible.tolist() == [False, False, False, True]
    for value in (kept.time_to_go, kept.peak_thrust, kept.peak_tilt):
        assert np.isnan(value).tolist() == [True, True, True, False]
    assert replace(limits, torque=np.inf, max_rate=np.inf).limit(
        cost, OwnLaw(), state, end, G, APPROACH.limits
    ) is cost  # fmt: skip
