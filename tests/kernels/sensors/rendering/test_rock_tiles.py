"""Rocks looked up by tiles: the same as by looking at all of them, and fewer looked at."""

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering import _cull_kernels as cull
from lunarsim.sensors.rendering import _rock_tile_kernels as kernels
from lunarsim.sensors.rendering.rock_tiles import RockTiles
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.sensors.rendering.shadow_map_reads import ShadowMapReads
from tests.reference import rendering as plain


def rocks_at(rng, place):
    """Return rows, reach and feet of rocks of every size at places (n, 2)."""
    count = len(place)
    yaw = rng.uniform(0.0, 2.0 * np.pi, count)
    rocks = np.column_stack(
        (
            place, rng.normal(0.0, 2.0, count),
            *np.exp(rng.uniform(np.log(0.05), np.log(2.0), (3, count))),
            np.cos(yaw), np.sin(yaw), np.zeros(count),
        )
    )  # fmt: skip
    large = rng.random(count) < 0.01
    rocks[large, 3:6] *= rng.uniform(5.0, 40.0)
    reach = rocks[:, 3:5].max(axis=1, initial=0.0) * rng.uniform(1.0, 1.4, count)
    return rocks, reach, rocks[:, 2] - rng.uniform(0.0, 1.0, count)


def world(rng, kind):
    """Return rocks: strewn, on a lattice whose lines are edges of tiles, far out, few or none."""
    count = {"one": 1, "none": 0}.get(kind, 3000)
    place = rng.uniform(-200.0, 200.0, (count, 2))
    if kind == "lattice":
        place = np.round(place / 4.0) * 4.0
    elif kind == "far":  # an outlier stretches the tiles
        place[0] = [9e3, -2e4]
    elif kind == "line":
        place[:, 0] = 3.0
    return rocks_at(rng, place)


def camera(rng, *, level):
    """Return a view of the ground about the origin, or one that looks level."""
    eye = np.array([*rng.uniform(-250.0, 250.0, 2), np.exp(rng.uniform(0.5, 7.0))])
    aim = np.array([*rng.uniform(-150.0, 150.0, 2), eye[2] if level else 0.0])
    axes = sensor_axes(aim - eye)
    focal = rng.uniform(100.0, 3000.0)
    middle = np.array([320.0, 240.0]) * rng.uniform(0.5, 1.5, 2)
    return View(eye, axes, focal, focal * rng.uniform(0.9, 1.1), *middle, 640, 480)


def shadow_frame(rng):
    angle = rng.uniform(0.0, 6.0)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    size = (int(rng.integers(1, 600)), int(rng.integers(1, 600)))
    return ShadowFrame(
        lean=rng.uniform(-8.0, 8.0, 2),
        axes=axes,
        corner=rng.uniform(-250.0, 200.0, 2),
        texel=float(rng.uniform(0.01, 1.0)),
        size=size,
        heights=(10.0, -10.0),
        slack=0.0,
    )


KINDS = ["strewn", "lattice", "far", "line", "one", "none"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_rocks_in_a_view_are_those_found_among_all(kind, seed):
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    rocks, reach, foot = world(rng, kind)
    tiles = RockTiles.of(rocks, reach, foot)
    for turn in range(8):
        view = camera(rng, level=turn % 2 == 1)
        near = float(np.exp(rng.uniform(-4.0, 4.0)))
        found = tiles.visible(view, near)
        every = np.arange(len(rocks), dtype=np.int32)
        box, seen = cull.visible_rocks(
            rocks, reach, foot, every, view.position, view.axes.T.copy(), view.fx, view.fy,
            view.cx, view.cy, float(view.width), float(view.height), near,
        )  # fmt: skip
        assert np.array_equal(found.rock_indices, every[seen])
        assert np.array_equal(found.box, box[seen].astype(np.float32))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_rocks_that_shade_are_those_found_among_all(kind, seed):
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    rocks, reach, foot = world(rng, kind)
    tiles = RockTiles.of(rocks, reach, foot)
    for _ in range(8):
        view, frame = camera(rng, level=False), shadow_frame(rng)
        found = tiles.shadow_casters(view, frame, ShadowMapReads.anywhere(frame))
        every = np.arange(len(rocks), dtype=np.int32)
        none = np.zeros(0)
        box, seen = cull.shadow_casting_rocks(
            rocks, reach, foot, every, view.position, frame.lean, frame.axes, frame.corner,
            frame.texel, float(frame.size[0]), float(frame.size[1]), np.zeros((0, 2)), none, none,
        )  # fmt: skip
        assert np.array_equal(found.rock_indices, every[seen])
        assert np.array_equal(found.box, box[seen].astype(np.float32))


@pytest.mark.parametrize("kind", KINDS)
def test_every_rock_is_in_one_tile_within_its_bounds(kind):
    rng = np.random.default_rng(5)
    rocks, reach, foot = world(rng, kind)
    tiles = RockTiles.of(rocks, reach, foot)
    assert sorted(tiles.order) == list(range(len(rocks)))
    assert tiles.start[-1] == len(rocks)
    assert (np.diff(tiles.start) > 0).all()
    for t in range(len(tiles.low)):
        own = tiles.order[tiles.start[t] : tiles.start[t + 1]]
        low, high, radius, margin = plain.bounds_of_rocks(rocks[own], reach[own], foot[own])
        assert tiles.low[t] == pytest.approx(low)
        assert tiles.high[t] == pytest.approx(high)
        assert tiles.radius[t] == pytest.approx(radius)
        assert tiles.margin[t] == pytest.approx(margin)


@pytest.mark.parametrize("seed", range(6))
def test_tiles_are_left_out_where_their_boxes_lie_outside(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-200.0, 200.0, (400, 3)) * [1.0, 1.0, 0.02]
    high = low + rng.uniform(0.0, 20.0, (400, 3)) * [1.0, 1.0, 0.2]
    radius, margin = rng.uniform(0.1, 4.0, (2, 400))
    view, frame = camera(rng, level=False), shadow_frame(rng)
    axes, near = view.axes.T.copy(), 0.5
    kept = kernels.tiles_in_view(
        low, high, radius, view.position, axes, view.fx, view.fy, view.cx, view.cy, 640.0, 480.0,
        near,
    )  # fmt: skip
    shading = kernels.tiles_that_shade(
        low, high, margin, view.position, frame.lean, frame.axes, frame.corner, frame.texel,
        float(frame.size[0]), float(frame.size[1]),
    )  # fmt: skip
    for t in range(len(low)):
        sides = plain.sides_of_view(axes, (view.fx, view.fy), (view.cx, view.cy), 640, 480, near)
        corners = plain.corners_of_box(low[t], high[t]) - view.position
        assert kept[t] == all((corners @ side[:3] - side[3]).max() >= -radius[t] for side in sides)
        wide = np.array([margin[t], margin[t], 0.0])
        corners = plain.corners_of_box(low[t] - wide, high[t] + wide) - view.position
        place = (corners[:, :2] - corners[:, 2:] * frame.lean) @ frame.axes.T - frame.corner
        last = frame.texel * np.array(frame.size)
        assert shading[t] == (
            (place.max(axis=0) >= -frame.texel).all()
            and (place.min(axis=0) <= last + frame.texel).all()
        )


def test_few_rocks_are_looked_at_where_little_is_seen():
    rng = np.random.default_rng(1)
    rocks, reach, foot = rocks_at(rng, rng.uniform(-1000.0, 1000.0, (20_000, 2)))
    few = reach < 3.0
    tiles = RockTiles.of(rocks[few], reach[few], foot[few])
    axes = sensor_axes([0.0, 0.0, -1.0]).T.copy()
    kept = kernels.tiles_in_view(
        tiles.low, tiles.high, tiles.radius, np.array([0.0, 0.0, 100.0]), axes, 500.0, 500.0,
        320.0, 240.0, 640.0, 480.0, 1.0,
    )  # fmt: skip
    number = kernels.rocks_in_tiles(tiles.order, tiles.start, kept)
    assert 0 < number.size < 0.05 * few.sum()  # the picture holds 0.3 %
    assert (np.diff(number) > 0).all()
