"""Test the validity checks and queries of hazard maps."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard

GRID = Grid.centred((0.0, 0.0), 4.0, 1.0)


def hazard_map(**layers) -> HazardMap:
    ones = np.ones(GRID.shape, np.float32)
    return HazardMap(GRID, **({"p_safe": ones, "observed": ones > 0.0} | layers))


def test_without_layers_all_is_eligible_and_of_value():
    m = hazard_map()
    assert m.eligible_at([[0.0, 0.0], [9.0, 0.0]]).tolist() == [True, False]
    assert m.value_at([[0.0, 0.0], [9.0, 0.0]]).tolist() == [1.0, 0.0]


def test_layers_are_read_where_they_lie():
    eligible = np.zeros(GRID.shape, bool)
    value = np.zeros(GRID.shape, np.float32)
    eligible[0, 1] = value[0, 1] = True
    value[0, 1] = 0.5
    m = hazard_map(eligible=eligible, value=value)
    at = GRID.centre_of(0, 1)
    assert m.eligible_at(at)
    assert m.value_at(at) == 0.5
    assert not m.eligible_at(at + [0.0, 1.0])
    assert m.value_at([at + [1.0, 0.0], at]).tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("layers", "field"),
    [
        ({"eligible": np.ones((2, 2), bool)}, "map.eligible"),
        ({"eligible": np.ones(GRID.shape)}, "map.eligible"),
        ({"value": np.ones((2, 2), np.float32)}, "map.value"),
        ({"value": np.ones(GRID.shape, bool)}, "map.value"),
        ({"value": np.full(GRID.shape, np.nan, np.float32)}, "map.value"),
        ({"value": np.full(GRID.shape, 1.5, np.float32)}, "map.value"),
        ({"value": np.full(GRID.shape, -0.1, np.float32)}, "map.value"),
        ({"p_safe": np.full(GRID.shape, np.nan, np.float32)}, "map.p_safe"),
        ({"p_safe": np.full(GRID.shape, 1.01, np.float32)}, "map.p_safe"),
        ({"p_safe": np.full(GRID.shape, -0.01, np.float32)}, "map.p_safe"),
        ({"value": np.ma.masked_equal(np.ones(GRID.shape), 1.0)}, "map.value"),
    ],
)
def test_impossible_layers_are_refused(layers, field):
    with pytest.raises(InputError, match=field):
        hazard_map(**layers)


@pytest.mark.parametrize(
    ("position", "score", "here"),
    [
        (np.zeros((2, 3)), np.zeros(1), 0.0),
        (np.zeros((1, 2)), np.zeros(1), 0.0),
        (np.zeros((1, 3)), np.array([np.nan]), 0.0),
        (np.full((1, 3), np.nan), np.zeros(1), 0.0),
        (np.zeros((1, 3)), np.zeros(1), np.nan),
    ],
)
def test_impossible_boards_are_refused(position, score, here):
    with pytest.raises(InputError, match="scoreboard"):
        Scoreboard(position, score, here)


@pytest.mark.parametrize("layer", ["p_safe", "observed", "elevation"])
def test_masked_layers_are_refused(layer):
    grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
    layers = {
        "p_safe": np.ones(grid.shape, np.float32), "observed": np.ones(grid.shape, bool),
        "elevation": np.zeros(grid.shape, np.float32),
    }  # fmt: skip
    layers[layer] = np.ma.masked_array(layers[layer], np.ones(grid.shape, bool))
    with pytest.raises(InputError, match=layer):
        HazardMap(grid, **layers)
