from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.grid import Grid


@given(
    st.floats(-100, 100),
    st.floats(-100, 100),
    st.floats(0.1, 5.0),
    st.integers(1, 40),
    st.integers(1, 40),
)
def test_cell_of_centre_is_the_cell(x0, y0, posting, rows, cols):
    grid = Grid(x0, y0, posting, rows, cols)
    row, col = grid.cell(grid.centres())
    assert (row == np.arange(rows)[:, None]).all()
    assert (col == np.arange(cols)[None, :]).all()
    assert grid.contains(grid.centres()).all()


def test_centred_grid_has_the_asked_edges():
    grid = Grid.centred((3.0, -2.0), 10.0, 0.5, 4.0)
    assert grid.shape == (8, 20)
    assert grid.extent == pytest.approx((-2.0, 8.0, -4.0, 0.0))


def test_points_outside_are_not_contained():
    grid = Grid(0.0, 0.0, 1.0, 2, 2)
    assert not grid.contains([1.6, 0.0])
    assert not grid.contains([0.0, -0.6])


@pytest.mark.parametrize("posting", [0.0, -1.0, np.nan])
def test_posting_must_be_positive(posting):
    with pytest.raises(InputError, match=r"grid\.posting"):
        Grid(0.0, 0.0, posting, 2, 2)
