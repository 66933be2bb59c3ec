"""Laws of the last phase, and braking: closed forms and what they answer off the nominal case."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.braking import Braking
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.gravity_turn import GravityTurn, gravity_turn_thrust
from lunarsim.onboard.guidance.rate_of_descent import RateOfDescent
from lunarsim.onboard.guidance.velocity_null import VelocityNull
from lunarsim.onboard.guidance.vertical import VerticalDescent, climb
from lunarsim.onboard.navigation.estimate import Estimate

G = 1.622
BRIEFING = SimpleNamespace(surface_gravity=G, nonuniform_gravity=None, lander=Lander())
GROUND = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -1.5]))


def estimate(position, velocity) -> Estimate:
    return Estimate(
        0.0, np.asarray(position, float), np.asarray(velocity, float), np.array([0, 0, 0, 1.0]),
        np.zeros(3), 1300.0, np.zeros((9, 9)),
    )  # fmt: skip


def closed_loop(law, position, velocity, seconds, dt=0.02):
    """Return positions and velocities (n, 3) under a law that is obeyed at once."""
    r, v = np.array(position, float), np.array(velocity, float)
    rows = []
    for n in range(round(seconds / dt)):
        a = law.command(estimate(r, v), GROUND, n * dt) - [0.0, 0.0, G]
        r = r + dt * (v + 0.5 * dt * a)
        v = v + dt * a
        rows.append((r, v))
        if r[2] <= 0.0:
            break
    return np.array(rows)


@pytest.mark.parametrize("velocity", [(30.0, 0.0, -20.0), (0.0, 0.0, -12.0), (-15.0, 40.0, -5.0)])
def test_a_constant_gravity_turn_loses_the_height_of_the_closed_form(velocity):
    """N from the formula, flown open loop by SciPy: it stands still when that is lost."""
    height = 600.0
    n = gravity_turn_thrust(height, np.array(velocity), G)

    def rate(_, y):
        v = y[3:]
        return np.concatenate((v, -n * G * v / np.linalg.norm(v) - [0.0, 0.0, G]))

    def still(_, y):
        return np.linalg.norm(y[3:]) - 0.02

    still.terminal = True
    start = np.concatenate(([0.0, 0.0, height], velocity))
    end = solve_ivp(rate, (0.0, 1e4), start, events=still, rtol=1e-9, atol=1e-9).y[:, -1]
    assert end[2] == pytest.approx(0.0, abs=0.02)
    assert np.hypot(*end[3:5]) < 0.02


def test_a_vertical_gravity_turn_needs_one_plus_half_v2_over_gh():
    assert gravity_turn_thrust(100.0, np.array([0.0, 0.0, -10.0]), G) == pytest.approx(
        1.0 + 100.0 / (2.0 * G * 100.0)
    )
    for height in (0.0, -3.0, float("nan")):
        with pytest.raises(InputError, match="height"):
            gravity_turn_thrust(height, np.array([0.0, 0.0, -10.0]), G)


def test_the_turn_goes_over_into_a_straight_descent():
    law = GravityTurn(final_speed=1.5, stop_height=5.0).build(BRIEFING, 0.0)
    assert law.max_tilt == pytest.approx(np.deg2rad(60.0))
    rows = closed_loop(law, (0.0, 0.0, 300.0), (12.0, -5.0, -14.0), 200.0)
    r, v = rows[-1]
    assert r[2] <= 0.0
    assert v[2] == pytest.approx(-1.5, abs=0.05)
    assert np.hypot(*v[:2]) < 0.05
    assert law.max_tilt == VerticalDescent(gravity=G).max_tilt
    # By then upright: at 1.6 m/s the rest of the way is v^2 / (2 g (N - 1)), N that of the start.
    n = gravity_turn_thrust(295.0, np.array([12.0, -5.0, -14.0]), G)
    slow = rows[np.linalg.norm(rows[:, 1], axis=1) > 1.6]
    assert slow[-1, 0, 2] == pytest.approx(5.0 + 1.6**2 / (2.0 * G * (n - 1.0)), rel=0.02)


def test_p66_follows_a_click_as_a_first_order_lag():
    """One click: v approaches what is wanted as 1 - exp(-t / tau)."""
    pilot = RateOfDescent(click_interval=1e3, descent_time=10.0)
    law = pilot.build(BRIEFING, 0.0)
    law.command(estimate([0, 0, 40.0], [0, 0, -2.0]), GROUND, 0.0)
    assert law.clicks == 1
    assert law.commanded_rate == pytest.approx(2.0 + 0.3048)
    rows = closed_loop(law, (0.0, 0.0, 40.0), (0.0, 0.0, -2.0), 6.0, dt=0.005)
    t = 0.005 * np.arange(1, len(rows) + 1)
    assert -rows[:, 1, 2] - 2.0 == pytest.approx(0.3048 * (1.0 - np.exp(-t / 1.5)), abs=1e-3)


def test_the_pilot_lands_at_the_site_click_by_click():
    law = RateOfDescent().build(BRIEFING, 0.0)
    rows = closed_loop(law, (25.0, -8.0, 60.0), (2.0, 1.0, -3.0), 120.0)
    r, v = rows[-1]
    assert r[2] <= 0.0
    assert np.hypot(*r[:2]) < 7.0
    assert -v[2] == pytest.approx(1.5, abs=0.25)
    assert np.hypot(*v[:2]) < 0.4
    assert 4 <= law.clicks <= 20
    sideways = [law.command(estimate([9e3, 0, 50.0], [50.0, 0, 0]), GROUND, 1e6)[:2]]
    assert np.hypot(*sideways[0]) <= G * np.tan(law.max_tilt) + 1e-9


def test_the_pilot_flies_on_beyond_the_site_the_way_that_he_came():
    pilot = RateOfDescent(overshoot=50.0, velocity_time=8.0, max_tilt=np.deg2rad(15.0))
    law = pilot.build(BRIEFING, 0.0)
    end = PhaseEnd(np.zeros(3), np.array([0.0, 0.0, -1.0]))
    still = law.command(estimate([0.0, 0.0, 60.0], [-6.25, 0.0, -1.0]), end, 0.0)
    # 50 m ahead in 8 s is the speed that it has: nothing to take out.
    assert still[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    back = law.command(estimate([-50.0, 0.0, 60.0], [-1.0, 0.0, -1.0]), end, 1.0)
    assert back[0] == pytest.approx(1.0 / pilot.correction_time)
    plain = RateOfDescent(velocity_time=8.0).build(BRIEFING, 0.0)
    assert plain.command(estimate([0.0, 0.0, 60.0], [-6.25, 0.0, -1.0]), end, 0.0)[0] > 0.1


def last_laws():
    return [
        RateOfDescent().build(BRIEFING, 0.5), GravityTurn().build(BRIEFING, 0.5),
        VelocityNull().build(BRIEFING, 0.5), VerticalDescent().for_lag(0.5, G, 1100.0),
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_commands_are_finite_whatever_the_state(seed):
    """10,000 states a law."""
    rng = np.random.default_rng(seed)
    laws = last_laws()
    for time in range(2500):
        scale = 10.0 ** rng.uniform(-3.0, 4.0, 2)
        state = estimate(scale[0] * rng.standard_normal(3), scale[1] * rng.standard_normal(3))
        for law in laws:
            command = law.command(state, GROUND, float(time))
            assert np.isfinite(command).all()


@pytest.mark.parametrize("which", range(4))
@settings(max_examples=300)
@given(
    bad=st.sampled_from([np.nan, np.inf, -np.inf]), at=st.integers(0, 6),
    r=arrays(np.float64, 3, elements=st.floats(-1e3, 1e3)),
    v=arrays(np.float64, 3, elements=st.floats(-50.0, 50.0)),
)  # fmt: skip
def test_what_is_not_finite_is_refused(which, bad, at, r, v):
    given_ = [*r, *v, 1300.0]
    given_[at] = bad
    here = replace(estimate(given_[:3], given_[3:6]), mass=given_[6])
    with pytest.raises(InputError, match="guidance"):
        last_laws()[which].command(here, GROUND, 0.0)
    with pytest.raises(InputError, match="guidance"):
        climb(here, 4.0)


def test_time_to_go_of_braking_is_that_of_the_jerk():
    """Along a quartic that ends with the jerk, the cubic gives the time that is left."""
    part = Braking(
        end_position=(-600.0, 0.0, 500.0), end_velocity=(30.0, 0.0, -15.0),
        end_acceleration=(-1.0, 0.0, 0.4), jerk=0.015, time_to_go=50.0,
    )  # fmt: skip
    end = part.end(np.zeros(3))
    for left in (48.0, 30.0, 12.0):
        t, snap = -left, 2e-4
        x = -600.0 + 30.0 * t - 0.5 * t**2 + 0.015 * t**3 / 6.0 + snap * t**4 / 24.0
        v = 30.0 - t + 0.015 * t**2 / 2.0 + snap * t**3 / 6.0
        here = estimate([x, 3.0, 900.0], [v, 0.0, -20.0])
        assert part.time_left(here, end, 1.1 * left) == pytest.approx(left, rel=1e-6)
    # No root near the guess: it stays; without a jerk it runs down.
    assert part.time_left(estimate([9e5, 0, 0], [-3.0, 0, 0]), end, 40.0) == 40.0
    assert Braking().time_left(here, end, 33.0) == 33.0


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"law": "apolo"}, "braking.law"),
        ({"end_time_to_go": 60.0}, "braking.end_time_to_go"),
        ({"max_tilt": 3.2}, "braking.max_tilt"),
    ],
)
def test_braking_that_cannot_be_is_refused(changes, field):
    with pytest.raises(InputError) as refused:
        Braking(**changes)
    assert refused.value.field.startswith(field)
