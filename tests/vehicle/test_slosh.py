"""Pendulums in the tanks: what they are, what they do to the body, and what they keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import j1, jnp_zeros

from lunarsim.errors import InputError
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.slosh import FIRST_MODE, Slosh
from lunarsim.vehicle import Dynamics, State
from lunarsim.vehicle.actuators import Actuators
from lunarsim.vehicle.dynamics import build_rig
from lunarsim.vehicle.slosh import SloshPendulums
from tests.reference import slosh as plain

TWO = Slosh(
    tanks=((0.5, 0.1, -0.3), (-0.4, 0.2, 0.2)),
    propellant_fractions=(0.6, 0.4),
    radius=0.35,
    damping=0.0,
)
LANDER = JetLander(thrust_lag=0.0, slosh=TWO, com_dry=(0.02, 0.0, 0.1), com_full=(0.0, 0.03, -0.1))
ALMOST_NOTHING = 1e-12


def start(lander: JetLander, fill: float = 0.7, **changes) -> State:
    mass = lander.dry_mass + fill * lander.propellant_mass
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    return replace(State(np.zeros(3), np.zeros(3), upright, np.zeros(3), mass), **changes)


def swung(liquid: SloshPendulums, rng: np.random.Generator, angle: float = 0.5) -> None:
    """Set rods and their rates anyhow."""
    for row in liquid.rod_states:
        u = Rotation.from_rotvec(angle * rng.standard_normal(3)).apply([0.0, 0.0, -1.0])
        row[:3], row[3:] = u, np.cross(rng.standard_normal(3), u)


def parts(lander: JetLander, mass: float):
    """Return what does not swing (mass, inertia, centre), and masses, lengths and hinges."""
    fill = (mass - lander.dry_mass) / lander.propellant_mass
    m, length, bobs = lander.slosh.pendulums(fill, lander.propellant_mass)
    com = lander.com(mass)
    rest = mass - m.sum()
    middle = (mass * com - m @ bobs) / rest
    inertia = np.diag(lander.inertia(mass))
    for one, place in [*zip(m, bobs, strict=True), (rest, middle)]:
        d = place - com
        inertia = inertia - one * (d @ d * np.eye(3) - np.outer(d, d))
    return (rest, inertia, middle), com, m, length, bobs + length[:, None] * [0.0, 0.0, 1.0]


def absolute(lander: JetLander, state: State, rod_states):
    """Return centre, speed, quaternion, rate, bobs and their speeds, one array."""
    (_, _, middle), com, _, length, hinges = parts(lander, state.mass)
    turn, w = Rotation.from_quat(state.attitude), state.rate

    def place(point, moving=0.0):
        arm = np.asarray(point) - com
        return (
            state.position + turn.apply(arm),
            state.velocity + turn.apply(np.cross(w, arm) + moving),
        )

    out = [*place(middle), state.attitude, w]
    for row, one, hinge in zip(rod_states, length, hinges, strict=True):
        out += place(hinge + one * row[:3], one * row[3:])
    return np.concatenate(out)


def kept(lander: JetLander, state: State, rod_states, gravity: float = 0.0):
    """Return momentum, angular momentum about the origin and energy."""
    (rest, inertia, _), _, m, _, _ = parts(lander, state.mass)
    y = absolute(lander, state, rod_states)
    turn = Rotation.from_quat(state.attitude)
    momentum, spin = rest * y[3:6], rest * np.cross(y[:3], y[3:6])
    spin = spin + turn.apply(inertia @ state.rate)
    energy = 0.5 * rest * y[3:6] @ y[3:6] + 0.5 * state.rate @ inertia @ state.rate
    energy += gravity * rest * y[2]
    for one, place, speed in zip(m, y[13:].reshape(-1, 6)[:, :3], y[13:].reshape(-1, 6)[:, 3:],
                                 strict=True):  # fmt: skip
        momentum = momentum + one * speed
        spin = spin + one * np.cross(place, speed)
        energy += 0.5 * one * speed @ speed + gravity * one * place[2]
    return momentum, spin, energy


def tossed(rng: np.random.Generator, lander: JetLander) -> State:
    q = rng.standard_normal(4)
    return start(
        lander, velocity=rng.normal(0.0, 3.0, 3), attitude=q / np.linalg.norm(q),
        rate=rng.normal(0.0, 0.4, 3),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_motion_is_that_of_bodies_joined_by_rods(seed):
    rng = np.random.default_rng(seed)
    damping = 0.05 * (seed % 2)
    lander = replace(LANDER, slosh=replace(TWO, damping=damping))
    state, liquid = tossed(rng, lander), SloshPendulums(lander)
    swung(liquid, rng)
    force, torque = rng.normal(0.0, 300.0, 3), rng.normal(0.0, 80.0, 3)
    body, _, m, length, hinges = parts(lander, state.mass)
    push = np.linalg.norm(force) / state.mass
    drag = 2.0 * damping * np.sqrt(push / length) * m
    rods = list(zip(m, hinges, length, drag, strict=True))
    y = absolute(lander, state, liquid.rod_states)
    wanted = plain.moved(y, 0.5, force, torque, 1.6, body, rods)
    dynamics = Dynamics(lander, 1.6, 0.0025)
    rig = build_rig(force=force, com_dry=lander.com_dry, com_full=lander.com_full)
    for _ in range(200):
        state = liquid.advance(dynamics, state, 0.0, torque, rig)
    found = absolute(lander, state, liquid.rod_states)
    # The same attitude has two quaternions.
    found[6:10] *= np.sign(found[6:10] @ wanted[6:10])
    assert np.abs(wanted[10:13] - y[10:13]).max() > 0.02
    assert found == pytest.approx(wanted, rel=1e-7, abs=1e-7)


def test_momentum_and_energy_are_kept_without_damping():
    rng = np.random.default_rng(7)
    state, liquid = tossed(rng, LANDER), SloshPendulums(LANDER)
    swung(liquid, rng)
    dynamics = Dynamics(LANDER, ALMOST_NOTHING, 0.005)
    rig = build_rig(com_dry=LANDER.com_dry, com_full=LANDER.com_full)
    first, before = kept(LANDER, state, liquid.rod_states), state
    for _ in range(4000):
        state = liquid.advance(dynamics, state, 0.0, np.zeros(3), rig)
    last = kept(LANDER, state, liquid.rod_states)
    assert np.linalg.norm(state.rate - before.rate) > 0.05
    assert last[0] == pytest.approx(first[0], rel=1e-9, abs=1e-6)
    assert last[1] == pytest.approx(first[1], rel=1e-7, abs=1e-4)
    assert last[2] == pytest.approx(first[2], rel=1e-8)


def test_gravity_pulls_liquid_and_lander_alike():
    rng = np.random.default_rng(3)
    state, liquid = tossed(rng, LANDER), SloshPendulums(LANDER)
    swung(liquid, rng)
    dynamics = Dynamics(LANDER, 1.6, 0.005)
    rig = build_rig(com_dry=LANDER.com_dry, com_full=LANDER.com_full)
    first = kept(LANDER, state, liquid.rod_states, 1.6)
    for _ in range(1000):
        state = liquid.advance(dynamics, state, 0.0, np.zeros(3), rig)
    momentum, _, energy = kept(LANDER, state, liquid.rod_states, 1.6)
    assert energy == pytest.approx(first[2], rel=1e-8)
    assert momentum - first[0] == pytest.approx([0.0, 0.0, -1.6 * 5.0 * state.mass], abs=1e-5)


def test_damping_takes_the_swing_and_no_momentum():
    force, ends = np.array([0.0, 0.0, 2500.0]), []
    for damping in (0.0, 0.05):
        lander = replace(LANDER, slosh=replace(TWO, damping=damping))
        state, liquid = start(lander), SloshPendulums(lander)
        swung(liquid, np.random.default_rng(5), 0.2)
        rig = build_rig(force=force, com_dry=lander.com_dry, com_full=lander.com_full)
        dynamics = Dynamics(lander, ALMOST_NOTHING, 0.005)
        gained, first = np.zeros(3), kept(lander, state, liquid.rod_states)[0]
        for _ in range(4000):
            before, state = state, liquid.advance(dynamics, state, 0.0, np.zeros(3), rig)
            both = Rotation.from_quat([before.attitude, state.attitude]).apply(force)
            gained += 0.0025 * both.sum(axis=0)
        momentum = kept(lander, state, liquid.rod_states)[0] - first
        assert np.linalg.norm(gained) > 1e4
        assert momentum == pytest.approx(gained, abs=0.05)
        ends.append(np.abs(liquid.rod_states[:, 3:]).max())
    assert ends[1] < 0.1 * ends[0]


def moments(inertia: float) -> dict:
    return {"inertia_dry": (inertia,) * 3, "inertia_full": (inertia,) * 3}


@pytest.mark.parametrize("floor", [-0.9, -0.15, 0.5])
def test_frequency_under_constant_acceleration(floor):
    """(a / L) (1 + w / M + w p (p - L) / I), with the hinge p above the rest's centre of mass."""
    lander = JetLander(
        thrust_lag=0.0, **moments(1800.0),
        slosh=Slosh(tanks=((0.0, 0.0, floor),), radius=0.5, height=0.4, damping=0.0),
    )  # fmt: skip
    state, liquid = start(lander, fill=1.0), SloshPendulums(lander)
    (rest, inertia, middle), _, m, length, hinges = parts(lander, state.mass)
    a = 3000.0 / state.mass
    p = hinges[0, 2] - middle[2]
    square = a / length[0] * (1.0 + m[0] / rest + m[0] * p * (p - length[0]) / inertia[1, 1])
    lean = 1e-3
    liquid.rod_states[0, :3] = [np.sin(lean), 0.0, -np.cos(lean)]
    rig = build_rig(force=(0.0, 0.0, 3000.0))
    dynamics = Dynamics(lander, ALMOST_NOTHING, 0.002)
    seen = [lean]
    for _ in range(6000):
        state = liquid.advance(dynamics, state, 0.0, np.zeros(3), rig)
        seen.append(float(liquid.rod_states[0, 0]))
    x = np.array(seen)
    n = np.flatnonzero((x[:-1] > 0.0) != (x[1:] > 0.0))
    zeros = 0.002 * (n + x[n] / (x[n] - x[n + 1]))
    assert len(zeros) >= 6
    period = 2.0 * np.mean(np.diff(zeros))
    assert 2.0 * np.pi / period == pytest.approx(np.sqrt(square), rel=1e-5)
    assert np.abs(x).max() == pytest.approx(lean, rel=1e-4)


def test_damping_is_a_share_of_the_critical_one():
    """In a lander so heavy that it does not answer, a swing falls by exp(-2 pi zeta) a turn."""
    lander = JetLander(
        thrust_lag=0.0, dry_mass=1e6, propellant_mass=400.0, **moments(1e7), thrust_max=1e7,
        slosh=Slosh(tanks=((0.0, 0.0, 0.0),), radius=0.5, height=0.4, damping=0.03),
    )  # fmt: skip
    state, liquid = start(lander, fill=1.0), SloshPendulums(lander)
    liquid.rod_states[0, :3] = [1e-3, 0.0, -np.sqrt(1.0 - 1e-6)]
    _, length, _ = lander.slosh.pendulums(1.0, 400.0)
    rig = build_rig(force=(0.0, 0.0, 2.0 * state.mass))
    turns = 5.0 * 2.0 * np.pi / np.sqrt(2.0 / length[0] * (1.0 - 0.03**2))
    step = turns / 2000
    for _ in range(2000):
        state = liquid.advance(Dynamics(lander, ALMOST_NOTHING, step), state, 0.0, np.zeros(3), rig)
    wanted = np.exp(-10.0 * np.pi * 0.03 / np.sqrt(1.0 - 0.03**2))
    assert liquid.rod_states[0, 0] / 1e-3 == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize("depth", [0.1, 0.7, 3.0])
def test_pendulum_is_the_first_wave_of_a_cylinder(depth):
    """Length by its frequency, mass and hinge by the pressure of the wave on wall and floor."""
    e = float(jnp_zeros(1, 1)[0])
    assert e == pytest.approx(FIRST_MODE, rel=1e-12)
    radius, density = 0.4, 1000.0
    h = depth * radius
    propellant = density * np.pi * radius**2 * h
    slosh = Slosh(tanks=((0.0, 0.0, 0.0),), radius=radius, height=h)
    (mass,), (length,), (bob,) = slosh.pendulums(1.0, propellant)
    k = e / radius
    assert 1.0 / length == pytest.approx(k * np.tanh(k * h), rel=1e-12)
    # Pressure J1(k r) cos(angle) cosh(k z); force on the wall, moment of wall and floor.
    wall = np.pi * radius * j1(e) * quad(lambda z: np.cosh(k * z), 0.0, h)[0]
    high = np.pi * radius * j1(e) * quad(lambda z: z * np.cosh(k * z), 0.0, h)[0]
    floor = np.pi * quad(lambda r: r * r * j1(k * r), 0.0, radius)[0]
    assert bob[2] + length == pytest.approx((high + floor) / wall, rel=1e-9)
    # A tank that is shaken moves this share of the liquid with the wave.
    norm = quad(lambda r: r * j1(k * r) ** 2, 0.0, radius)[0]
    moved = quad(lambda r: r * r * j1(k * r), 0.0, radius)[0]
    share = np.pi * density * moved**2 / norm * k * np.tanh(k * h)
    assert mass == pytest.approx(share, rel=1e-9)


def test_all_modes_of_shallow_water_take_all_of_it():
    """The share of the liquid, 2 / (e^2 - 1) at no depth, adds up to 1 over the modes."""
    e = jnp_zeros(1, 4000)
    assert np.sum(2.0 / (e**2 - 1.0)) == pytest.approx(1.0, abs=1e-3)
    slosh = Slosh(tanks=((0.0, 0.0, 0.0),), radius=1.0, height=1e-4)
    assert slosh.pendulums(1.0, 1.0)[0][0] == pytest.approx(2.0 / (e[0] ** 2 - 1.0), rel=1e-6)


def test_liquid_at_rest_changes_nothing():
    """Thrust through the centre of mass of all: as if nothing could swing."""
    lander = JetLander(slosh=Slosh(tanks=((0.5, 0.0, -0.2), (-0.5, 0.0, -0.2))))
    still = replace(lander, slosh=Slosh())
    ends = []
    for one in (lander, still):
        actuators, state = Actuators(one, 0.01), start(one, 1.0)
        actuators.command(np.zeros(16), np.zeros(2))
        for _ in range(300):
            state = actuators.advance(Dynamics(one, 1.62, 0.01), state, 2500.0)
        ends.append(state.as_vector())
    assert ends[0] == pytest.approx(ends[1], rel=1e-12, abs=1e-12)
    assert ends[0][13] < 1500.0 - 2.0


def test_empty_tanks_swing_no_more():
    lander = JetLander(
        thrust_lag=0.0, propellant_mass=5.0, slosh=Slosh(tanks=((0.0, 0.0, 0.0),), height=0.1)
    )
    actuators, state = Actuators(lander, 0.01), start(lander, 1.0)
    actuators.slosh_pendulums.rod_states[0, :3] = [0.1, 0.0, -np.sqrt(0.99)]
    for _ in range(800):
        state = actuators.advance(Dynamics(lander, 1.62, 0.01), state, 3000.0)
        assert np.all(np.isfinite(state.as_vector()))
        assert np.all(np.isfinite(actuators.slosh_pendulums.rod_states))
    assert state.mass == pytest.approx(lander.dry_mass, abs=1e-6)
    dry = lander.exhaust_velocity * np.log(lander.wet_mass / lander.dry_mass)
    assert state.velocity[2] == pytest.approx(dry - 1.62 * 8.0, abs=0.05)
    assert np.all(actuators.slosh_pendulums.max_angles >= np.arcsin(0.1) - 1e-3)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Slosh(tanks=((0.0, 0.0),)), "slosh.tanks"),
        (lambda: Slosh(tanks=((0.0, float("nan"), 0.0),)), "slosh.tanks"),
        (lambda: Slosh(tanks=((0.0, 0.0, 0.0),), propellant_fractions=(0.5, 0.5)),
        "slosh.propellant_fractions"),
        (lambda: Slosh(tanks=((0.0, 0.0, 0.0),) * 2, propellant_fractions=(0.5, 0.6)),
        "slosh.propellant_fractions"),
        (lambda: Slosh(radius=0.0), "slosh.radius"),
        (lambda: Slosh(damping=1.0), "slosh.damping"),
        (lambda: JetLander(slosh=Slosh(tanks=((0.0, 0.0, 9.0),))), "vehicle.slosh.tanks_m"),
    ],
)  # fmt: skip
def test_tanks_that_cannot_be_are_refused(make, field):
    with pytest.raises(InputError) as refused:
        make()
    assert refused.value.field == field


def test_the_first_mode_is_a_zero_of_the_derivative():
    assert brentq(lambda x: j1(x + 1e-6) - j1(x - 1e-6), 1.5, 2.2) == pytest.approx(FIRST_MODE)


def test_masses_are_those_of_each_tank():
    """At 0.7 of 400 kg, of which the first tank has 0.6; depth 0.6 radii, by hand."""
    m, length, bobs = TWO.pendulums(0.7, 400.0)
    steep = np.tanh(1.8412 * 0.6)
    assert m == pytest.approx(
        np.array([168.0, 112.0]) * 2.0 * steep / (1.8412 * 2.39 * 0.6), rel=1e-4
    )
    assert length == pytest.approx([0.35 / 1.8412 / steep] * 2, rel=1e-4)
    up = 0.35 * (0.6 - 2.0 * np.tanh(0.5 * 1.8412 * 0.6) / 1.8412)
    assert bobs == pytest.approx(np.array([[0.5, 0.1, -0.3 + up], [-0.4, 0.2, 0.2 + up]]), rel=1e-4)


def test_what_thrusters_have_burnt_is_not_out_of_the_tanks():
    lander = JetLander(
        thrust_lag=0.0, dry_mass=1e6, **moments(1e7), thrust_max=1e7,
        slosh=Slosh(tanks=((0.0, 0.0, 0.0),), radius=0.5, height=0.2),
    )  # fmt: skip
    liquid, dynamics = SloshPendulums(lander), Dynamics(lander, 1.6, 1e-4)
    liquid.rod_states[0, :3] = [1e-3, 0.0, -np.sqrt(1.0 - 1e-6)]
    state = start(lander, 1.0)
    state = replace(state, mass=state.mass - 300.0)
    rig = build_rig(force=(0.0, 0.0, 2.0 * state.mass), spent=300.0)
    liquid.advance(dynamics, state, 0.0, np.zeros(3), rig)
    _, length, _ = lander.slosh.pendulums(1.0, 400.0)
    assert liquid.rod_states[0, 3] == pytest.approx(-1e-4 * 2.0 / length[0] * 1e-3, rel=1e-3)
    # Below the dry mass, which counts what thrusters have burnt, the engine still runs.
    low = replace(state, mass=lander.dry_mass - 250.0)
    moved = liquid.advance(dynamics, low, 5000.0, np.zeros(3), rig)
    assert moved.thrust == 5000.0
    assert moved.mass < low.mass
