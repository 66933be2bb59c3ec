"""Every law against its boundary values, against each other and on whatever it may be asked."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp
from scipy.optimize import LinearConstraint, minimize

from lunarsim.core.feedback import fractional_polynomial
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.apollo import ApolloLaw, jerk_time_to_go
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.jerk_limited import max_jerk_and_snap
from lunarsim.onboard.guidance.path_guidance import CompiledFeedback
from lunarsim.onboard.guidance.paths import APOLLO, E_GUIDANCE, PathShape
from lunarsim.onboard.guidance.polynomial_laws import (
    AugmentedApolloLaw,
    FractionalPolynomialLaw,
    ModifiedApolloLaw,
    ZemZevLaw,
    fractional_shape,
)
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.registry import kinds, resolve

G = 1.622
UP = np.array([0.0, 0.0, G])
APART = {"optimal", "neural-optimal", "information-seeking"}  # these have tests of their own
LAWS = [
    *(
        resolve("guidance", kind)()
        for kind in kinds("guidance", with_files=False)
        if kind not in APART
    ),
    AugmentedApolloLaw(gain=14.0), FractionalPolynomialLaw(gamma=0.2, gain=5.0),
]  # fmt: skip
BRIEFING = SimpleNamespace(surface_gravity=G, nonuniform_gravity=None)
R, V = np.array([-600.0, 50.0, 500.0]), np.array([28.0, 1.0, -18.0])
END = PhaseEnd(
    np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.5, -2.0]), np.array([0.05, 0.0, 0.1])
)  # fmt: skip


def estimate(position, velocity) -> Estimate:
    return Estimate(
        0.0, np.asarray(position, float), np.asarray(velocity, float),
        np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1500.0, np.eye(9),
    )  # fmt: skip


lengths = arrays(np.float64, 3, elements=st.floats(-1000.0, 1000.0))
speeds = arrays(np.float64, 3, elements=st.floats(-50.0, 50.0))
powers = st.tuples(st.floats(0.0, 3.0), st.floats(0.1, 3.0)).map(lambda p: (p[0], p[0] + p[1]))


@given(lengths, speeds, lengths, speeds, speeds, st.floats(5.0, 200.0), powers)
def test_paths_meet_all_boundary_values(r, v, rf, vf, af, time_to_go, powers):
    path = PathShape(*powers).path(r, v, PhaseEnd(rf, vf, af / 50.0), time_to_go)
    start, end = path.at(0.0), path.at(time_to_go)
    scale = 1e-10 * (1.0 + 1000.0 + 50.0 * time_to_go)
    assert np.allclose(start[0], r, atol=scale)
    assert np.allclose(start[1], v, atol=scale)
    assert np.allclose(start[2], path.command, atol=1e-12 * scale + 1e-12)
    assert np.array_equal(end[0], rf)
    assert np.array_equal(end[1], vf)
    if powers[0] > 0.0:
        assert np.array_equal(end[2], af / 50.0)


def test_velocity_and_acceleration_are_the_derivatives_of_position():
    path = PathShape(0.5, 1.7).path(R, V, END, 40.0)
    t = np.linspace(0.0, 39.0, 40_001)
    r, v, a = path.at(t)
    assert np.allclose(np.gradient(r, t, axis=0)[1:-1], v[1:-1], atol=1e-5)
    assert np.allclose(np.gradient(v, t, axis=0)[1:-1], a[1:-1], atol=1e-5)


@given(lengths, speeds, lengths, speeds, speeds, st.floats(5.0, 200.0), powers)
def test_lu_s_feedback_is_the_start_of_the_path(r, v, rf, vf, af, time_to_go, powers):
    """Apollo and E-guidance are cases of it: gains 12 and 6 at gamma = 1."""
    end = PhaseEnd(rf, vf, af / 50.0)
    low, high = powers
    gain = (low + 2.0) * (high + 2.0)
    for gamma in powers:
        law = CompiledFeedback(fractional_polynomial, G, (gamma, gain))
        acceleration = law(r, v, end, time_to_go)
        path = PathShape(low, high).path(r, v, end, time_to_go)
        assert np.allclose(acceleration, path.command, rtol=1e-6, atol=1e-6)
    for shape, gain in ((E_GUIDANCE, 6.0), (APOLLO, 12.0)):
        law = AugmentedApolloLaw(gain=gain).feedback(G)
        acceleration = law(r, v, end, time_to_go)
        assert np.allclose(acceleration, shape.path(r, v, end, time_to_go).command, atol=1e-8)
    assert np.allclose(
        ZemZevLaw().feedback(G)(r, v, end, time_to_go),
        E_GUIDANCE.path(r, v, end, time_to_go).command, atol=1e-8,
    )  # fmt: skip


def test_e_guidance_has_the_least_effort():
    """Against a numerical optimum over accelerations in 40 steps."""
    steps, total = 40, 40.0
    h = total / steps
    left = total - h * (np.arange(steps) + 0.5)  # of the middle of each step
    for axis in (0, 2):
        rows = np.stack((np.full(steps, h), h * left))
        v0, r0 = V[axis], R[axis]
        asked = np.array(
            [END.velocity[axis] - v0 + UP[axis] * total,
             END.position[axis] - r0 - v0 * total + 0.5 * UP[axis] * total**2]
        )  # fmt: skip
        best = minimize(
            lambda u: h * np.sum(u**2), np.zeros(steps), jac=lambda u: 2.0 * h * u,
            constraints=LinearConstraint(rows, asked, asked),
            method="SLSQP", options={"ftol": 1e-12, "maxiter": 200},
        )  # fmt: skip
        mid = E_GUIDANCE.path(R, V, END, total).at(h * (np.arange(steps) + 0.5))[2][:, axis]
        assert np.allclose(mid + UP[axis], best.x, atol=2e-3)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_fed_continuously_the_end_is_met(law):
    """Perfect actuation: the terminal error is 1e-9 of the range."""
    total, stop = 40.0, 0.01
    flown = law.build(BRIEFING, 0.0)

    def motion(t, y):
        fresh = law.build(BRIEFING, 0.0)
        fresh.min_time_to_go = 0.0
        wanted = fresh.command(estimate(y[:3], y[3:]), END, t, total - t)
        return np.concatenate((y[3:], wanted - UP))

    y = solve_ivp(
        motion, (0.0, total - stop), np.concatenate((R, V)), rtol=1e-12, atol=1e-10,
        method="DOP853",
    ).y[:, -1]  # fmt: skip
    path = flown.shape.path(R, V, END, total)
    reach = np.linalg.norm(R - END.position)
    r, v, _ = path.at(total - stop)
    assert np.linalg.norm(y[:3] - r) < 1e-9 * reach
    assert np.linalg.norm(y[3:] - v) < 1e-7 * reach


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_with_held_commands_the_error_falls_with_the_cycle(law):
    """Held commands err by order one in the cycle; the loop takes most of it out.

    Where the loop opens, `min_time_to_go` before the end, what is left is of second order.
    """

    def miss(cycle):
        total = 40.0
        flown = law.build(BRIEFING, 0.0)
        r, v = R.copy(), V.copy()
        for n in range(round((total - 2.0) / cycle)):
            a = flown.command(estimate(r, v), END, n * cycle, total - n * cycle) - UP
            r, v = r + cycle * v + 0.5 * cycle**2 * a, v + cycle * a
        path = flown.shape.path(R, V, END, total)
        return np.linalg.norm(r - path.at(total - 2.0)[0])

    errors = np.array([miss(cycle) for cycle in (0.2, 0.1, 0.05)])
    order = np.log2(errors[:-1] / errors[1:])
    assert np.all((order > 0.85) & (order < 1.3)), (errors, order)
    assert errors[-1] < 0.5


def states(count):
    """Return positions, velocities (n, 3) and times-to-go (n,), near and absurd alike."""
    rng = np.random.default_rng(8)
    scale = 10.0 ** rng.uniform(-3.0, 6.0, (count, 1))
    times = rng.choice([-1e3, -1.0, 0.0, 1e-9, 0.05, 1.0, 1e4], count) * rng.uniform(
        0.5, 1.0, count
    )
    lags = rng.choice([0.0, 0.4], count)
    return (
        scale * rng.normal(size=(count, 3)),
        0.1 * scale * rng.normal(size=(count, 3)),
        times,
        lags,
    )


def all_finite(law, every):
    r, v, times, lags = states(10_000)
    for k in range(0, len(r), every):
        flown = law.build(BRIEFING, lags[k])
        for t in (0.0, 0.1, 5.0):
            got = flown.command(estimate(r[k], v[k]), END, t, times[k] - t)
            assert got.shape == (3,)
            assert np.isfinite(got).all()


def named(law):
    return type(law).__name__


@pytest.mark.parametrize("law", LAWS, ids=named)
def test_states_never_give_a_command_that_is_not_finite(law):
    all_finite(law, 2 if type(law) is ApolloLaw else 10)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS, ids=named)
def test_ten_thousand_states_never_give_a_command_that_is_not_finite(law):
    all_finite(law, 1)


@pytest.mark.parametrize("law", LAWS, ids=named)
def test_ten_thousand_states_have_a_cost_or_none(law):
    """What it takes is a number where there is a path, and inf and NaN together where none is."""
    r, v, times, _ = states(10_000)
    lander, reached = Lander(), 0
    for k in range(0, len(r), 100):
        # From one state to where a hundred others are.
        ends = PhaseEnd(r[k : k + 100], 0.1 * v[k])
        here = estimate(r[k - 1] if k else R, v[k - 1])
        cost = law.cost(here, ends, lander, G)
        spent, took = cost.propellant, cost.time_to_go
        assert not np.isnan(spent).any()
        assert np.array_equal(np.isfinite(spent), np.isfinite(took))
        good = np.isfinite(spent)
        assert (spent[good] > 0.0).all()
        assert (spent[good] <= here.mass - lander.dry_mass).all()
        assert (took[good] > 0.0).all()
        reached += good.sum()
    assert reached > 50


bad = st.sampled_from([np.nan, np.inf, -np.inf])


@pytest.mark.parametrize("law", LAWS, ids=named)
@settings(max_examples=300)
@given(value=bad, which=st.integers(0, 6), r=lengths, v=speeds, left=st.floats(-100.0, 1e3))
def test_what_is_not_finite_is_refused(law, value, which, r, v, left):
    state = [*r, *v, left]
    state[which] = value
    flown = law.build(BRIEFING, 0.3)
    with pytest.raises(InputError, match="guidance"):
        flown.command(estimate(state[:3], state[3:6]), END, 0.0, state[6])


def test_time_to_go_by_the_jerk_at_the_end():
    """Klumpp's cubic: the quartic of that time ends with that jerk."""
    path = APOLLO.path(R, V, END, 37.0)
    jerk = -path.terms[0] / path.time_to_go
    found = jerk_time_to_go(
        R[0], V[0], (END.position[0], END.velocity[0], END.acceleration[0]), jerk[0], guess=30.0
    )
    assert found == pytest.approx(37.0, rel=1e-9)
    assert np.isnan(jerk_time_to_go(0.0, 1.0, (-10.0, 5.0, 0.0), 1.0, guess=3.0))
    with pytest.raises(InputError, match="position"):
        jerk_time_to_go(np.nan, 1.0, (-10.0, 5.0, 0.0), 1.0, guess=3.0)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"gamma": 1.0, "gain": 9.0}, "gain"),
        ({"gamma": 2.0, "gain": 7.0}, "gain"),
        ({"gamma": -0.1, "gain": 9.0}, "gamma"),
    ],
)
def test_impossible_parameters_are_refused(given, field):
    with pytest.raises(InputError, match=field):
        FractionalPolynomialLaw(**given)
    with pytest.raises(InputError, match="powers"):
        PathShape(2.0, 1.0)
    assert fractional_shape(2.0, 12.0).powers == (1.0, 2.0)


def test_modified_apollo_keeps_its_limits():
    lander = Lander()
    here = replace(estimate(R, V), mass=1480.0)
    law = ModifiedApolloLaw(jerk=0.06, snap=0.01)
    sites = np.array([[x, y, 12.0] for x in (-60.0, 0.0, 90.0) for y in (-40.0, 30.0)])
    cost = law.cost(here, PhaseEnd(sites, END.velocity), lander, G)
    free = ApolloLaw().cost(here, PhaseEnd(sites, END.velocity), lander, G)
    assert cost.feasible.all()
    assert np.all(cost.propellant >= free.propellant * (1.0 - 5e-3))
    broken = 0
    for n, site in enumerate(sites):
        for law_cost, keeps in ((cost, True), (free, False)):
            path = APOLLO.path(R, V, PhaseEnd(site, END.velocity), law_cost.time_to_go[n])
            jerk, snap = max_jerk_and_snap(path)
            ok = jerk <= 0.06 * (1.0 + 1e-6) and snap <= 0.01 * (1.0 + 1e-6)
            assert ok or not keeps
            broken += not ok
    assert broken > 0
