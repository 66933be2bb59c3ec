"""Small rocks met ray by ray, against rays that go step by step."""

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.rocks.shapes import shape_table
from lunarsim.sensors.rendering import _small_rock_kernels as kernels
from tests.reference import rocks as plain

SHAPES = np.array([0, 1, 3, 9])
FAR = 16.0


def test_boxes_of_few_pixels_are_split_from_the_rest():
    box = np.array(
        [[0.5, 0.5, 4.5, 4.5], [-0.5, 1.5, 4.5, 5.5], [2.5, 2.5, 3.5, 5.5], [0.5, 0.5, 17.5, 1.5]],
        dtype=np.float32,
    )  # 16, 20, 3 and 17 pixels
    small, start, rest = kernels.split_by_size(box)
    assert small.tolist() == [0, 2]
    assert start.tolist() == [0, 16, 19]
    assert rest.tolist() == [1, 3]


def scene(seed):
    """Return rocks of some shapes near the origin, and a table of boxes for some of them."""
    rng = np.random.default_rng(seed)
    count = 10
    yaw = rng.uniform(0.0, 6.0, count)
    rocks = np.column_stack(
        (
            rng.uniform(-1.0, 1.0, (count, 2)), rng.uniform(-0.5, 0.5, count),
            rng.uniform(0.4, 0.9, (count, 3)), np.cos(yaw), np.sin(yaw), rng.choice(SHAPES, count),
        )
    )  # fmt: skip
    number = np.array([7, 2, 5, 0, 9], dtype=np.int32)
    small = np.array([0, 1, 3, 4])  # the third box is large and left out
    size = np.array([[4, 3], [2, 5], [9, 9], [1, 1], [3, 4]])
    start = np.concatenate(([0], np.cumsum(size[small].prod(axis=1))))
    return rng, rocks, number, small, size, start


def pixels(box):
    """Return the whole pixels of a box, row by row."""
    columns, rows = (np.arange(box[k] + 0.5, box[k + 2]) for k in (0, 1))
    return [(u, v) for v in rows for u in columns]


@pytest.mark.parametrize("seed", range(4))
def test_rays_through_the_pixels(seed):
    rng, rocks, number, small, size, start = scene(seed)
    table = shape_table()
    eye = np.array([*rng.uniform(-4.0, 4.0, 2), 8.0])
    axes = sensor_axes(np.array([*rng.uniform(-0.5, 0.5, 2), 0.0]) - eye)
    focal, principal, near = np.array([30.0, 34.0]), np.array([15.5, 11.0]), 0.1
    middle = (rocks[number, :3] - eye) @ axes
    corner = np.floor(middle[:, :2] / middle[:, 2:] * focal + principal - size / 2) - 0.5
    box = np.hstack((corner, corner + size)).astype(np.float32)
    rows, hit = kernels.trace_view_rays(
        rocks, table.planes, table.count, box, number, small, start, eye, axes.T.copy(),
        *focal, *principal, near,
    )  # fmt: skip
    assert rows.shape == (start[-1], 7)
    agreed = met = 0
    for k, m in enumerate(small):
        rock = rocks[number[m]]
        planes = table.planes[int(rock[8]), : table.count[int(rock[8])]]
        for (u, v), row, found in zip(
            pixels(box[m]), rows[start[k] : start[k + 1]], hit[start[k] :], strict=False
        ):
            tangents = (np.array([u, v]) - principal) / focal
            direction = axes @ [*tangents, 1.0]
            depth = plain.entry(eye, direction, rock, planes, FAR, 0.01)
            wanted = np.isfinite(depth)
            met += wanted
            if not (wanted and found):
                agreed += wanted == found
                continue
            up = plain.normal(eye + depth * direction, rock, planes)
            agreed += np.allclose(row, [u, v, depth, *up, number[m]], atol=2e-4)
    assert agreed >= start[-1] - 1  # a ray along an edge
    assert met > 8


def test_nothing_is_met_nearer_than_near():
    table = shape_table()
    rock = np.array([[0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 1.0, 0.0, 0.0]])
    box, none = np.array([[-0.5, -0.5, 0.5, 0.5]], dtype=np.float32), np.zeros(1, np.int32)
    down = sensor_axes([0.0, 0.0, -1.0]).T.copy()
    for near, wanted in ((1.49, True), (1.51, False)):
        _, hit = kernels.trace_view_rays(
            rock, table.planes, table.count, box, none, np.zeros(1, np.int64), np.array([0, 1]),
            np.array([0.0, 0.0, 2.0]), down, 10.0, 10.0, 0.0, 0.0, near,
        )  # fmt: skip
        assert hit.tolist() == [wanted]


@pytest.mark.parametrize("seed", range(4))
def test_rays_to_the_sun_through_the_texels(seed):
    rng, rocks, number, small, size, start = scene(seed)
    table = shape_table()
    eye, lean, texel = rng.uniform(-2.0, 2.0, 3), rng.uniform(-2.0, 2.0, 2), 0.3
    angle = rng.uniform(0.0, 6.0)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corner, highest, lowest = np.array([-5.0, -4.0]), 1.0, -1.5
    above = rocks[number, :3] - eye
    ground = (above[:, :2] - above[:, 2:] * lean) @ axes.T
    low = np.floor((ground - corner) / texel - size / 2) - 0.5
    box = np.hstack((low, low + size)).astype(np.float32)
    rows, hit = kernels.trace_sun_rays(
        rocks, table.planes, table.count, box, number, small, start, eye, lean, axes, corner,
        texel, highest, lowest,
    )  # fmt: skip
    agreed = met = 0
    for k, m in enumerate(small):
        rock = rocks[number[m]]
        planes = table.planes[int(rock[8]), : table.count[int(rock[8])]]
        for (u, v), row, found in zip(
            pixels(box[m]), rows[start[k] : start[k + 1]], hit[start[k] :], strict=False
        ):
            a = corner + texel * (np.array([u, v]) + 0.5)
            foot = np.array([*(eye[:2] + a @ axes), eye[2]])
            ray = np.array([*lean, 1.0])
            # Rocks may lie below the camera: the ray starts below them.
            t = plain.entry(foot - 8.0 * ray, ray, rock, planes, FAR, 0.005) - 8.0
            wanted = np.isfinite(t)
            met += wanted
            if not (wanted and found):
                agreed += wanted == found
                continue
            depth = min(max((highest - t) / (highest - lowest), 0.0), 1.0)
            agreed += np.allclose(row, [u, v, depth], atol=1e-5)
    assert agreed >= start[-1] - 1
    assert met > 8
