"""Nodes, zone sums and meshes of the site selection."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.hazards.quadtree import (
    QuadtreeMap,
    SiteSettings,
)
from lunarsim.onboard.hazards.quadtree import _site_kernels as k

SMALL = SiteSettings(
    mesh_band=(1.6, 3.2), hazard_band=(0.8, 0.8), site_band=(0.4, 0.8), zone_half_side=1.1, count=4,
    separation=2.0,
)  # fmt: skip


def ground(p):
    """Return wavy terrain with a bump every few metres."""
    bump = np.hypot(p[:, 0] % 5.0 - 2.0, p[:, 1] % 7.0 - 3.0) < 0.4
    return 0.1 * np.sin(p[:, 0] / 4.0) + 0.03 * p[:, 1] + 0.5 * bump


def flash(rng, centre, width, n):
    p = centre + rng.uniform(-0.5 * width, 0.5 * width, (n, 2))
    return np.column_stack((p, ground(p) + rng.normal(0.0, 0.02, n)))


def test_every_quarter_of_a_cell_is_to_be_seen():
    rng = np.random.default_rng(11)
    root = np.zeros(1, np.int32)
    for sparse in (None, 0, 1, 2, 3):
        quadtree = QuadtreeMap((0.0, 0.0), 3.2, 0.1)
        for q in range(4):
            xy = rng.uniform(0.0, 1.6, (25 if q == sparse else 26, 2))
            xy -= [0.0 if q & 1 else 1.6, 0.0 if q & 2 else 1.6]
            quadtree.insert(np.column_stack((xy, np.zeros(len(xy)))))
        assert k.is_mesh_node(quadtree.tree, root, 10.0)[0] == (sparse is None)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_zone_that_ends_a_micrometre_within_a_cell_takes_all_of_it_in(axis, sign):
    quadtree = QuadtreeMap((0.0, 0.0), 2.0, 0.25)
    # The last point lies between the edges of the zone and of its cell.
    xy = np.full((9, 2), 0.3)
    xy[:, axis] = sign * np.append(np.linspace(0.26, 0.49, 8), 0.5 - 4e-7)
    quadtree.insert(np.column_stack((xy, np.zeros(9))))
    node = quadtree.cell_at(xy[-1])
    cell = quadtree.centres(np.array([node]))[0]
    end = cell[axis] + sign * (0.125 - 1e-6)
    box = np.array([[-0.9, 0.9], [-0.9, 0.9]])
    box[axis, int(sign > 0.0)] = end
    assert quadtree.point_counts(np.array([node]))[0] == 9
    assert abs(xy[-1, axis]) > abs(end)
    stack, sums = np.empty(64, np.int32), np.empty(12)
    k.zone_sums(quadtree.tree, *box.ravel(), 0.0, 0.0, stack, sums)
    assert sums[9] == 9.0


def test_on_an_edge_the_steeper_side_counts():
    # Two triangles form a square; the diagonal passes through its centre.
    px, py = np.array([0, 8, 8, 0]), np.array([0, 0, 8, 8])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    z = np.array([0.0, 1.0, 0.0, 0.0])
    normals = k.normals(px.astype(float), py.astype(float), z, triangles)
    start, index = k.list_triangles(px, py, triangles, 16, 1)
    mesh = (px, py, z, triangles, normals, 16, 1, start, index)
    out = np.empty(3)
    for x, y in ((4, 4), (0, 0), (8, 8)):
        assert k.steepest_normal(x, y, mesh, out) == 0
        assert out[2] == normals[0, 2] < normals[1, 2]
    assert k.steepest_normal(2, 6, mesh, out) == 1
    assert out[2] == normals[1, 2]
    assert k.steepest_normal(9, 1, mesh, out) == -1
    # On the first triangle z = (x - y) / 8; the second is flat.
    assert k.mesh_height(6, 1, mesh, 0, 1.0) == pytest.approx(5.0 / 8.0)
    assert k.mesh_height(2, 6, mesh, 1, 1.0) == 0.0
