"""How far a place is searched for a shadow where the height of the ground is not known."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows import _evidence_kernels as kernels
from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.rocks.field import RockField
from lunarsim.world.terrain import Terrain
from tests.shadow_scene import MODEL, SUN, picture
from tests.slopes import sloping

GRID = Grid.centred((0.0, 0.0), 30.0, 0.25)
DIAMETERS = np.array([0.5, 0.6, 0.9, 1.5])
NUMBER = np.array([0.01, 0.005, 0.002, 0.0005])
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
EAST = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def is_lit(reach, axes=DOWN, place=(10.0, 0.0, 0.0), wide=901, radius=0.5, dark=()):
    """Tell whether a place seen from 40 m above the origin is noted as lit."""
    coarse = np.zeros((2, 2, 7))
    coarse[..., 0] = 1.0
    coarse[..., 1:4] = place
    coarse[..., 4] = reach
    labels = np.zeros((21, wide), np.int32)
    labels[:, list(dark)] = 1
    lit, dark_ = np.zeros((2, 1, 1, 1), np.float32)
    kernels.record_observation(
        lit, dark_, np.zeros((1, 1, 1), np.bool_), np.array([radius]), coarse, 1,
        np.array([0.0, 0.0, 40.0]), axes, 40.0, 40.0, 10.0, 10.0, labels,
        np.array([0.0, np.inf], np.float32), 1, 1.0, 1,
    )  # fmt: skip
    return bool(lit[0, 0, 0] > 0.0)


def test_a_place_is_searched_for_up_to_sixteen_radii_each_way():
    # A metre of height is a quarter of a metre to the side: 16.4 and 16.6 radii of half a metre.
    assert is_lit(32.8)
    assert not is_lit(33.2)
    # Of a larger rock the same ground is known well enough.
    assert is_lit(33.2, radius=0.6)


@pytest.mark.parametrize("higher", [-10.0, 10.0])
def test_what_is_dark_at_the_ends_of_the_reach_counts_and_beyond_them_not(higher):
    there = round(40.0 * 10.0 / (40.0 - higher) + 10.0)
    assert not is_lit(10.0, dark=[there])
    assert is_lit(7.0, dark=[there])


def test_what_may_lie_out_of_view_is_not_seen_to_be_lit():
    # It shows at column 20, and at 23.3 if it lies 10 m higher.
    assert is_lit(10.0, wide=26)
    assert not is_lit(10.0, wide=22)
    assert is_lit(0.0, wide=22)


def test_at_the_horizon_the_least_error_of_height_hides_all():
    assert is_lit(0.0, EAST, (10.0, 0.0, 41.0))
    for height in (40.0, 41.0):
        assert not is_lit(0.01, EAST, (10.0, 0.0, height))


@pytest.mark.parametrize("reach", [np.nan, np.inf])
def test_of_terrain_whose_error_is_no_number_nothing_is_seen(reach):
    assert not is_lit(reach)


def one_rock(plane=LEVEL):
    """Return the view of a rock at the origin from the west, and what it shows."""
    rocks = RockField.hemispheres([0.0], [0.0], 0.0, 0.6)
    terrain = Terrain(sloping(plane.gradient, 400.0, 10.0), rocks)
    state, camera, counts = picture(terrain, (-25.0, 0.0, 30.0))
    seen = detect_rocks(counts, camera, state, SUN, terrain=plane, model=MODEL)
    assert len(seen) == 1
    return camera.view(state), seen


def test_terrain_is_searched_by_twice_its_height_error_at_the_current_places(monkeypatch):
    view, seen = one_rock()
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    rocks = np.random.default_rng(0).uniform(-15.0, 15.0, (30, 2))
    evidence.motion.follow(rocks, np.full((30, 2), [2.0, -1.0]))
    given = []
    monkeypatch.setattr(kernels, "record_observation", lambda *args: given.append(args))

    def sigma(xy):
        return np.where(xy[:, 0] > 10.0, np.inf, np.exp(0.2 * xy[:, 0] + 0.1 * xy[:, 1]))

    evidence.add_image(view, SUN, seen, lambda xy: 0.0 * xy[:, 0], height_sigma=sigma)
    coarse = given[0][4]
    place = coarse[..., kernels.EAST : kernels.NORTH + 1]
    reach = np.minimum(2.0 * sigma(place.reshape(-1, 2)), 1e3).reshape(coarse.shape[:2])
    np.testing.assert_allclose(coarse[..., kernels.REACH], reach)
    assert place[0, 0] == pytest.approx([GRID.x0 + 2.0, GRID.y0 - 1.0])


@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.1, -0.12)])
@pytest.mark.parametrize("lower", [-3.0, 3.0])
def test_a_rock_on_terrain_taken_for_lower_or_higher_is_not_cleared(lower, gradient):
    """Its shadow shows beside where it is looked for, and no farther than the ground may be off."""
    plane = GroundPlane(0.0, gradient)
    view, seen = one_rock(plane)
    row, col = (int(v[0]) for v in GRID.cell(np.zeros((1, 2))))

    def look(off, sigma, tracked=None):
        evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
        evidence.add_image(
            view, SUN, seen, lambda xy: plane.heights(xy) + off, tracked, plane=plane,
            height_sigma=lambda xy: np.full(len(xy), sigma),
        )  # fmt: skip
        # Away from it the ground is clear, however high it is.
        assert evidence.is_observed()[20:40, 20:40].all()
        return evidence

    assert look(0.0, 0.0).dark[0, row, col] > 0.0
    cleared = {}
    for sigma in (0.0, 0.5, 2.0):
        cleared[sigma] = bool(look(-lower, sigma).is_observed()[row, col])
        # Of a rock that is tracked the shadow is its own.
        assert look(-lower, sigma, np.ones(len(seen), bool)).is_observed()[row, col]
    assert cleared == {0.0: True, 0.5: True, 2.0: False}


def test_terrain_of_which_next_to_nothing_is_known_is_not_seen():
    view, seen = one_rock()
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    evidence.add_image(
        view, SUN, seen, lambda xy: 0.0 * xy[:, 0],
        height_sigma=lambda xy: np.where(xy[:, 1] > 2.0, np.inf, 0.0),
    )  # fmt: skip
    assert evidence.is_observed()[10:40, 10:110].mean() > 0.9
    assert not evidence.lit[0, 90:].any()


def test_a_map_passes_on_the_height_error_of_the_terrain():
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    view, seen = one_rock()
    mapping.add_image(view, SUN, seen, height_sigma=lambda xy: np.full(len(xy), np.inf))
    assert not mapping.observed.any()
    mapping.add_image(view, SUN, seen)
    assert mapping.observed.mean() > 0.5
