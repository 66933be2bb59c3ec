from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.truth_mesh import TruthMesh
from lunarsim.grid import Grid


def test_truth_mesh_of_a_plane_is_the_plane():
    grid = Grid.centred((3.0, -2.0), 40.0, 0.1)
    c = grid.centres()
    z = 0.1 * c[..., 0] - 0.05 * c[..., 1] + 2.0
    mesh = TruthMesh(z, grid, 5.0)
    normal, height = mesh.plane(c[150, 200])
    assert normal == pytest.approx(np.array([-0.1, 0.05, 1.0]) / np.sqrt(1.0125), abs=1e-9)
    assert height == pytest.approx(z[150, 200], abs=1e-9)
    d = mesh.distance(z + 0.2, grid)
    assert d[np.isfinite(d)] == pytest.approx(0.2 / np.sqrt(1.0125), abs=1e-9)
    z[200:204, 200:204] += 0.5
    hazards = TruthMesh(z, grid, 5.0).hazards(z, grid, 0.3)
    assert np.nansum(hazards) == 16
    assert np.isnan(hazards[0, 0])
    with pytest.raises(InputError, match=r"truth\.spacing"):
        TruthMesh(z, grid, 35.0)
