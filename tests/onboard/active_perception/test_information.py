"""What a look says of whether a hazard is there, and which ground is worth a look."""

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.active_perception.information import (
    ExpectedRocks,
    entropy,
    removed_uncertainty,
)
from lunarsim.onboard.active_perception.terrain_nodes import terrain_nodes
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.rocks.size_distribution import golombek_cover


def test_rocks_of_all_sizes_cover_what_the_law_says():
    rocks = ExpectedRocks.golombek(0.05, 0.5)
    covered = float(rocks.number @ (np.pi * rocks.radius**2))
    assert covered == pytest.approx(golombek_cover(0.5, 0.05) - golombek_cover(4.0, 0.05), rel=1e-9)
    assert rocks.hazard_probability(0.0) == pytest.approx(covered, rel=0.01)
    assert rocks.hazard_probability(1.1) > 10.0 * covered


@pytest.mark.parametrize(("cover", "least"), [(0.0, 0.5), (-0.1, 0.5), (np.nan, 0.5), (0.05, 0.0),
                                              (0.05, 4.0), (0.05, np.nan)])  # fmt: skip
def test_rocks_that_cannot_be_are_refused(cover, least):
    with pytest.raises(InputError):
        ExpectedRocks.golombek(cover, least)


def test_an_observation_that_misses_nothing_is_complete_and_one_that_misses_all_is_empty():
    rocks = ExpectedRocks.golombek(0.08, 0.5)
    assert removed_uncertainty(rocks, 1.0, lambda q: 0.0 * q, 3.0) == pytest.approx(1.0)
    assert removed_uncertainty(rocks, 1.0, lambda q: 0.0 * q + 1.0, 3.0) == pytest.approx(0.0)
    told = removed_uncertainty(rocks, 1.0, DetectionRates().false_clear, np.linspace(0.0, 40.0, 81))
    assert (np.diff(told) >= -1e-12).all()
    assert told[0] == pytest.approx(0.0)
    assert 0.8 < told[-1] < 1.0  # the floor of the miss rate stays


def test_it_is_the_mutual_information_of_hazard_and_observation():
    """Drawn: of a million places, those with a hazard show one unless it is missed."""
    rng = np.random.default_rng(4)
    rocks, missed = ExpectedRocks.golombek(0.1, 0.5), 0.3
    hazard = rng.random(1_000_000) < rocks.hazard_probability(1.1)
    shown = hazard & (rng.random(hazard.size) > missed)
    joint = np.array([[np.mean(hazard & shown), np.mean(hazard & ~shown)],
                      [np.mean(~hazard & shown), np.mean(~hazard & ~shown)]])  # fmt: skip
    apart = joint.sum(1, keepdims=True) * joint.sum(0, keepdims=True)
    some = joint > 0.0
    information = float((joint[some] * np.log2(joint[some] / apart[some])).sum())
    told = float(removed_uncertainty(rocks, 1.1, lambda q: 0.0 * q + missed, 1.0))
    assert told == pytest.approx(information / entropy(hazard.mean()), abs=0.005)


def a_map(p, observed, **layers):
    p = np.asarray(p, np.float32)
    return HazardMap(Grid.centred(np.array([10.0, -4.0]), 8.0, 1.0), p, observed, **layers)


def test_squares_know_what_the_map_has_seen():
    observed = np.zeros((8, 8), bool)
    observed[:, 4:] = True
    p = np.where(observed, 0.999, 0.0)
    p[:, 6:] = 0.5
    nodes = terrain_nodes(a_map(p, observed), 4, 0.2, np.array([10.0, -4.0, 7.0]))
    assert nodes.shape == (16, 5)
    np.testing.assert_allclose(nodes[:4, 0], [7.0, 9.0, 11.0, 13.0])
    np.testing.assert_allclose(np.unique(nodes[:, 1]), [-7.0, -5.0, -3.0, -1.0])
    assert (nodes[:, 2] == 7.0).all()
    sure = 1.0 - entropy(0.001) / entropy(0.2)
    # Not looked at; seen; and where the map cannot make up its mind it knows nothing.
    np.testing.assert_allclose(nodes[:4, 4], [0.0, 0.0, sure, 0.0], atol=1e-6)
    np.testing.assert_allclose(nodes[:, 3], 1.0)


def test_terrain_that_the_mission_excludes_has_no_weight():
    eligible = np.ones((8, 8), bool)
    eligible[:4] = False
    eligible[4, :] = False
    elevation = np.full((8, 8), 2.5, np.float32)
    drawn = a_map(np.zeros((8, 8)), np.zeros((8, 8), bool), eligible=eligible, elevation=elevation)
    nodes = terrain_nodes(drawn, 4, 0.2, np.array([10.0, -4.0, 7.0]))
    np.testing.assert_allclose(nodes[:, 3].reshape(4, 4)[:, 0], [0.0, 0.0, 0.5, 1.0])
    assert (nodes[:, 2] == 2.5).all()
    # A map that is wider than high lies in the middle of its squares.
    wide = HazardMap(Grid.centred(np.zeros(2), 8.0, 1.0, 4.0), np.zeros((4, 8), np.float32),
                     np.zeros((4, 8), bool), eligible=np.ones((4, 8), bool))  # fmt: skip
    weight = terrain_nodes(wide, 4, 0.2, np.zeros(3))[:, 3].reshape(4, 4)
    np.testing.assert_allclose(weight[:, 1], [0.0, 1.0, 1.0, 0.0])
    # Squares that no whole number of cells makes up.
    uneven = terrain_nodes(drawn, 3, 0.2, np.array([10.0, -4.0, 7.0]))[:, 3].reshape(3, 3)
    np.testing.assert_allclose(uneven.mean(), eligible.mean())
