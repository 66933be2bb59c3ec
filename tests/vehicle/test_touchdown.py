from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.core.touchdown import support_planes
from lunarsim.frames import attitude_from_thrust
from lunarsim.models.lander import Lander
from lunarsim.rocks.field import RockField
from lunarsim.vehicle import State, evaluate_touchdown
from lunarsim.vehicle.touchdown import min_touchdown_margin
from lunarsim.world.terrain import Terrain
from tests.reference.safety import standing_planes
from tests.worlds import flat_terrain, sloped_terrain

G = 1.622
LANDER = Lander()


def standing(height: float = 0.0, **changes) -> State:
    state = State(
        np.array([0.0, 0.0, LANDER.com_height + height]),
        np.array([0.0, 0.0, -2.0]),
        attitude_from_thrust([0.0, 0.0, 1.0], np.pi / 2),
        np.zeros(3),
        1300.0,
    )
    return replace(state, **changes)


def test_flat_terrain_is_safe():
    verdict = evaluate_touchdown(LANDER, standing(), flat_terrain(), G)
    assert verdict.safe
    assert verdict.failure_causes == ()
    assert verdict.touchdown.slope == pytest.approx(0.0, abs=1e-6)
    assert verdict.touchdown.roughness == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "limit"),
    [
        ({"velocity": np.array([0.0, 0.0, -3.1])}, "vertical-speed"),
        ({"velocity": np.array([1.1, 0.0, -2.0])}, "horizontal-speed"),
        ({"attitude": attitude_from_thrust([0.12, 0.0, 1.0], 1.0)}, "tilt"),
        ({"rate": np.array([0.0, 0.2, 0.0])}, "rate"),
        ({"position": np.array([100.0, 0.0, 1.6])}, "off-map"),
    ],
)
def test_each_limit_is_named(changes, limit):
    verdict = evaluate_touchdown(LANDER, standing(**changes), flat_terrain(), G)
    assert not verdict.safe
    assert verdict.failure_causes == (limit,)


@pytest.mark.parametrize("degrees", [3.0, 9.9, 10.5, 20.0])
def test_slope_is_that_of_the_plane(degrees):
    ground = sloped_terrain((np.tan(np.deg2rad(degrees)), 0.0))
    verdict = evaluate_touchdown(LANDER, standing(), ground, G)
    assert np.rad2deg(verdict.touchdown.slope) == pytest.approx(degrees, abs=0.02)
    assert ("slope" in verdict.failure_causes) == (degrees > 10.0)


@pytest.mark.parametrize(("radius", "safe"), [(0.2, True), (0.3, False)])
def test_rock_under_the_belly(radius, safe):
    ground = Terrain(flat_terrain().relief, RockField.hemispheres(0.3, 0.1, 0.0, radius))
    verdict = evaluate_touchdown(LANDER, standing(), ground, G)
    assert verdict.safe is safe
    assert verdict.touchdown.roughness == pytest.approx(radius, abs=0.01)
    if not safe:
        assert verdict.failure_causes == ("roughness", "belly")


def test_rock_under_a_pad_tilts_the_support_plane():
    pad = LANDER.pads[0]  # body x points east
    ground = Terrain(flat_terrain().relief, RockField.hemispheres(pad[0], pad[1], 0.0, 0.5))
    verdict = evaluate_touchdown(LANDER, standing(), ground, G)
    # The diagonal with the raised pad carries, 0.25 m up in the middle; a third pad is down:
    # 0.25 m over the radius along the diagonal and as much across it.
    expected = np.arctan(0.25 * np.sqrt(2.0) / LANDER.leg_radius)
    assert verdict.touchdown.slope == pytest.approx(expected, rel=0.02)


def test_sideways_speed_tips_a_tall_lander():
    tall = Lander(com_height=6.0, horizontal_speed_limit=5.0)
    state = standing(velocity=np.array([2.5, 0.0, -2.0]), position=np.array([0.0, 0.0, 6.0]))
    verdict = evaluate_touchdown(tall, state, flat_terrain(), G)
    assert verdict.failure_causes == ("tip-over",)
    slow = replace(state, velocity=np.array([0.3, 0.0, -2.0]))
    assert evaluate_touchdown(tall, slow, flat_terrain(), G).safe


@pytest.mark.parametrize(
    ("speeds", "margin"),
    [((0.0, 0.0, -0.5), 1.0 - 0.5 / LANDER.vertical_speed_limit),
     ((0.9 * LANDER.horizontal_speed_limit, 0.0, -0.1), 0.1),
     ((0.0, 0.0, -1.25 * LANDER.vertical_speed_limit), -0.25)],
)  # fmt: skip
def test_the_least_margin_is_that_of_the_nearest_limit(speeds, margin):
    verdict = evaluate_touchdown(LANDER, standing(velocity=np.array(speeds)), flat_terrain(), G)
    assert min_touchdown_margin(LANDER, verdict.touchdown) == pytest.approx(margin, abs=1e-6)
    assert (margin < 0.0) != verdict.safe


@given(
    st.floats(0.0, 4.0), st.floats(0.0, 2.0), st.floats(0.0, 15.0), st.floats(0.0, 0.3),
    st.floats(0.0, 0.5),
)  # fmt: skip
def test_a_margin_below_zero_is_an_outcome_that_failed(down, across, tilt, rate, radius):
    state = standing(
        velocity=np.array([across, 0.0, -down]), rate=np.array([rate, 0.0, 0.0]),
        attitude=attitude_from_thrust([np.tan(np.deg2rad(tilt)), 0.0, 1.0], np.pi / 2),
    )  # fmt: skip
    ground = Terrain(flat_terrain().relief, RockField.hemispheres(0.3, 0.1, 0.0, radius + 0.01))
    verdict = evaluate_touchdown(LANDER, state, ground, G)
    assert (min_touchdown_margin(LANDER, verdict.touchdown) < 0.0) == (not verdict.safe)


def test_of_unknown_terrain_the_margin_is_not_known():
    verdict = evaluate_touchdown(
        LANDER, standing(position=np.array([100.0, 0.0, 1.6])), flat_terrain(), G
    )
    assert np.isnan(min_touchdown_margin(LANDER, verdict.touchdown))


def test_tip_margin_of_a_point_mass_in_closed_form():
    """With the speed at which the pendulum just reaches the top, the margin is zero."""
    lander = Lander(com_height=3.0, inertia_dry=(1e-6,) * 3, inertia_full=(1e-6,) * 3,
                    horizontal_speed_limit=99.0)  # fmt: skip
    arm, height = lander.leg_radius / np.sqrt(2.0), 3.0
    length = np.hypot(arm, height)
    # m v h = m L^2 w;  L^2 w^2 / 2 = g (L - h)
    speed = np.sqrt(2.0 * G * (length - height)) * length / height
    state = standing(velocity=np.array([speed, 0.0, -1.0]), position=np.array([0.0, 0.0, 3.0]))
    margin = evaluate_touchdown(lander, state, flat_terrain(), G).touchdown.tip_margin
    assert margin == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("axes", [(0, 1), (1, 0)])
def test_a_body_that_turns_more_easily_about_one_axis_tips_as_easily_as_about_that(axes):
    """The energy about an edge, L^2 / 2 (I + m L^2), is greatest with the lesser moment."""
    standard = Lander()
    full = (1300.0 - standard.dry_mass) / standard.propellant_mass
    assert 0.1 < full < 0.9
    # The lesser moment is 600 kg m^2 at this mass, and neither empty nor full.
    dry, wet = np.array([500.0, 1900.0]), np.array([500.0 + 100.0 / full, 2300.0])
    lander = Lander(
        com_height=2.0, inertia_dry=(*dry[list(axes)], 2100.0),
        inertia_full=(*wet[list(axes)], 2400.0),
    )  # fmt: skip
    arm = lander.leg_radius / np.sqrt(2.0)
    length = np.hypot(arm, 2.0)
    for sideways in (np.array([0.9, 0.0]), np.array([0.0, -0.9])):
        state = standing(
            velocity=np.array([*sideways, -1.0]), position=np.array([0.0, 0.0, 2.0])
        )  # fmt: skip
        margin = evaluate_touchdown(lander, state, flat_terrain(), G).touchdown.tip_margin
        turning = 0.5 * (1300.0 * 0.9 * 2.0) ** 2 / (600.0 + 1300.0 * length**2)
        assert margin == pytest.approx(1.0 - turning / (1300.0 * G * (length - 2.0)), abs=1e-6)


def test_the_heading_is_that_of_body_x_from_north_to_east():
    for heading in (0.4, -2.0):
        state = standing(attitude=attitude_from_thrust([0.0, 0.0, 1.0], heading))
        touchdown = evaluate_touchdown(LANDER, state, flat_terrain(), G).touchdown
        x, y, z, w = state.attitude
        east, north = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w)
        assert touchdown.heading == pytest.approx(np.arctan2(east, north))


def test_a_margin_of_roughness_is_counted_to_the_lesser_of_its_limits():
    touchdown = evaluate_touchdown(LANDER, standing(), flat_terrain(), G).touchdown
    rough = replace(touchdown, roughness=0.18, vertical_speed=0.0)
    for limits in ({"roughness_limit": 0.5, "belly_clearance": 0.2},
                   {"roughness_limit": 0.2, "belly_clearance": 0.5}):  # fmt: skip
        assert min_touchdown_margin(Lander(**limits), rough) == pytest.approx(0.1)


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_four_legs_stand_above_the_terrain(heights):
    """On an admissible plane no leg is under ground, and three touch it."""
    legs = np.column_stack((LANDER.pads[:, :2], heights))
    planes = np.empty((2, 3))
    support_planes(legs, planes)
    admissible = standing_planes(legs)  # all four if the legs lie in one plane
    for plane in planes:
        assert any(plane == pytest.approx(np.array(one), abs=1e-8) for one in admissible)
    for z0, gx, gy in planes:
        gap = z0 + legs[:, :2] @ [gx, gy] - legs[:, 2]
        assert np.sum(np.abs(gap) < 1e-9) >= 3
        assert gap.min() > -1e-9


def test_three_legs_have_one_plane():
    lander = Lander(legs=3)
    legs = np.column_stack((lander.pads[:, :2], [0.1, 0.2, 0.3]))
    planes = np.empty((2, 3))
    support_planes(legs, planes)
    assert planes[0] == pytest.approx(planes[1])
    assert planes[:1] == pytest.approx(np.array(standing_planes(legs)))
