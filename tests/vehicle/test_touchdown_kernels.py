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
    TOUCHDOWN_LIMITS,
    evaluate_touchdown,
    pad_contacts,
    pad_disc,
    touchdown_params,
    violated_limits,
)
from tests.reference.raster import RasterGround
from tests.reference.touchdown import touchdown_values

G = 1.622
FRAME = np.array([-6.0, -7.0, 0.1])


def drawn(seed):
    rng = np.random.default_rng(seed)
    dry = np.random.default_rng([seed, 1]).uniform(1000.0, 1500.0, 3)  # either axis has the lesser
    wet = dry * np.random.default_rng([seed, 2]).uniform(1.0, 1.3, 3)
    lander = Lander(
        legs=int(rng.choice([3, 4])), leg_radius=float(rng.uniform(1.0, 3.0)),
        inertia_dry=tuple(dry), inertia_full=tuple(wet),
    )  # fmt: skip
    tilt = np.add.outer(*(np.arange(n) * rng.uniform(-0.02, 0.02) for n in (141, 121)))
    z = (tilt + rng.uniform(0.0, 0.15) * rng.standard_normal((141, 121))).astype(np.float32)
    if seed % 7 == 0:
        z[60:64, 58:70] = np.nan
    q = rng.normal(size=4) * [0.05, 0.05, 1.0, 1.0]
    state = State(
        np.array([*rng.uniform(-3.5, 3.5, 2), 1.6 + 0.3 * rng.normal()]),
        rng.normal(size=3) * 0.6 - [0.0, 0.0, 2.0], q / np.linalg.norm(q),
        0.04 * rng.normal(size=3), rng.uniform(1100.0, 1500.0), 0.0,
    )  # fmt: skip
    return lander, state, z


def evaluated(lander, state, z):
    """Return the violated limits and the values of a touchdown on a raster."""
    values = np.empty(7)
    failed = k.evaluate_on_raster(
        state.as_vector(), lander.pads, pad_disc(0.5 * lander.pad_diameter),
        TERRAIN_SAMPLE_SPACING_M, z, FRAME, touchdown_params(lander, G), values,
    )  # fmt: skip
    return violated_limits(failed), values


def test_touchdowns_in_a_batch_and_in_the_simulation_are_those_of_the_reference():
    seen = set()
    for seed in range(150):
        lander, state, z = drawn(seed)
        expected, causes = touchdown_values(lander, state, RasterGround(z, FRAME), G)
        failed, values = evaluated(lander, state, z)
        outcome = evaluate_touchdown(lander, state, RasterGround(z, FRAME), G)
        t = outcome.touchdown
        own = (t.vertical_speed, t.horizontal_speed, t.tilt, t.rate, t.slope, t.roughness,
               t.tip_margin)  # fmt: skip
        assert failed == outcome.failure_causes == causes, seed
        assert outcome.safe == (not causes)
        assert values == pytest.approx(expected, abs=1e-9, nan_ok=True), seed
        assert own == pytest.approx(expected, abs=1e-9, nan_ok=True), seed
        seen |= set(failed) | ({"safe"} if not failed else set())
    assert seen >= set(TOUCHDOWN_LIMITS) - {"tip-over"}


def test_a_lander_tips_over_the_edge_that_it_slides_across():
    lander, state, z = Lander(leg_radius=1.0), drawn(1)[1], np.zeros((141, 121), np.float32)
    for speed, tips in ((0.5, False), (6.0, True)):
        moving = State(
            np.array([0.0, 0.0, 1.6]), np.array([speed, 0.0, -1.0]),
            np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), state.mass, 0.0,
        )  # fmt: skip
        expected, causes = touchdown_values(lander, moving, RasterGround(z, FRAME), G)
        failed, values = evaluated(lander, moving, z)
        assert ("tip-over" in failed) == ("tip-over" in causes) == tips
        assert values[6] == pytest.approx(expected[6], rel=1e-9)


def test_the_first_pad_to_touch_is_found():
    hits = 0
    for seed in range(150):
        lander, state, z = drawn(seed)
        gap = (
            state.position[2] + Rotation.from_quat(state.attitude).apply(lander.pads)[:, 2]
            - pad_contacts(lander, state, RasterGround(z, FRAME))[:, 2]
        )  # fmt: skip
        touched = bool((gap <= 0.0).any())
        args = state.as_vector(), lander.pads, pad_disc(0.5 * lander.pad_diameter), z, FRAME
        assert k.has_contact(*args) == touched, seed
        hits += touched
    assert 30 < hits < 120


def test_beyond_its_posts_ground_is_unknown():
    z = np.arange(12.0, dtype=np.float32).reshape(3, 4) ** 2
    frame = np.array([1.0, 2.0, 0.5])
    assert k.height_at(z, frame, 1.25, 2.5) == pytest.approx(20.5)
    assert k.height_at(z, frame, 2.5, 3.0) == 121.0
    assert k.height_at(z, frame, 2.375, 2.875) == pytest.approx(98.25)
    for x, y in ((0.99, 2.5), (2.51, 2.5), (1.25, 1.99), (1.25, 3.01), (np.nan, 2.5)):
        assert np.isnan(k.height_at(z, frame, x, y))
