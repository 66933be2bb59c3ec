"""Legs on the ground: energy, rest, friction and tipping, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust, quat_multiply, quat_rotate
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.rocks.field import RockField
from lunarsim.vehicle import Dynamics, State
from lunarsim.vehicle.legs import Legs, TerrainPatch, evaluate_motion, settle
from lunarsim.world.terrain import Terrain
from tests.worlds import flat_terrain, sloped_terrain

G, MASS = 1.622, 1300.0
LANDER, LEGS = Lander(), Legs()
UP = attitude_from_thrust([0.0, 0.0, 1.0], np.pi / 2)


def above(height=0.02, lander=LANDER, **changes) -> State:
    state = State(
        np.array([0.0, 0.0, lander.com_height + height]), np.array([0.0, 0.0, -2.0]), UP,
        np.zeros(3), MASS,
    )  # fmt: skip
    return replace(state, **changes)


def on_slope(degrees: float, **changes) -> tuple[State, Terrain]:
    """Return a lander that stands square on a slope up towards east, just above it."""
    lean = Rotation.from_rotvec([0.0, -np.deg2rad(degrees), 0.0])
    attitude = quat_multiply(lean.as_quat(), UP)
    place = lean.apply([0.0, 0.0, LANDER.com_height + 0.001])
    state = above(position=place, attitude=attitude, velocity=np.zeros(3))
    return replace(state, **changes), sloped_terrain((np.tan(np.deg2rad(degrees)), 0.0), 80.0)


def energy(lander: Lander, state: State) -> float:
    turning = 0.5 * float(lander.inertia(state.mass) @ state.rate**2)
    moving = 0.5 * state.mass * float(state.velocity @ state.velocity)
    return moving + turning + state.mass * G * float(state.position[2])


@pytest.mark.parametrize("seed", range(5))
def test_what_the_legs_take_up_is_what_the_lander_loses(seed):
    rng = np.random.default_rng(seed)
    lean = Rotation.from_rotvec(np.deg2rad(3.0) * rng.standard_normal(3)).as_quat()
    state = above(
        height=0.4, velocity=np.array([*rng.normal(0.0, 0.8, 2), -2.5]),
        attitude=quat_multiply(UP, lean), rate=0.05 * rng.standard_normal(3),
    )  # fmt: skip
    ground = Terrain(
        sloped_terrain((0.08, -0.03)).relief, RockField.hemispheres(1.6, 1.5, 0.0, 0.2)
    )
    rest = settle(LEGS, Dynamics(LANDER, G), state, ground)
    assert rest.settled
    lost = energy(LANDER, state) - energy(LANDER, rest.state)
    assert lost > 4000.0
    assert rest.energy == pytest.approx(lost, rel=2e-4)


def test_a_lander_set_down_rests_as_its_springs_say():
    """Compression m g / 4 k; nothing crushes; the body stays where it was but for that."""
    rest = settle(LEGS, Dynamics(LANDER, G), above(0.0, velocity=np.zeros(3)), flat_terrain())
    assert rest.settled
    assert rest.state.position[2] == pytest.approx(
        LANDER.com_height - MASS * G / (4.0 * LEGS.stiffness), abs=1e-5
    )
    assert rest.crushed == pytest.approx(0.0)
    assert rest.tilt < 1e-6
    assert rest.clearance == pytest.approx(LANDER.belly_clearance, abs=0.01)


@pytest.mark.parametrize("degrees", [4.0, 9.0])
def test_rest_on_a_plane_is_the_static_one(degrees):
    """Loads of the uphill and downhill pair balance the moment of the weight about the middle."""
    state, ground = on_slope(degrees)
    rest = settle(LEGS, Dynamics(LANDER, G), state, ground)
    assert rest.settled
    angle = np.deg2rad(degrees)
    arm = LANDER.leg_radius / np.sqrt(2.0)
    weight = MASS * G
    # Normal loads of a pair: half of the weight's normal part, and the moment of its tangential
    # part at the height of the centre of mass; each tilts the body against the ground.
    more = weight * np.sin(angle) * LANDER.com_height / (2.0 * arm)
    softer = np.arctan(2.0 * more / (2.0 * LEGS.stiffness) / (2.0 * arm))
    assert rest.tilt == pytest.approx(angle + softer, abs=3e-4)


@pytest.mark.parametrize(("friction", "slides"), [(0.30, False), (0.15, True)])
def test_it_slides_where_the_slope_is_steeper_than_friction(friction, slides):
    """tan(12 deg) = 0.213; what slides does so at g (sin - mu cos)."""
    state, ground = on_slope(12.0)
    ends = [
        settle(replace(LEGS, friction=friction, max_time=t), Dynamics(LANDER, G), state, ground)
        for t in (1.5, 2.5)
    ]
    assert ends[1].settled != slides
    if slides:
        angle = np.deg2rad(12.0)
        gained = np.linalg.norm(ends[1].state.velocity) - np.linalg.norm(ends[0].state.velocity)
        assert gained == pytest.approx(G * (np.sin(angle) - friction * np.cos(angle)), rel=0.01)
        assert ends[1].state.velocity[0] < 0.0


def test_the_honeycomb_takes_the_energy_that_springs_cannot():
    """A flat drop: what crushes takes its force times its length, friction none."""
    legs = replace(LEGS, damping=1.0)
    state = above(0.0, velocity=np.array([0.0, 0.0, -3.0]))
    rest = settle(replace(legs, max_time=0.25), Dynamics(LANDER, G), state, flat_terrain())
    spring = 0.5 * LEGS.crush_force**2 / LEGS.stiffness
    crushed = float(rest.crushed[0])
    fall = LEGS.crush_force / LEGS.stiffness + crushed
    needed = 0.5 * MASS * 9.0 + MASS * G * fall
    assert 4.0 * (spring + LEGS.crush_force * crushed) == pytest.approx(needed, rel=0.01)


def test_a_tall_lander_tips_at_the_speed_of_the_pendulum():
    """Stiff legs and much friction come near the rigid strike of the static tip margin."""
    lander = Lander(com_height=4.5, horizontal_speed_limit=9.0)
    legs = Legs(stiffness=2e6, damping=2e4, crush_force=1e7, friction=3.0)
    inertia = lander.inertia(MASS)[0]
    arm = lander.leg_radius / np.sqrt(2.0)
    length = np.hypot(arm, lander.com_height)
    # m v h = (I + m L^2) w;  (I + m L^2) w^2 / 2 = m g (L - h)
    about = inertia + MASS * length**2
    barrier = MASS * G * (length - lander.com_height)
    critical = np.sqrt(2.0 * about * barrier) / (MASS * lander.com_height)
    tipped = {}
    for share in (0.85, 1.25):
        velocity = np.array([share * critical, 0.0, -1e-3])
        state = above(0.0, lander, velocity=velocity)
        tipped[share] = settle(legs, Dynamics(lander, G), state, flat_terrain(80.0)).tipped
    assert tipped == {0.85: False, 1.25: True}


def test_outcomes_name_what_failed():
    dynamics = Dynamics(LANDER, G)
    good, rest = evaluate_motion(LEGS, dynamics, above(), flat_terrain())
    assert good.safe
    assert good.touchdown.vertical_speed == 2.0
    assert rest.settled
    hard, _ = evaluate_motion(
        LEGS, dynamics, above(velocity=np.array([0.0, 0.0, -6.0])), flat_terrain()
    )
    assert "legs" in hard.failure_causes
    assert "tip-over" not in hard.failure_causes
    rock = Terrain(flat_terrain().relief, RockField.hemispheres(0.3, 0.1, 0.0, 0.4))
    assert "belly" in evaluate_motion(LEGS, dynamics, above(), rock)[0].failure_causes
    state, steep = on_slope(14.0)
    assert evaluate_motion(LEGS, dynamics, state, steep)[0].failure_causes == ("slope",)
    off, none = evaluate_motion(LEGS, dynamics, above(position=np.array([100.0, 0.0, 1.6])), steep)
    assert off.failure_causes == ("off-map",)
    assert none is None


def leaning(axis, angle: float) -> State:
    """Return a lander at rest that leans by an angle about an axis (3,), its lowest pad down."""
    lean = Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis)).as_quat()
    attitude = quat_multiply(lean, UP)
    pads = quat_rotate(attitude, LANDER.pads)
    place = np.array([0.0, 0.0, -pads[:, 2].min()])
    return above(position=place, attitude=attitude, velocity=np.zeros(3))


def test_a_lander_that_stands_still_on_two_pads_is_not_at_rest():
    """Short of its balance over an edge it hardly moves for a second, and falls back."""
    pads = quat_rotate(UP, LANDER.pads)
    edge = pads[1, :2] - pads[0, :2]
    outward = pads[0, :2] + pads[1, :2]
    axis = np.array([edge[0], edge[1], 0.0])
    if np.cross(axis, [0.0, 0.0, 1.0])[:2] @ outward < 0.0:
        axis = -axis
    balance = np.arctan2(0.5 * np.linalg.norm(outward), LANDER.com_height)
    state = leaning(axis, balance - np.deg2rad(0.3))
    rest = settle(LEGS, Dynamics(LANDER, G), state, flat_terrain(80.0))
    assert rest.time > 2.0
    assert rest.settled
    assert not rest.tipped
    assert rest.tilt < np.deg2rad(1.0)


def test_over_one_pad_it_leans_farther_than_over_an_edge_before_it_tips():
    pad = quat_rotate(UP, LANDER.pads)[0]
    axis = np.cross([0.0, 0.0, 1.0], [pad[0], pad[1], 0.0])
    edge = np.arctan2(LANDER.leg_radius / np.sqrt(2.0), LANDER.com_height)
    corner = np.arctan2(LANDER.leg_radius, LANDER.com_height)
    assert corner - edge > np.deg2rad(8.0)
    ground = flat_terrain(80.0)
    back = settle(LEGS, Dynamics(LANDER, G), leaning(axis, corner - np.deg2rad(3.0)), ground)
    over = settle(LEGS, Dynamics(LANDER, G), leaning(axis, corner + np.deg2rad(3.0)), ground)
    assert not back.tipped
    assert back.settled
    assert over.tipped


def test_the_belly_counts_from_its_underside_and_at_its_lowest():
    dynamics, slowly = Dynamics(LANDER, G), np.array([0.0, 0.0, -0.05])
    for spare, touched in ((0.03, False), (-0.03, True)):
        high = LANDER.belly_clearance - spare
        rock = Terrain(flat_terrain().relief, RockField.hemispheres(0.2, 0.1, 0.0, high))
        verdict, _ = evaluate_motion(LEGS, dynamics, above(0.0, velocity=slowly), rock)
        assert ("belly" in verdict.failure_causes) == touched
    # A hard touchdown presses the springs farther than they are left.
    rest = settle(LEGS, dynamics, above(0.0), flat_terrain())
    assert rest.strokes.max() > rest.crushed.max() + 0.02
    lowest = LANDER.belly_clearance - rest.strokes.max()
    assert rest.clearance == pytest.approx(lowest, abs=0.01)


def test_pads_are_counted_from_the_body_not_from_a_centre_of_mass_that_moves():
    lander = JetLander(com_dry=(0.0, 0.0, 0.3), com_full=(0.0, 0.0, 0.3))
    state = above(0.3, lander, velocity=np.zeros(3))
    rest = settle(LEGS, Dynamics(lander, G), state, flat_terrain())
    assert rest.state.position[2] == pytest.approx(lander.com_height + 0.3, abs=0.01)


def test_a_stroke_that_is_spent_gives_no_more():
    """Ten metres a second are far beyond the honeycomb: after it the springs alone push back."""
    legs = replace(LEGS, max_time=0.6)
    hard = above(0.0, velocity=np.array([0.0, 0.0, -10.0]))
    rest = settle(legs, Dynamics(LANDER, G), hard, flat_terrain())
    assert (rest.crushed >= LEGS.stroke).all()
    assert rest.crushed.max() < LEGS.stroke + 0.02
    # m v^2 / 2 less what crushed, in the springs: k x^2 / 2 each, damping leaves less.
    spare = 0.5 * MASS * 100.0 - 4.0 * LEGS.crush_force * LEGS.stroke
    stiff = np.sqrt(2.0 * spare / (4.0 * LEGS.stiffness))
    assert 0.4 * stiff < (rest.strokes - rest.crushed).max() < 1.1 * stiff


def test_terrain_beside_what_is_unknown_is_unknown_to_a_pad():
    class Edge:
        """Ground that rises to the east, unknown from a metre on."""

        def elevation(self, xy):
            x = np.asarray(xy)[..., 0]
            return np.where(x > 1.0, np.nan, 0.1 * x)

    patch = TerrainPatch.of(LANDER, above(), Edge())
    x = patch.frame[0] + patch.frame[2] * np.arange(patch.heights.shape[1])
    row = patch.pad_heights[len(patch.pad_heights) // 2]
    radius = 0.5 * LANDER.pad_diameter
    assert np.isnan(row[x > 1.0 - radius + 0.01]).all()
    known = x < 1.0 - radius - 0.01
    assert row[known] == pytest.approx(0.1 * np.minimum(x[known] + radius, 1.0), abs=1e-9)


@pytest.mark.parametrize("name", ["stiffness", "damping", "crush_force", "stroke", "friction"])
def test_legs_that_cannot_be_are_refused(name):
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match=f"legs.{name}"):
            Legs(**{name: value})
