from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.models.thrusters import Thrusters
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.rotation import RotationLimits
from lunarsim.onboard.guidance.vertical import VerticalDescent, descent_law
from lunarsim.onboard.navigation.estimate import Estimate
from tests.reference.guidance import vertical_descent

G = 1.622
LANDER = Lander()
GROUND = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -2.0]))


def estimate(position, velocity, mass=1500.0) -> Estimate:
    return Estimate(
        0.0, np.asarray(position, float), np.asarray(velocity, float),
        np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def test_vertical_descent_settles_on_its_speed_above_the_target():
    law = VerticalDescent(gravity=G)
    r, v = np.array([0.4, -0.2, 10.0]), np.array([0.1, 0.0, -3.0])
    for n in range(450):
        a = law.command(estimate(r, v), GROUND, 0.01 * n) - np.array([0.0, 0.0, G])
        v = v + 0.01 * a
        r = r + 0.01 * v
    assert v[2] == pytest.approx(-2.0, abs=0.05)
    assert np.hypot(*r[:2]) < 0.2
    assert np.hypot(*v[:2]) < 0.2


def test_vertical_descent_stays_upright_near_the_terrain():
    law = VerticalDescent(gravity=G)
    command = law.command(estimate([5.0, 0.0, 0.1], [0.0, 0.0, -2.0]), GROUND, 0.0)
    lean = np.arctan2(np.hypot(command[0], command[1]), command[2])
    assert lean <= law.max_tilt_at_touchdown + 0.2 * (law.max_tilt - law.max_tilt_at_touchdown)


def descend(
    law: VerticalDescent, sideways: float, height: float, mass=1500.0, site=(0.0, 0.0)
) -> tuple[float, float]:
    """Return the sideways and the downward speed at the ground, m/s."""
    end = PhaseEnd(np.array([*site, 0.0]), GROUND.velocity)
    r, v = np.array([0.0, 0.0, height]), np.array([sideways, 0.0, -2.0])
    for n in range(6000):
        if r[2] <= 0.0:
            break
        v = v + 0.01 * (law.command(estimate(r, v, mass), end, 0.01 * n) - np.array([0.0, 0.0, G]))
        r = r + 0.01 * v
    assert r[2] <= 0.0
    return abs(float(v[0])), -float(v[2])


@pytest.mark.parametrize("sideways", [0.2, 1.0, 2.0, 3.0])
def test_a_lander_that_slips_comes_down_more_slowly_until_it_can_stop(sideways):
    slip, down = descend(VerticalDescent(gravity=G), sideways, 10.0)
    assert slip < 0.5
    assert 0.4 < down < 2.1


def test_one_that_can_stop_comes_down_as_planned():
    law = VerticalDescent(gravity=G)
    fast = law.command(estimate([0.0, 0.0, 10.0], [2.0, 0.0, -2.0]), GROUND, 0.0)
    high = law.command(estimate([0.0, 0.0, 40.0], [1.0, 0.0, -2.0]), GROUND, 0.0)
    still = law.command(estimate([0.0, 0.0, 10.0], [0.2, 0.0, -2.0]), GROUND, 0.0)
    assert high[2] == pytest.approx(G)
    assert still[2] == pytest.approx(G)
    assert fast[2] > G + 0.1


@pytest.mark.parametrize(("height", "speed"), [(3.0, 0.0), (0.5, 0.05), (-1.0, 0.05)])
def test_a_lander_with_a_fast_drift_near_the_ground_holds_where_it_can_tilt(height, speed):
    """It goes down again once it is slow, also below where the terrain should be.

    Below 3 m it climbs: by the missing height over the time to stop, at most 0.5 m/s.
    """
    law = VerticalDescent(gravity=G)
    fast = law.command(estimate([0.0, 0.0, height], [2.0, 0.0, 0.0]), GROUND, 0.0)
    slow = law.command(estimate([0.0, 0.0, height], [0.2, 0.0, 0.0]), GROUND, 0.0)
    most = law.max_tilt_at_touchdown + max(height, 0.0) / 8.0 * np.deg2rad(10.0)
    stopping = 1.7 / (0.5 * G * np.tan(most))
    assert fast[2] == pytest.approx(G + 1.5 * min((3.0 - height) / stopping, 0.5))
    assert fast[2] >= G + 1.5 * speed
    assert slow[2] == pytest.approx(G - 1.5 * 2.0) or slow[2] == pytest.approx(0.3 * G)


def test_a_lander_without_propellant_to_hold_goes_down_at_a_quarter_of_the_speed():
    law = VerticalDescent(gravity=G, dry_mass=1100.0)
    state = [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]
    holds = law.command(estimate(*state, mass=1110.1), GROUND, 0.0)
    descends = law.command(estimate(*state, mass=1109.9), GROUND, 0.0)
    assert holds[2] > G
    assert descends[2] == pytest.approx(G - 1.5 * 0.5)


def test_a_strong_drift_close_to_the_ground_is_gone_at_touchdown():
    """With 2 m/s at 1.5 m the lander that cannot hold touches down too fast sideways."""
    law = VerticalDescent(gravity=G, dry_mass=1100.0)
    slip, _ = descend(law, 2.0, 1.5)
    dragged, _ = descend(law, 2.0, 1.5, mass=1105.0)
    assert slip <= 0.35
    assert dragged > 0.6


@pytest.mark.parametrize(("sideways", "slower"), [(1.1, False), (1.25, True)])
def test_it_waits_where_half_of_what_it_can_lean_would_not_do(sideways, slower):
    """From 10 m at 2 m/s half of 1.622 tan 12 deg takes out 0.86 m/s, and 0.3 may be left."""
    command = VerticalDescent(gravity=G).command(
        estimate([0.0, 0.0, 10.0], [sideways, 0.0, -2.0]), GROUND, 0.0
    )
    assert (command[2] > G + 0.01) == slower


def test_a_distant_site_does_not_make_the_lander_drift_too_fast_to_land():
    """Unlimited, the position loop holds a lander 300 m from its site near the terrain for ever."""
    law = VerticalDescent(gravity=G)
    slip, down = descend(law, 0.0, 10.0, site=(300.0, 0.0))
    assert slip < 0.5
    assert down > 0.5


@pytest.mark.parametrize("misalignment", [8.0, 10.0])
def test_a_lander_that_holds_against_a_steady_force_stays_below_the_speed_limit(misalignment):
    """The thrust axis is off by an angle that the law can compensate at 3 m, but not at 0.5 m."""
    law = VerticalDescent(gravity=G)
    r, v, push = (
        np.array([0.0, 0.0, 2.0]),
        np.array([1.0, 0.0, 0.0]),
        G * np.tan(np.deg2rad(misalignment)),
    )
    for n in range(6000):
        a = law.command(estimate(r, v), GROUND, 0.01 * n) - np.array([-push, 0.0, G])
        v = v + 0.01 * a
        r = r + 0.01 * v
        assert r[2] > 0.0
    assert abs(v[0]) < 1.0


@pytest.mark.parametrize(
    ("lag", "offset", "drift"),
    [(0.3, 3.0, 0.0), (0.3, 9.0, -1.5), (0.3, -9.0, -1.0), (2.0, 6.0, 1.5), (2.0, -10.0, 0.0)],
)
def test_the_lander_returns_to_its_site_before_touchdown(lag, offset, drift):
    """Also if it drifts away from its site, and with a lag that slows the position loop."""
    law = VerticalDescent().for_lag(lag, G, 1100.0)
    kept = G * np.tan(np.deg2rad(2.0)) / law.frequency**2
    r, v = np.array([offset, 0.0, 10.0]), np.array([drift, 0.0, -2.0])
    nearest = r[2]
    for n in range(12000):
        v = v + 0.01 * (law.command(estimate(r, v), GROUND, 0.01 * n) - np.array([0.0, 0.0, G]))
        r = r + 0.01 * v
        if abs(r[0]) > law.tolerated_offset + kept:
            nearest = min(nearest, r[2])
        if r[2] <= 0.0:
            break
    assert r[2] <= 0.0
    assert nearest > 1.0  # m: it does not go down beside its site
    assert abs(r[0]) < law.tolerated_offset + 0.5 * kept
    assert abs(v[0]) < 1.01 * law.tolerated_speed


def test_the_horizontal_command_decreases_to_zero_before_touchdown():
    """It does so in the last 2 s of the descent, but not while the lander climbs."""

    def fractions(law, heights):
        commands = [
            law.command(estimate([0.0, 0.0, h], [0.01, 0.0, -2.0]), GROUND, 0.0)[0]
            for h in (9.0, *heights)
        ]
        return np.array(commands[1:]) / commands[0]

    law, later = VerticalDescent(gravity=G), VerticalDescent(gravity=G, upright_time=0.5)
    assert fractions(law, (4.01, 2.0, 0.4, 0.0)) == pytest.approx([1.0, 0.5, 0.1, 0.0])
    assert fractions(later, (1.01, 0.5)) == pytest.approx([1.0, 0.5])
    command = law.command(estimate([0.0, 0.0, 1.0], [2.0, 0.0, 0.0]), GROUND, 0.0)  # it climbs
    assert np.arctan2(-command[0], command[2]) > np.deg2rad(5.0)


def test_only_within_twice_the_maximum_offset_the_return_slows_the_descent():
    law = VerticalDescent(gravity=G)
    near, far = (
        law.command(estimate([x * law.max_offset, 0.0, 8.0], [0.0, 0.0, -2.0]), GROUND, 0.0)[2]
        for x in (1.99, 2.01)
    )
    assert near > far == G


@pytest.mark.parametrize("error_deg", [0.0, 1.0, 2.0, 4.0, 6.0])
def test_a_return_ends_before_the_tanks_are_empty(error_deg):
    """A lander of 7 t with 100 kg, whose position loop is slow, and a steady error of its tilt."""
    law = VerticalDescent().for_lag(2.0, G, 6850.0, 2970.0)
    end = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -1.5]))
    push = G * np.tan(np.deg2rad(error_deg))
    r, v, mass = np.array([8.0, 0.0, 10.0]), np.array([1.0, 0.0, -1.5]), 6950.0
    for n in range(12000):
        thrust = law.command(estimate(r, v, mass), end, 0.01 * n)
        v = v + 0.01 * (thrust - np.array([-push, 0.0, G]))
        r = r + 0.01 * v
        mass *= np.exp(-0.01 * np.linalg.norm(thrust) / 2970.0)
        if r[2] <= 0.0:
            break
    assert r[2] <= 0.0
    assert mass > 6850.0
    assert -v[2] < 2.0
    assert abs(v[0]) < (law.tolerated_speed if error_deg <= 2.0 else 1.0)
    if error_deg <= 2.0:
        # The position loop keeps the offset at which its command is the error.
        assert abs(r[0]) < 2.0 * law.tolerated_offset + push / law.frequency**2


@pytest.mark.parametrize(
    ("offset", "velocity", "reaches"),
    [(9.0, 0.0, True), (11.0, 0.0, False), (0.0, 2.5, True), (0.0, 2.8, False), (-9.0, 3.3, True)],
)
def test_the_vertical_descent_reaches_what_lies_within_its_stopping_distance(
    offset, velocity, reaches
):
    """The lander stops v^2 / (2 g tan 12 deg) farther on: 9.1 m at 2.5 m/s, 11.4 m at 2.8 m/s."""
    state = estimate([offset, 0.0, 10.0], [velocity, 0.0, -2.0])
    assert VerticalDescent(gravity=G).can_reach(state, GROUND) == reaches


def test_the_current_tilt_counts_until_the_lander_has_responded():
    """35 deg for half of 2 s change the velocity by 1.1 m/s, and the stop by 6 m and more."""
    law = VerticalDescent().for_lag(2.0, G, 1100.0)
    half = np.deg2rad(35.0) / 2.0
    level = estimate([2.0, 0.0, 10.0], [1.5, 0.0, -1.0])
    ahead, back = (
        replace(level, attitude=np.array([0.0, sign * np.sin(half), 0.0, np.cos(half)]))
        for sign in (1.0, -1.0)
    )
    assert [law.can_reach(state, GROUND) for state in (level, ahead, back)] == [True, False, True]


@pytest.mark.parametrize(("first", "gravity"), [(0.0, G), (3.0, G), (3.0, 3.71)])
def test_a_slow_rotation_shifts_the_stop_by_a_double_integral(first, gravity):
    """From 20 deg upright at 0.02 rad/s^2: 8.4 s, in which the acceleration falls to zero."""
    lander, tilt = LANDER, np.deg2rad(20.0)
    slow = RotationLimits(0.02 * float(max(lander.inertia(1300.0)[:2])), np.inf, 0.0, lander)
    law = replace(VerticalDescent().for_lag(0.5, gravity, 1100.0), rotation=slow, max_offset=1e3)
    speed, place = first, 0.0
    duration = 2.0 * np.sqrt(tilt / 0.02)
    for left in np.linspace(1.0, 0.0, 20001):  # the acceleration decreases linearly
        speed += gravity * np.tan(tilt) * left * duration / 20001
        place += speed * duration / 20001
    stop = place + 0.5 * speed**2 / (gravity * np.tan(law.max_tilt))
    back = np.array([0.0, np.sin(0.5 * tilt), 0.0, np.cos(0.5 * tilt)])
    for room, reaches in ((0.999, False), (1.001, True)):
        state = estimate([1e3 - room * stop, 0.0, 10.0], [first, 0.0, -2.0], 1300.0)
        assert law.can_reach(replace(state, attitude=back), GROUND) == reaches
    if first == 0.0:
        assert tilt - np.deg2rad(1.1) < law.max_final_tilt(1300.0, 1.0, 1.001 * stop) <= tilt
    assert law.max_final_tilt(1300.0, 0.1, 1e6) == pytest.approx(0.1)
    assert law.max_final_tilt(1300.0, 0.1, 0.0) == pytest.approx(np.deg2rad(2.0))
    assert law.max_final_tilt(1300.0, 0.01, 0.0) == 0.01


def test_a_hover_descends_and_climbs_at_limited_speeds():
    """From 60 m below and above the wanted height: at most 4 m/s up and 2 m/s down."""
    law = VerticalDescent(gravity=G)
    for height, fastest in ((30.0, 4.0), (150.0, -2.0)):
        r, v, seen = np.array([0.0, 0.0, height]), np.zeros(3), []
        for _ in range(2000):
            v = v + 0.01 * (law.hover(estimate(r, v), 90.0) - np.array([0.0, 0.0, G]))
            r = r + 0.01 * v
            seen.append(v[2])
        assert min(seen) >= -2.01 and max(seen) <= 4.01
        assert max(seen, key=abs) == pytest.approx(fastest, abs=0.2)


@pytest.mark.parametrize("max_tilt", [12.0, 50.0])
def test_a_hover_stops_the_lander_at_the_wanted_height(max_tilt):
    law = VerticalDescent(gravity=G, max_tilt=np.deg2rad(max_tilt))
    r, v = np.array([0.0, 0.0, 12.0]), np.array([20.0, -9.0, -1.0])
    first = law.hover(estimate(r, v), 30.0)
    assert np.hypot(*first[:2]) == pytest.approx(2.0 * np.tan(law.max_tilt) * first[2])
    for _ in range(6000):
        thrust = law.hover(estimate(r, v), 30.0)
        assert np.hypot(*thrust[:2]) <= 2.0 * np.tan(law.max_tilt) * thrust[2] + 1e-9
        assert v[2] < 4.01
        v = v + 0.01 * (thrust - np.array([0.0, 0.0, G]))
        r = r + 0.01 * v
    assert r[2] == pytest.approx(30.0, abs=0.05)
    assert np.linalg.norm(v) < 0.05


def test_the_engine_never_idles():
    command = VerticalDescent(gravity=G).command(
        estimate([0.0, 0.0, 10.0], [0.0, 0.0, 9.0]), GROUND, 0.0
    )
    assert command[2] == pytest.approx(0.3 * G)


def test_the_position_loop_leaves_a_slow_attitude_time_to_turn():
    """Frequency times all of the lag is 0.33; 12 deg at 5 deg/s are 2.4 s of it."""

    def frequency(control, lag, lander=LANDER):
        briefing = SimpleNamespace(
            software=SimpleNamespace(control=control), surface_gravity=G, lander=lander
        )
        return descent_law(None, briefing, lag).frequency

    assert frequency(ProportionalDerivative(), 0.45) == 0.6
    assert frequency(ProportionalDerivative(), 1.0) == pytest.approx(0.33)
    slow = PhasePlane(slew_limit=np.deg2rad(5.0))
    assert frequency(slow, 0.6) == pytest.approx(0.33 / 3.0)
    weak = JetLander(thrusters=Thrusters(force=5.0))
    turn = RotationLimits.of(weak, slow).time(np.deg2rad(12.0), weak.dry_mass)
    assert turn > 4.8
    assert frequency(slow, 0.6, weak) == pytest.approx(0.33 / (0.6 + 0.5 * turn))


def test_commands_are_those_of_the_reference():
    rng = np.random.default_rng(1)
    law = VerticalDescent().for_lag(0.55, G, 1100.0, 3000.0)
    end, slowed = np.array([0.0, 0.0, 1.6]), 0
    for n in range(300):
        mass = (1500.0, 1105.0, 1112.0)[n % 3]
        position, velocity = rng.normal(0, 2, 3), rng.normal(0, 1.0, 3) - [0.0, 0.0, 2.0]
        position[2] = rng.uniform(0.0, 14.0)
        if n % 10 == 0:  # at rest beside the site, below its height
            position, velocity = np.array([1.1, 0.0, rng.uniform(0.6, 1.5)]), np.zeros(3)
        command = law.command(
            estimate(position, velocity, mass), PhaseEnd(end, np.array([0.0, 0.0, -2.0])), 0.0
        )
        expected = vertical_descent(
            position, velocity, end, 2.0, G, 0.55, mass - 1100.0, mass, 3000.0
        )
        assert command == pytest.approx(expected, rel=1e-12, abs=1e-12)
        slowed += command[2] != pytest.approx(G + law.speed_gain * (-2.0 - velocity[2]))
    assert slowed > 10


def test_the_tolerated_offset_is_at_most_the_maximum_one():
    with pytest.raises(InputError, match=r"tolerated_offset.*at most that of max_offset"):
        VerticalDescent(tolerated_offset=2.0, max_offset=1.9)
    assert VerticalDescent(tolerated_offset=2.0, max_offset=2.0).max_offset == 2.0
