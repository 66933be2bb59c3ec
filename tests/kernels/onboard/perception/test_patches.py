"""The whole table of dark patches against a plain measuring of each."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.onboard.perception import _patch_kernels as kernels


def ground_point(tx, ty, axes, drop, sun):
    """Return where a line of sight meets the plane, towards the Sun and to the left of it."""
    ray = axes @ [tx, ty, 1.0]
    e, n = drop / ray[2] * ray[:2]
    return np.array([e * sun[0] + n * sun[1], n * sun[0] - e * sun[1]])


def measured(labels, k, edges, deep, x, y, axes, drop, sun):
    """Return the row of patch k, pixel by pixel."""
    height, width = labels.shape
    row = dict.fromkeys(("border", "edge", "seen"), 0)
    places, spans, tangents = [], [], []
    for i, j in np.argwhere(labels == k):
        up = (axes @ [x[i, j], y[i, j], 1.0])[2]
        outer = i in (0, height - 1) or j in (0, width - 1)
        sky = up * drop <= 0.0
        bad = outer or sky or abs(up) < 1e-3
        row["border"] |= bad
        near = [(i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)]
        rim = outer if bad else any(labels[place] != k for place in near)
        row["edge"] += rim
        row["seen"] += rim and edges[i, j] != 0
        tangents.append([x[i, j], y[i, j]])
        if sky:
            continue
        places.append(ground_point(x[i, j], y[i, j], axes, drop, sun))
        if rim:
            h = 1e-6
            moves = [
                (ground_point(x[i, j] + a, y[i, j] + b, axes, drop, sun)
                 - ground_point(x[i, j] - a, y[i, j] - b, axes, drop, sun)) / (2.0 * h)
                for a, b in ((h, 0.0), (0.0, h))
            ]  # fmt: skip
            spans.append(np.linalg.norm(moves, axis=0))
    pixels = len(tangents)
    mean = np.sum(places, axis=0) / pixels
    square = np.sum(np.square(places), axis=0) / pixels
    size = np.sqrt(12.0 * np.maximum(square - mean**2, 0.0))
    skew = np.sum(np.prod(places, axis=1)) / pixels - np.prod(mean)
    span = np.sum(spans, axis=0) / max(row["edge"], 1)
    return [
        *mean, *size, pixels, row["edge"], row["seen"], row["border"], *np.mean(tangents, axis=0),
        *np.broadcast_to(span, 2), skew, np.count_nonzero(deep[labels == k]),
    ]  # fmt: skip


@pytest.mark.parametrize(("seed", "tilt"), [(0, 0.3), (1, 0.9), (2, 1.35)])
def test_table_of_patches(seed, tilt):
    """Almost level, tilted, and with the horizon in the picture."""
    rng = np.random.default_rng(seed)
    height, width = 40, 50
    labels = np.zeros((height, width), np.int32)
    for label in range(1, 25):
        i, j = rng.integers(0, height - 3), rng.integers(0, width - 3)
        h, w = rng.integers(2, 12, 2)
        labels[i : i + h, j : j + w] = label
    edges = (rng.random((height, width)) < 0.4).astype(np.uint8)
    deep = (rng.random((height, width)) < 0.7).astype(np.uint8)
    x, y = np.meshgrid((np.arange(width) - 24.0) / 45.0, (np.arange(height) - 19.0) / 40.0)
    down = Rotation.from_matrix([[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    turn = Rotation.from_euler("zx", [rng.uniform(0.0, 6.0), tilt])
    axes = (turn * down).as_matrix()
    position, ground = np.array([30.0, -20.0, 55.0]), -4.0
    angle = rng.uniform(0.0, 6.0)
    sun = np.array([np.cos(angle), np.sin(angle)])
    table = kernels.measure_patches(labels, 26, edges, deep, x, y, position, axes, ground, *sun)
    assert table.shape == (27, 14)
    met = 0
    for k in np.unique(labels[labels > 0]):
        up = (x[labels == k, None] * axes[2, 0] + y[labels == k, None] * axes[2, 1]) + axes[2, 2]
        if (up * (ground - position[2]) > 0.0).any() and np.abs(up).min() > 0.02:
            met += 1
            wanted = measured(labels, k, edges, deep, x, y, axes, ground - position[2], sun)
            assert table[k] == pytest.approx(wanted, rel=1e-5, abs=1e-9)
    assert met >= 2
    assert not table[[0, 25, 26]].any()


def test_patches_of_the_sky_alone_have_no_place():
    labels = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 0]], dtype=np.int32)
    flat = np.zeros((3, 3))
    up = np.eye(3)  # looks straight up
    row = kernels.measure_patches(
        labels, 1, np.ones((3, 3), np.uint8), np.zeros((3, 3), np.uint8), flat, flat,
        np.array([0.0, 0.0, 9.0]), up, 0.0, 1.0, 0.0,
    )[1]  # fmt: skip
    assert row[[kernels.PIXELS, kernels.BORDER, kernels.EDGE]].tolist() == [1.0, 1.0, 0.0]
    assert not row[[kernels.ALONG, kernels.ACROSS, kernels.LENGTH, kernels.SPAN_ALONG]].any()
