"""P63 to P66 as in the lunar module: lift first, jerk, velocities nulled, the window."""

from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust, quat_from_rotation_vector, quat_rotate
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.thrust import (
    thrust_along,
    thrust_lift_first,
    thrust_to_command,
)
from lunarsim.onboard.guidance.apollo import ApolloLaw, time_to_go_for_jerk
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.braking import Braking
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.paths import APOLLO
from lunarsim.onboard.guidance.rate_of_descent import RateOfDescent
from lunarsim.onboard.guidance.velocity_null import VelocityNull
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.window import CrewWindow

G = 1.622
UP = np.array([0.0, 0.0, 1.0])


def estimate(position=(0.0, 0.0, 100.0), velocity=(0.0, 0.0, 0.0), attitude=(0, 0, 0, 1.0)):
    given = (np.asarray(v, dtype=float) for v in (position, velocity, attitude, np.zeros(3)))
    return Estimate(0.0, *given, 1500.0, np.eye(9))


def axis(command):
    return quat_rotate(command.attitude, UP)


def test_an_engine_that_falls_short_keeps_the_direction():
    lander, a = Lander(), np.array([6.0, -2.0, 1.0])
    kept = thrust_along(a, 1500.0, lander, 0.3, np.deg2rad(120.0))
    assert axis(kept) == pytest.approx(a / np.linalg.norm(a))
    assert kept.thrust == lander.thrust_max
    lifted = thrust_to_command(a, 1500.0, lander, 0.3, np.deg2rad(85.0))
    assert axis(lifted)[2] > axis(kept)[2] + 0.05
    small = thrust_along(0.5 * UP, 1500.0, lander, 0.3, 1.0)
    assert small.thrust == pytest.approx(750.0)
    assert thrust_along(1e-3 * UP, 1500.0, lander, 0.3, 1.0).thrust == lander.thrust_min
    assert axis(thrust_along(np.zeros(3), 1500.0, lander, 0.3, 1.0)) == pytest.approx(UP)


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_an_engine_that_falls_short_keeps_the_lift(up):
    """The computer's own rule: the downrange part is the root of what the vertical one leaves."""
    lander, mass = Lander(), 1500.0
    most = lander.thrust_max / mass
    command = thrust_lift_first(np.array([6.0, 0.0, up]), mass, lander, 0.3, np.deg2rad(170.0))
    assert command.thrust == pytest.approx(lander.thrust_max)
    assert most * axis(command) == pytest.approx([np.sqrt(most**2 - 1.0), 0.0, up])
    # What the engine can give is given as it is; what it cannot even lift has no part aside.
    within = np.array([1.0, -0.5, 0.8 * up])
    given = thrust_lift_first(within, mass, lander, 0.3, np.deg2rad(170.0))
    assert given.thrust / mass * axis(given) == pytest.approx(within)
    heavy = thrust_lift_first(np.array([6.0, 2.0, 9.0]), mass, lander, 0.3, np.deg2rad(170.0))
    assert axis(heavy) == pytest.approx(UP)
    assert heavy.thrust == pytest.approx(lander.thrust_max)
    # Nor has what pulls down harder than the engine can: it is turned to the limit alone.
    down = thrust_lift_first(np.array([6.0, 2.0, -9.0]), mass, lander, 0.3, np.deg2rad(170.0))
    assert axis(down)[2] == pytest.approx(-np.cos(np.deg2rad(10.0)))


@pytest.mark.parametrize("give", [thrust_lift_first, thrust_along])
@pytest.mark.parametrize("acceleration", [(6.0, 0.0, -9.0), (0.3, 0.4, -5.0), (0.0, 0.0, -1.0)])
def test_no_thrust_leans_more_than_it_may_however_much_it_is_to_pull_down(give, acceleration):
    lander, limit, a = Lander(), np.deg2rad(120.0), np.array(acceleration)
    command = give(a, 1500.0, lander, 0.3, limit)
    along = axis(command)
    assert along[2] == pytest.approx(np.cos(limit), abs=1e-9)
    assert command.thrust == pytest.approx(min(np.linalg.norm(a) * 1500.0, lander.thrust_max))
    # Aside as asked; where nothing is asked aside, along the heading.
    aside = a[:2] if a[:2].any() else np.array([np.sin(0.3), np.cos(0.3)])
    assert along[:2] == pytest.approx(np.sin(limit) * aside / np.hypot(*aside))


@pytest.mark.parametrize("limit", [30.0, 100.0])
def test_a_tilt_beyond_the_limit_is_turned_to_it(limit):
    a = np.array([3.0, 4.0, -5.0])  # 135 deg from the vertical
    command = thrust_along(a, 1500.0, Lander(), 0.0, np.deg2rad(limit))
    z = axis(command)
    assert np.arccos(z[2]) == pytest.approx(np.deg2rad(limit))
    assert np.arctan2(z[1], z[0]) == pytest.approx(np.arctan2(4.0, 3.0))


def test_braking_trims_at_the_least_thrust_first():
    part = Braking(keeps_thrust_direction=True, min_thrust_time=26.0, max_tilt=2.0)
    lander, a = Lander(), np.array([3.0, 0.0, 1.0])
    early, late = (part.build_command(a, 1500.0, lander, 0.0, t) for t in (25.9, 26.0))
    assert early.thrust == lander.thrust_min
    assert late.thrust == pytest.approx(1500.0 * np.sqrt(10.0))
    assert early.attitude == pytest.approx(late.attitude)


def test_braking_keeps_the_lift_unless_asked_to_keep_the_direction():
    lander, a = Lander(), np.array([6.0, 0.0, -1.0])
    for changed, give in (
        ({"max_tilt": 2.0}, thrust_lift_first),
        ({"max_tilt": 1.5}, thrust_to_command),
        ({"max_tilt": 2.0, "keeps_thrust_direction": True}, thrust_along),
    ):
        command = Braking(**changed).build_command(a, 1500.0, lander, 0.0, 0.0)
        same = give(a, 1500.0, lander, 0.0, changed["max_tilt"])
        assert command.thrust == same.thrust
        assert command.attitude == pytest.approx(same.attitude)
    with pytest.raises(InputError, match="max_tilt"):
        Braking(max_tilt=3.2)


def test_time_to_go_of_braking_follows_the_jerk_until_its_end():
    here, end = estimate((-2500.0, 0.0, 900.0), (60.0, 0.0, -30.0)), Braking().end(np.zeros(3))
    followed = time_to_go_for_jerk(here, end, 0.002, 45.0)
    assert followed == pytest.approx(52.4439, abs=1e-3)
    for ends_at, left in ((20.0, followed), (45.0, 45.0), (46.0, 45.0)):
        braking = Braking(jerk=0.002, time_to_go=60.0, end_time_to_go=ends_at)
        assert braking.time_left(here, end, 45.0) == left


def test_the_descent_after_the_approach_may_have_a_speed_of_its_own():
    lander, site = Lander(), np.zeros(3)
    plain, slower = Approach(vertical_speed=1.5), Approach(vertical_speed=1.5, descent_speed=0.9)
    for approach, rate in ((plain, 1.5), (slower, 0.9)):
        assert approach.end(site, lander).velocity[2] == -1.5
        # Both ends are the centre of mass's: pads stand lower.
        assert approach.end(site, lander).position[2] == 10.0 + lander.com_height
        assert approach.touchdown_end(site, lander).position[2] == lander.com_height
        assert approach.touchdown_end(site, lander).velocity[2] == -rate


@pytest.mark.parametrize("jerk", [-0.0036, 0.0, 0.004])
def test_the_time_of_a_jerk_is_that_of_the_path(jerk):
    end = PhaseEnd(
        np.array([0.0, 0.0, 900.0]), np.array([120.0, 0.0, -30.0]), np.array([-2.0, 0, 0])
    )
    r, v = np.array([-90_000.0, 40.0, 5_000.0]), np.array([700.0, 0.0, -60.0])
    t = time_to_go_for_jerk(estimate(r, v), end, jerk, 150.0, max_change=np.inf)
    path, h = APOLLO.path(r, v, end, t), 1e-3
    slope = (path.at(t)[2] - path.at(t - h)[2])[0] / h
    assert slope == pytest.approx(jerk, abs=2e-6)
    # A guess that is far off stays, and so does one without a direction.
    assert time_to_go_for_jerk(estimate(r, v), end, jerk, 10.0) == 10.0
    level = PhaseEnd(end.position, np.array([0.0, 0.0, -30.0]), end.acceleration)
    assert time_to_go_for_jerk(estimate(r, v), level, jerk, 150.0) == 150.0


def test_where_an_approach_is_over():
    plain, lem = Approach(), Approach(end_time_to_go=10.0, takeover_altitude=150.0)
    assert [plain.is_finished(*s) for s in ((10.1, 5.0), (10.0, 5.0), (50.0, 0.0))] == [
        False,
        True,
        True,
    ]
    assert [lem.is_finished(*s) for s in ((151.0, 11.0), (150.0, 60.0), (400.0, 10.0))] == [
        False, True, True,
    ]  # fmt: skip
    end = Approach(arrival_offset=(3.0, -1.0), arrival_velocity=(-0.4, 0.2)).end(
        np.array([100.0, 50.0, 7.0]), Lander()
    )
    assert end.position[:2] == pytest.approx([103.0, 49.0])
    assert end.velocity == pytest.approx([-0.4, 0.2, -2.0])
    with pytest.raises(InputError, match="arrival_velocity"):
        Approach(jerk=0.01)
    assert Approach().has_free_time_to_go
    assert not Approach(jerk=0.01, arrival_velocity=(1.0, 0.0)).has_free_time_to_go


def test_velocities_fall_exponentially():
    law = VelocityNull(time_constant=4.0).build(SimpleNamespace(surface_gravity=G), 0.0)
    end = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -0.9]))
    v, dt = np.array([1.5, -0.7, -3.0]), 1e-3
    for n in range(8_000):
        a = law.command(estimate(velocity=v), end, n * dt)
        v = v + dt * (a - np.array([0.0, 0.0, G]))
    left = np.exp(-2.0)
    assert v == pytest.approx([1.5 * left, -0.7 * left, -0.9 - 2.1 * left], rel=2e-3)


def test_velocities_are_nulled_within_the_lean():
    law = VelocityNull(max_tilt=0.2).build(SimpleNamespace(surface_gravity=G), 0.0)
    end = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -0.9]))
    a = law.command(estimate(velocity=(40.0, 30.0, 20.0)), end, 0.0)
    assert np.hypot(*a[:2]) == pytest.approx(G * np.tan(0.2))
    assert a[0] / a[1] == pytest.approx(4.0 / 3.0)
    assert a[2] == pytest.approx(0.3 * G)
    assert law.max_tilt == 0.2


@pytest.mark.parametrize(("speed", "falls"), [(6.0, False), (4.0, True)])
def test_a_pilot_who_is_too_fast_keeps_his_height(speed, falls):
    law = RateOfDescent(hold_height_speed=5.0).build(SimpleNamespace(surface_gravity=G), 0.0)
    end = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -1.0]))
    for n in range(400):
        law.command(estimate(velocity=(speed, 0.0, -2.0)), end, 0.1 * n)
    assert law.commanded_rate == pytest.approx(4.5 if falls else 0.0, abs=0.16)


def test_look_angles_are_those_of_the_body():
    window = CrewWindow(azimuth=np.pi / 2)
    # Upright, body x north: forward (body y) is west.
    upright = attitude_from_thrust(UP, 0.0)
    here = estimate((0.0, 0.0, 100.0), attitude=upright)
    west = np.array([[-100.0, 0.0, 0.0], [-100.0, 50.0, 100.0], [100.0, 0.0, 0.0]])
    look, aside = window.angles(here, west)
    assert np.rad2deg(look) == pytest.approx([45.0, 0.0, 135.0], abs=1e-9)
    assert np.rad2deg(np.abs(aside)) == pytest.approx([0.0, np.rad2deg(np.arctan(0.5)), 0.0])
    # Left of west is south.
    assert aside[1] < 0.0
    # Pitched back by 30 deg the window looks higher: the site sinks in it.
    back = quat_from_rotation_vector(np.deg2rad(30.0) * np.array([0.0, 1.0, 0.0]))
    leant = attitude_from_thrust(quat_rotate(back, UP), 0.0)
    lower, _ = window.angles(estimate((0.0, 0.0, 100.0), attitude=leant), west[:1])
    assert np.rad2deg(lower[0]) == pytest.approx(75.0)
    assert window.is_visible(here, west).tolist() == [True, True, False]
    assert not window.is_visible(estimate(attitude=leant), west[0])


def test_a_window_needs_an_opening():
    with pytest.raises(InputError, match="upper_edge_deg"):
        CrewWindow(upper_edge=1.2, lower_edge=1.0)


def test_laws_make_up_for_gravity_by_place():
    from lunarsim.models.gravity import RoundMoon

    field = RoundMoon().gravity(G)
    flat = ApolloLaw().build(SimpleNamespace(surface_gravity=G, nonuniform_gravity=None), 0.0)
    curved = ApolloLaw().build(SimpleNamespace(surface_gravity=G, nonuniform_gravity=field), 0.0)
    here = estimate((-300_000.0, 0.0, 9_000.0), (1_200.0, 0.0, 100.0))
    end = PhaseEnd(np.array([0.0, 0.0, 500.0]), np.array([50.0, 0.0, -10.0]))
    off = curved.command(here, end, 0.0, 300.0) - flat.command(here, end, 0.0, 300.0)
    assert off == pytest.approx(
        [0, 0, -G] - field.free_fall_acceleration(here.position, here.velocity)
    )
    assert np.linalg.norm(off) > 0.2
