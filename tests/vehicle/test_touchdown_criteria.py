"""The static touchdown criteria against a reference with four times finer terrain samples."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.core.touchdown import samples_between_legs
from lunarsim.models.lander import Lander
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import (
    TERRAIN_SAMPLE_SPACING_M,
    evaluate_touchdown,
    pad_contacts,
)
from tests.reference import touchdown as plain
from tests.reference.raster import RasterGround
from tests.touchdowns import FRAME, random_touchdown

G = 1.622
NAMES = (
    "vertical_speed", "horizontal_speed", "tilt", "rate", "slope", "roughness", "tip_margin",
)  # fmt: skip


def test_the_outcome_of_random_touchdowns():
    """Motion agrees to rounding, and so do all values of given contacts on the same samples.

    The maximum height of terrain can only be higher on finer samples. On the roughest terrain it
    rises by decimetres in 0.1 m, so that samples 0.04 m apart miss centimetres.
    """
    seen, missed = set(), {"contacts": [], "roughness": []}
    for seed in range(150):
        lander, state, z = random_touchdown(seed)
        terrain = RasterGround(z, FRAME)
        found = evaluate_touchdown(lander, state, terrain, G)
        own = {name: getattr(found.touchdown, name) for name in NAMES}
        wanted = plain.motion(state)
        assert {name: own[name] for name in wanted} == pytest.approx(wanted, rel=1e-9, abs=1e-9)
        # The criteria are those of the documentation, on the values that were found.
        assert found.failure_causes == plain.causes(lander, own), seed
        seen |= set(found.failure_causes)
        legs = pad_contacts(lander, state, terrain)
        finer = plain.contacts(lander, state.position, state.attitude, terrain)
        assert legs[:, :2] == pytest.approx(finer[:, :2], abs=1e-9)
        missed["contacts"] += list(finer[:, 2] - legs[:, 2])
        if np.isnan(own["roughness"]):
            continue
        slope, roughness = plain.slope_and_roughness(legs, terrain, TERRAIN_SAMPLE_SPACING_M)
        assert own["slope"] == pytest.approx(slope, rel=1e-9), seed
        assert own["roughness"] == pytest.approx(roughness, rel=1e-9, abs=1e-9), seed
        roughness = plain.slope_and_roughness(legs, terrain)[1]
        missed["roughness"].append(roughness - own["roughness"])
        margin = plain.tip_margin(
            lander, state.position, state.velocity, state.mass, legs, slope, G
        )
        assert own["tip_margin"] == pytest.approx(margin, rel=1e-9, abs=1e-9), seed
    assert {"off-map", "slope", "roughness", "belly"} < seen
    for differences in missed.values():
        more = np.array(differences)[np.isfinite(differences)]
        assert len(more) > 80
        # The finer samples do not contain the coarser ones: 0.01 m may be missed either way.
        assert more.min() > -0.01
        assert more.max() < 0.15 and more.mean() < 0.04


def test_unknown_terrain_is_found_by_both():
    """At the edge of unknown terrain only the finer samples may reach it."""
    finer = 0
    for seed in range(0, 700, 7):
        lander, state, z = random_touchdown(seed)
        terrain = RasterGround(z, FRAME)
        mine = "off-map" in evaluate_touchdown(lander, state, terrain, G).failure_causes
        wanted = "off-map" in plain.causes(lander, plain.values(lander, state, terrain, G))
        assert wanted or not mine, seed
        finer += wanted and not mine
    assert finer <= 3


@pytest.mark.parametrize("legs", [3, 4])
def test_samples_between_legs_are_those_of_a_test_of_every_grid_point(legs):
    """Bit-identical for random headings, and for edges through grid points."""
    rng = np.random.default_rng(legs)
    headings = [*rng.uniform(0.0, 2.0 * np.pi, 60), 0.0, 0.25 * np.pi, 0.5 * np.pi]
    for heading in headings:
        angle = heading + 2.0 * np.pi * np.arange(legs) / legs
        radius, centre = rng.uniform(0.3, 3.0), rng.uniform(-50.0, 50.0, 2)
        pads = centre + radius * np.column_stack((np.cos(angle), np.sin(angle)))
        contacts = np.column_stack((pads + rng.uniform(-0.1, 0.1, (legs, 2)), np.zeros(legs)))
        for corners in (contacts, np.round(contacts, 1)):
            spacing = float(rng.choice([0.03, TERRAIN_SAMPLE_SPACING_M, 0.1]))
            wanted = plain.samples_between_legs(corners, spacing)
            assert len(wanted) > 0
            assert np.array_equal(samples_between_legs(corners, spacing), wanted)


@pytest.mark.parametrize("legs", [3, 4])
def test_slope_and_tip_margin_on_planes(legs):
    """A plane has no terrain between samples: agreement to the rim of the pads."""
    rng = np.random.default_rng(legs)
    lander = Lander(legs=legs, com_height=2.0)
    north, east = np.mgrid[:141, :121] * FRAME[2] + FRAME[[1, 0]][:, None, None]
    tipped = 0
    for _ in range(40):
        gradient = rng.normal(0.0, 0.1, 2)
        terrain = RasterGround(gradient[0] * east + gradient[1] * north, FRAME)
        heading = rng.uniform(0.0, np.pi)
        state = State(
            np.array([*rng.uniform(-1.0, 1.0, 2), 2.0]), np.array([*rng.normal(0.0, 2.0, 2), -1.0]),
            np.array([0.0, 0.0, np.sin(heading), np.cos(heading)]), np.zeros(3), 1300.0, 0.0,
        )  # fmt: skip
        found = evaluate_touchdown(lander, state, terrain, G).touchdown
        wanted = plain.values(lander, state, terrain, G)
        assert found.slope == pytest.approx(wanted["slope"], abs=2e-4)
        assert found.slope == pytest.approx(np.arctan(np.hypot(*gradient)), abs=2e-4)
        assert found.roughness == pytest.approx(wanted["roughness"], abs=2e-3)
        assert found.tip_margin == pytest.approx(wanted["tip_margin"], abs=2e-3, rel=2e-3)
        tipped += wanted["tip_margin"] < 0.0
        contacts = plain.contacts(lander, state.position, state.attitude, terrain)
        assert pad_contacts(lander, state, terrain) == pytest.approx(contacts, abs=1e-3)
    assert 0 < tipped < 40
