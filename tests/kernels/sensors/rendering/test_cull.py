"""Which rocks a picture draws, and where, against the plain reference."""

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.sensors.rendering import _cull_kernels as kernels
from tests.reference import rendering as plain

WIDTH, HEIGHT = 40, 30


def scene(seed, count=150):
    """Return rocks of every size and turn about the origin, their reach and their feet."""
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(0.0, 2.0 * np.pi, count)
    rocks = np.column_stack(
        (
            rng.uniform(-30.0, 30.0, (count, 2)),
            rng.normal(0.0, 1.0, count),
            *np.exp(rng.uniform(np.log(0.05), np.log(3.0), (3, count))),
            np.cos(yaw),
            np.sin(yaw),
            np.zeros(count),
        )
    )
    reach = rocks[:, 3:5].max(axis=1) * rng.uniform(1.0, 1.4, count)
    return rng, rocks, reach, rocks[:, 2] - rng.uniform(0.0, 1.0, count)


def looked_at(rng, rocks):
    """Return the numbers of nine rocks in ten."""
    return np.flatnonzero(rng.random(len(rocks)) < 0.9).astype(np.int32)


@pytest.mark.parametrize("seed", range(3))
def test_feet_are_below_the_relief(seed):
    rng, rocks, reach, _ = scene(seed)
    z = rng.normal(size=(37, 43)).astype(np.float32)
    corner, p = rng.uniform(-28.0, -22.0, 2), 1.3
    rocks[:, 2] -= 1.0  # some bases are below every post
    foot = kernels.rock_feet(rocks, reach, z, *corner, p)
    for rock, r, found in zip(rocks, reach, foot, strict=True):
        assert found == pytest.approx(plain.lowest_under_rock(rock, r, z, corner, p) - 0.01)


@pytest.mark.parametrize("seed", range(8))
def test_boxes_hold_the_pixels_of_the_rocks(seed):
    rng, rocks, reach, foot = scene(seed)
    eye = np.array([*rng.uniform(-25.0, 25.0, 2), rng.uniform(0.5, 30.0)])
    axes = sensor_axes([*rng.uniform(-10.0, 10.0, 2), 0.0] - eye).T
    focal, near = rng.uniform(20.0, 60.0, 2), 0.05
    principal = np.array([WIDTH, HEIGHT]) * rng.uniform(0.3, 0.7, 2)
    number = looked_at(rng, rocks)
    box, seen = kernels.visible_rocks(
        rocks, reach, foot, number, eye, axes, *focal, *principal, WIDTH, HEIGHT, near
    )
    assert 5 <= seen.sum() < len(number)
    for m, n in enumerate(number):
        rock = rocks[n]
        points = (plain.corners_of_rock(rock, reach[n], foot[n]) - eye) @ axes.T
        ball = 1.5 * reach[n] + max(rock[5], rock[2] - foot[n])
        centre = axes @ (rock[:3] - eye)
        if not plain.ball_in_view(centre, ball, focal, principal, WIDTH, HEIGHT, near):
            assert not seen[m]
            if (points[:, 2] < 0.02).any():
                continue
        if (points[:, 2] < 0.02).any():
            wanted = (0, 0, WIDTH - 1, HEIGHT - 1)
        else:
            u, v = (points[:, :2] / points[:, 2:] * focal + principal).T
            wanted = plain.whole_pixels(u, v, WIDTH, HEIGHT)
        assert seen[m] == (wanted is not None)
        if seen[m]:
            assert box[m].tolist() == [
                wanted[0] - 0.5,
                wanted[1] - 0.5,
                wanted[2] + 0.5,
                wanted[3] + 0.5,
            ]


@pytest.mark.parametrize("seed", range(8))
def test_boxes_hold_the_texels_of_the_shadows(seed):
    rng, rocks, reach, foot = scene(seed)
    eye = rng.uniform(-5.0, 5.0, 3)
    lean = rng.uniform(-3.0, 3.0, 2)
    angle = rng.uniform(0.0, 6.0)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corner, texel = np.array([-14.0, -10.0]), 0.7
    number = looked_at(rng, rocks)
    unread = 0
    # A strip as a picture leaves it that looks at no more of the map; none in half of the cases.
    turn = rng.uniform(0.0, 6.0)
    normal = np.array([[np.cos(turn), np.sin(turn)]])[: seed % 2]
    least, most = np.array([[-1.0], [1.0]])[:, : seed % 2] + normal @ [20.0, 15.0]
    box, seen = kernels.shadow_casting_rocks(
        rocks, reach, foot, number, eye, lean, axes, corner, texel, WIDTH, HEIGHT, normal, least,
        most,
    )  # fmt: skip
    assert 5 <= seen.sum() < len(number)
    for m, n in enumerate(number):
        rock = rocks[n]
        points = plain.corners_of_rock(rock, reach[n], foot[n]) - eye
        ground = points[:, :2] - points[:, 2:] * lean  # along the light to the eye's height
        u, v = ((ground @ axes.T - corner) / texel - 0.5).T
        wanted = plain.whole_pixels(u, v, WIDTH, HEIGHT)
        if not plain.is_read(u + 0.5, v + 0.5, WIDTH, HEIGHT, normal, least, most):
            unread += wanted is not None
            wanted = None
        assert seen[m] == (wanted is not None)
        if seen[m]:
            assert box[m].tolist() == [
                wanted[0] - 0.5,
                wanted[1] - 0.5,
                wanted[2] + 0.5,
                wanted[3] + 0.5,
            ]
    assert (unread > 0) == (seed % 2 == 1)


def test_boxes_are_gathered_with_their_numbers():
    rng = np.random.default_rng(0)
    box = rng.normal(size=(20, 4))
    picked = rng.random(20) < 0.4
    named = np.sort(rng.choice(90, 20, replace=False)).astype(np.int32)
    rows, number = kernels.select_boxes(box, named, picked)
    assert np.array_equal(number, named[picked])
    assert np.array_equal(rows, box[picked].astype("f4"))


def test_corners_of_boxes_are_counted_from_the_corner_of_the_image():
    box = np.array([[1.5, 2.5, 8.5, 9.5], [-0.5, -0.5, 3.5, 0.5]])
    corners = kernels.box_corners(box, np.array([7, 4], dtype=np.int32), np.array([1, 0]))
    assert corners.tolist() == [
        [0.0, 0.0, 4.0], [4.0, 0.0, 4.0], [0.0, 1.0, 4.0], [4.0, 1.0, 4.0],
        [2.0, 3.0, 7.0], [9.0, 3.0, 7.0], [2.0, 10.0, 7.0], [9.0, 10.0, 7.0],
    ]  # fmt: skip
