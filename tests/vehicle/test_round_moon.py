"""A round, turning Moon: orbits by Kepler, falls in a frame that turns, and level ground nearby."""

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.gravity import CentralGravity, RoundMoon, UniformGravity
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.vehicle import Dynamics, State

G, R = 1.6229, 1_737_400.0
OUTBOARD = {
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
    "tasking": {},
    "mappers": {},
}


def _coast(moon, position, velocity, seconds, step):
    """Return position and velocity (3,) after a fall without thrust."""
    dynamics = Dynamics(Lander(), moon.magnitude, step, moon)
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(np.array(position), np.array(velocity), upright, np.zeros(3), 1500.0)
    for _ in range(round(seconds / step)):
        state = dynamics.advance(state, 0.0, np.zeros(3))
    return state.position, state.velocity


def _turned(axis, angle, v):
    """Rodrigues, written out."""
    k = np.asarray(axis) / np.linalg.norm(axis)
    c, s = np.cos(angle), np.sin(angle)
    return v * c + np.cross(k, v) * s + k * (k @ v) * (1.0 - c)


def test_half_an_orbit_is_keplers():
    moon = RoundMoon().gravity(G)
    mu = G * R**2
    low, high = R + 15_240.0, R + 110_000.0
    axis = 0.5 * (low + high)
    fast = np.sqrt(mu * (2.0 / low - 1.0 / axis))
    # Westward, seen from ground that turns: faster by what the ground does.
    start = np.array([0.0, 0.0, 15_240.0])
    velocity = np.array([-fast, 0.0, 0.0]) - np.cross(moon.spin, [0.0, 0.0, low])
    seconds = np.pi * np.sqrt(axis**3 / mu)
    step = seconds / 5_000
    r, v = _coast(moon, start, velocity, seconds, step)
    rc, vi = moon.position_from_centre(r), moon.inertial_velocity(r, v)
    assert np.linalg.norm(rc) == pytest.approx(high, abs=1e-3)
    energy = 0.5 * vi @ vi - mu / np.linalg.norm(rc)
    assert energy == pytest.approx(-mu / (2.0 * axis), rel=1e-11)
    assert np.linalg.norm(np.cross(rc, vi)) == pytest.approx(low * fast, rel=1e-11)
    # Opposite to where it began, in a frame that has not turned.
    still = _turned(moon.spin, np.linalg.norm(moon.spin) * seconds, rc)
    assert still == pytest.approx([0.0, 0.0, -high], abs=0.1)


@pytest.mark.parametrize("latitude", [0.0, 0.6, -1.2])
def test_a_turning_frame_sees_the_same_fall_turned(latitude):
    turning = RoundMoon(spin=3e-3, latitude=latitude).gravity(G)
    still = CentralGravity(G, R, np.zeros(3))
    position, velocity = np.array([400.0, -900.0, 30_000.0]), np.array([120.0, 40.0, 15.0])
    seen = _coast(turning, position, velocity, 60.0, 0.02)
    meant = _coast(still, position, turning.inertial_velocity(position, velocity), 60.0, 0.02)
    back = -3e-3 * 60.0
    rc = _turned(turning.spin, back, still.position_from_centre(meant[0]))
    vi = _turned(turning.spin, back, meant[1])
    assert turning.position_from_centre(seen[0]) == pytest.approx(rc, abs=1e-5)
    assert turning.inertial_velocity(*seen) == pytest.approx(vi, abs=1e-8)


def test_a_stone_falls_east_of_the_plumb_line():
    # Coriolis alone: W g t^3 cos(latitude) / 3 to the east.
    spin, latitude, t = 2e-5, 0.5, 40.0
    moon = RoundMoon(spin=spin, latitude=latitude).gravity(G)
    r, _ = _coast(moon, [0.0, 0.0, 2_000.0], [0.0, 0.0, 0.0], t, 0.05)
    assert r[0] == pytest.approx(spin * G * t**3 * np.cos(latitude) / 3.0, rel=5e-3)
    # Centrifugal: towards the equator by W^2 R sin cos t^2 / 2.
    assert r[1] == pytest.approx(
        -0.5 * spin**2 * R * np.sin(latitude) * np.cos(latitude) * t**2, rel=1e-2
    )


def test_what_guidance_knows_is_what_moves_the_vehicle():
    rng = np.random.default_rng(3)
    moon = RoundMoon(spin=1e-4, latitude=0.3).gravity(G)
    for _ in range(20):
        r, v = rng.normal(0.0, 2e5, 3), rng.normal(0.0, 800.0, 3)
        v1 = _coast(moon, r, v, 1e-3, 1e-3)[1]
        assert (v1 - v) / 1e-3 == pytest.approx(moon.free_fall_acceleration(r, v), abs=1e-5)


def test_flat_terrain_is_left_within_what_curvature_says():
    """Where and how far both agree: (2 h / R) g more or less, and s / R g sideways."""
    moon, flat = RoundMoon().gravity(G), UniformGravity(G)
    for way, height in ((600.0, 500.0), (1_000.0, 1_000.0), (10_000.0, 2_500.0)):
        where = np.array([-way, 0.0, height])
        off = moon.free_fall_acceleration(where, np.zeros(3)) - flat.free_fall_acceleration(
            where, np.zeros(3)
        )
        assert off[0] == pytest.approx(G * way / R, rel=0.02)
        assert off[2] == pytest.approx(2.0 * G * height / R, rel=0.03, abs=2e-5)
        assert moon.height(where) - height == pytest.approx(way**2 / (2.0 * R), rel=0.01)


@pytest.fixture(scope="module")
def both_flights():
    plain = Scenario.from_dict(
        {**OUTBOARD, "rocks": {"cover": 0.0}, "policy": {"kind": "no-divert"}}
    )
    return [Simulation(s, 4, "no-divert").run() for s in (plain, plain.changed(moon={}))]


def test_the_last_kilometre_is_the_same_on_both(both_flights):
    flat, moon = both_flights
    assert flat.outcome.safe
    assert moon.outcome.safe
    rows = min(len(flat.positions), len(moon.positions))
    # Feedback keeps the paths together; what it makes up for shows in the propellant.
    assert np.abs(flat.positions[:rows] - moon.positions[:rows]).max() < 0.3
    assert moon.propellant_used == pytest.approx(flat.propellant_used, rel=2e-3)
    assert moon.propellant_used != flat.propellant_used


def test_an_inertial_unit_feels_thrust_alone():
    scenario = Scenario.from_dict({**OUTBOARD, "moon": {"spin_deg_s": 0.02}})
    sim = Simulation(scenario, 1, "no-divert")
    plant = sim.plant
    y = plant.state.as_vector()
    y[0:3], y[3:6], y[14] = (-300_000.0, 0.0, 15_000.0), (1_600.0, 20.0, 5.0), 0.0
    rows = [y]
    for _ in range(10):
        state = State.from_vector(rows[-1])
        rows.append(plant.dynamics.advance(state, 0.0, np.zeros(3)).as_vector())
    freed, _, lift = plant.gravity_free_states(np.array(rows))
    assert lift == 0.0
    assert np.abs(np.diff(freed[:, 3:6], axis=0)).max() < 1e-9


@pytest.mark.parametrize("name", ["instruments", "shadow_nominal", "morpheus"])
def test_navigation_with_an_inertial_unit_has_the_gravity_of_the_round_moon(name):
    changed = Scenario.load(f"scenarios/{name}.toml").changed(moon={})
    computer = Simulation(changed, 1, "no-divert").computer
    fall = computer.briefing.nonuniform_gravity.free_fall_acceleration([0.0] * 3, [0.0] * 3)
    assert fall[2] == pytest.approx(-changed.gravity_m_s2, abs=1e-4)


def test_figures_are_checked():
    with pytest.raises(InputError, match="radius"):
        RoundMoon(radius=-1.0)
