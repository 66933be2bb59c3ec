"""Touchdowns on a raster against the simulation's verdict on the same ground."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.core import touchdown as k
from lunarsim.models.lander import Lander
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import (
    TERRAIN_SAMPLE_SPACING_M,
    evaluate_touchdown,
    pad_contacts,
    pad_disc,
    touchdown_params,
    violated_limits,
)
from tests.reference.raster import RasterGround
from tests.reference.touchdown import tip_margin
from tests.touchdowns import FRAME, random_touchdown

G = 1.622


def evaluated(lander, state, z):
    """Return the violated limits and the values of a touchdown on a raster."""
    values = np.empty(len(k.VALUES))
    failed = k.evaluate_on_raster(
        state.as_vector(), lander.pads, pad_disc(0.5 * lander.pad_diameter),
        TERRAIN_SAMPLE_SPACING_M, z, FRAME, touchdown_params(lander, G), values,
    )  # fmt: skip
    return violated_limits(failed), values


def test_touchdowns_in_a_batch_are_those_in_the_simulation():
    """`test_touchdown_criteria.py` compares the simulation with the reference."""
    seen = set()
    for seed in range(150):
        lander, state, z = random_touchdown(seed)
        failed, values = evaluated(lander, state, z)
        outcome = evaluate_touchdown(lander, state, RasterGround(z, FRAME), G)
        t = outcome.touchdown
        own = (t.vertical_speed, t.horizontal_speed, t.tilt, t.rate, t.slope, t.roughness,
               t.tip_margin)  # fmt: skip
        assert failed == outcome.failure_causes, seed
        assert outcome.safe == (not failed)
        assert values == pytest.approx(own, abs=1e-9, nan_ok=True), seed
        seen |= set(failed) | ({"safe"} if not failed else set())
    assert seen >= set(k.CAUSES) - {"tip-over"}


def test_a_lander_tips_over_the_edge_that_it_slides_across():
    lander, state = Lander(leg_radius=1.0), random_touchdown(1)[1]
    z = np.zeros((141, 121), np.float32)
    legs = lander.pads + [0.0, 0.0, lander.com_height]
    for speed, tips in ((0.5, False), (6.0, True)):
        moving = State(
            np.array([0.0, 0.0, 1.6]), np.array([speed, 0.0, -1.0]),
            np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), state.mass, 0.0,
        )  # fmt: skip
        failed, values = evaluated(lander, moving, z)
        assert ("tip-over" in failed) == tips
        margin = tip_margin(lander, moving.position, moving.velocity, moving.mass, legs, 0.0, G)
        assert values[k.VALUES.index("tip_margin")] == pytest.approx(margin, rel=1e-9)


def test_the_first_pad_to_touch_is_found():
    hits = 0
    for seed in range(150):
        lander, state, z = random_touchdown(seed)
        gap = (
            state.position[2] + Rotation.from_quat(state.attitude).apply(lander.pads)[:, 2]
            - pad_contacts(lander, state, RasterGround(z, FRAME))[:, 2]
        )  # fmt: skip
        touched = bool((gap <= 0.0).any())
        args = state.as_vector(), lander.pads, pad_disc(0.5 * lander.pad_diameter), z, FRAME
        for max_rise in (np.nanmax(z) - np.nanmin(z), np.inf):
            assert k.has_contact(*args, max_rise) == touched, seed
        hits += touched
    assert 30 < hits < 120


def test_beyond_its_posts_terrain_is_unknown():
    z = np.arange(12.0, dtype=np.float32).reshape(3, 4) ** 2
    frame = np.array([1.0, 2.0, 0.5])
    assert k.height_at(z, frame, 1.25, 2.5) == pytest.approx(20.5)
    assert k.height_at(z, frame, 2.5, 3.0) == 121.0
    assert k.height_at(z, frame, 2.375, 2.875) == pytest.approx(98.25)
    for x, y in ((0.99, 2.5), (2.51, 2.5), (1.25, 1.99), (1.25, 3.01), (np.nan, 2.5)):
        assert np.isnan(k.height_at(z, frame, x, y))


def test_limits_of_terrain_are_violated_when_reached_and_those_of_motion_when_exceeded():
    lander, state, z = random_touchdown(1)
    params, values = touchdown_params(lander, G), np.empty(len(k.VALUES))

    def causes(limits):
        failed = k.evaluate_on_raster(
            state.as_vector(), lander.pads, pad_disc(0.5 * lander.pad_diameter),
            TERRAIN_SAMPLE_SPACING_M, z, FRAME, params._replace(limits=limits), values,
        )  # fmt: skip
        return set(violated_limits(failed)) - {"tip-over"}

    causes(params.limits)
    reached = np.array([values[k.VALUES.index(limit.value)] for limit in k.LIMITS])
    assert np.isfinite(reached).all()
    assert causes(reached) == {limit.cause for limit in k.LIMITS if limit.is_terrain}
    assert causes(np.nextafter(reached, np.inf)) == set()
    assert causes(np.nextafter(reached, -np.inf)) == {limit.cause for limit in k.LIMITS}
