"""Compiled part of the evidence for clear ground: whether a shadow would fall on lit ground."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel, prange
from lunarsim.models._pinhole_kernels import to_pixel

# Columns of a node of the coarse grid before those of the core's points.
SHARPNESS, EAST, NORTH, HEIGHT, REACH, POINTS = 0, 1, 2, 3, 4, 5
# Ground that may show farther aside than so many radii of a rock is not searched for it.
_MOST_STEPS = 16
# What shows so far beyond an edge is out of view whatever rounding does, pixels.
_BEYOND = 0.01


@kernel(inline=True)
def _between(coarse, i, j, u, v, k):
    """Return column k of the coarse grid at the part (u, v) of the square from node (i, j)."""
    top = coarse[i, j, k] + u * (coarse[i, j + 1, k] - coarse[i, j, k])
    low = coarse[i + 1, j, k] + u * (coarse[i + 1, j + 1, k] - coarse[i + 1, j, k])
    return top + v * (low - top)


@kernel(inline=True)
def _along_sensor(core, coarse, i, j, u, v, position, axes):
    """Return a place along the sensor's axes, and by how much it shows nearer if a metre lower.

    Write the points of the core there (points, 3): those of a shadow's core for a radius of 1.
    """
    for k in range(core.shape[0]):
        e = _between(coarse, i, j, u, v, POINTS + 2 * k)
        n = _between(coarse, i, j, u, v, POINTS + 2 * k + 1)
        for c in range(3):
            core[k, c] = axes[0, c] * e + axes[1, c] * n
    e = _between(coarse, i, j, u, v, EAST) - position[0]
    n = _between(coarse, i, j, u, v, NORTH) - position[1]
    h = _between(coarse, i, j, u, v, HEIGHT) - position[2]
    return (
        axes[0, 0] * e + axes[1, 0] * n + axes[2, 0] * h,
        axes[0, 1] * e + axes[1, 1] * n + axes[2, 1] * h,
        axes[0, 2] * e + axes[1, 2] * n + axes[2, 2] * h,
        np.sqrt(e * e + n * n) / max(-h, 1e-9),
    )


@kernel()
def _dark_points(core, cores, x0, y0, z0, radius, fx, fy, cx, cy, labels, largest):
    """Return how many points of the darkest core are dark, and how many of these are explained.

    -1 if one of any core is out of view. Dark is what may be the shadow of so large a rock. The
    place lies at (x0, y0, z0) along the sensor's axes.
    """
    high, wide = labels.shape
    each = core.shape[0] // cores
    most = of_most = 0
    for first in range(0, cores * each, each):
        dark = explained = 0
        for k in range(first, first + each):
            z = z0 + radius * core[k, 2]
            if z <= 0.0:
                return -1, 0
            x = x0 + radius * core[k, 0]
            y = y0 + radius * core[k, 1]
            px, py = to_pixel(x, y, z, fx, fy, cx, cy)
            if not (px >= 0.0 and py >= 0.0 and px <= wide - 1 and py <= high - 1):
                return -1, 0
            of = largest[labels[int(py + 0.5), int(px + 0.5)]]
            if abs(of) >= radius:
                dark += 1
                if of < 0.0:
                    explained += 1
        # Of two as dark the one that is not explained counts.
        if dark > most or (dark == most and explained < of_most):
            most, of_most = dark, explained
    return most, of_most


@kernel()
def _dark_elsewhere(
    core, cores, x, y, z, reach, lateral, radius, up, fx, fy, cx, cy, labels, largest
):
    """Tell whether any of a shadow's core may be dark if the ground is higher or lower.

    By up to `reach` (m), which moves the place by up to `lateral` (m) on level ground; `up` is the
    vertical along the sensor's axes. Steps are about a rock's radius. What is the shadow of a rock
    that is tracked is that of none that stands here.
    """
    # So too if it is no number.
    if not lateral < (_MOST_STEPS + 0.5) * radius:
        return True
    steps = int(lateral / radius + 0.5)
    for n in range(-steps, steps + 1):
        if n == 0:
            continue
        by = reach * n / steps
        count, tracked = _dark_points(
            core, cores, x + by * up[0], y + by * up[1], z + by * up[2], radius, fx, fy, cx, cy,
            labels, largest,
        )  # fmt: skip
        if count < 0 or count > tracked:
            return True
    return False


@kernel()
def _middle_may_show(coarse, i, j, radius, position, axes, fx, fy, cx, cy, wide, high):
    """Tell whether the middle of a shadow's core may be in view from the square at node (i, j).

    Between the nodes it lies in the hull of those at the four, and so does its picture: not if all
    of them are behind the camera, or in front of it and beyond the same edge.
    """
    behind = left = right = above = below = 0
    for a in range(i, i + 2):
        for b in range(j, j + 2):
            e = coarse[a, b, EAST] + radius * coarse[a, b, POINTS] - position[0]
            n = coarse[a, b, NORTH] + radius * coarse[a, b, POINTS + 1] - position[1]
            h = coarse[a, b, HEIGHT] - position[2]
            z = axes[0, 2] * e + axes[1, 2] * n + axes[2, 2] * h
            if not z > 0.0:
                behind += z <= 0.0
                continue
            x = axes[0, 0] * e + axes[1, 0] * n + axes[2, 0] * h
            y = axes[0, 1] * e + axes[1, 1] * n + axes[2, 1] * h
            px, py = to_pixel(x, y, z, fx, fy, cx, cy)
            left += px < -_BEYOND
            right += px > wide - 1 + _BEYOND
            above += py < -_BEYOND
            below += py > high - 1 + _BEYOND
    return max(behind, left, right, above, below) < 4


@kernel(parallel=True)
def _squares_in_view(coarse, radii, position, axes, fx, fy, cx, cy, wide, high):
    """Tell of each square of the coarse grid and size whether it need be looked at."""
    rows, cols = coarse.shape[0] - 1, coarse.shape[1] - 1
    out = np.empty((rows, cols, len(radii)), np.bool_)
    for i in prange(rows):
        for j in range(cols):
            for s in range(len(radii)):
                out[i, j, s] = _middle_may_show(
                    coarse, i, j, radii[s], position, axes, fx, fy, cx, cy, wide, high
                )
    return out


@kernel()
def _look_along(
    i, lit, dark, explained, radii, coarse, in_view, every, position, axes, fx, fy, cx, cy, labels,
    largest, least, gain, cores,
):  # fmt: skip
    """Note row i of the places, see `look`."""
    sizes, _, cols = lit.shape
    points = (coarse.shape[2] - POINTS) // 2
    core = np.empty((points, 3))
    vi = min(i // every, coarse.shape[0] - 2)
    v = i / every - vi
    for j in range(cols):
        uj = min(j // every, coarse.shape[1] - 2)
        u = j / every - uj
        sharpness = _between(coarse, vi, uj, u, v, SHARPNESS)
        if not sharpness > 0.0:
            continue
        # Before any size asks for them nothing is worked out.
        known = False
        x = y = z = cotangent = 0.0
        reach = _between(coarse, vi, uj, u, v, REACH)
        for s in range(sizes):
            if not in_view[vi, uj, s]:
                continue
            if sharpness <= gain * max(lit[s, i, j], dark[s, i, j]):
                continue
            if not known:
                x, y, z, cotangent = _along_sensor(core, coarse, vi, uj, u, v, position, axes)
                known = True
            count, tracked = _dark_points(
                core, cores, x, y, z, radii[s], fx, fy, cx, cy, labels, largest
            )
            if count >= least:
                dark[s, i, j] = sharpness
                explained[s, i, j] = 2 * tracked > count
            elif count >= 0 and not _dark_elsewhere(
                core, cores, x, y, z, reach, reach * cotangent, radii[s], axes[2], fx, fy, cx, cy,
                labels, largest,
            ):  # fmt: skip
                lit[s, i, j] = sharpness


@kernel(parallel=True)
def look(
    lit, dark, explained, radii, coarse, every, position, axes, fx, fy, cx, cy, labels, largest,
    least, gain, cores,
):  # fmt: skip
    """Note for every place and size of rock whether its shadow would fall on lit ground.

    On lit ground it falls if it does so however high the ground may be; what is dark only at
    another height is noted neither as lit nor as dark.

    Parameters
    ----------
    lit, dark
        Sharpness of the sharpest look in which it would fall on lit ground, or on dark
        (sizes, rows, cols); raised.
    explained
        Whether that dark ground was the shadow of a rock that is tracked (sizes, rows, cols).
    radii
        Of the rocks (sizes,), m.
    coarse
        At every `every`-th place, in between it is linear: sharpness of this look, east and north
        of the place, elevation of the ground and by how much it may be higher or lower, and east
        and north of the points of the cores for a rock whose half axis is 1, core after core.
    position, axes, fx, fy, cx, cy
        Of the camera, as `View` has them.
    labels
        Dark patch of each pixel (height, width), 0 where the image is lit.
    largest
        Radius of the largest rock that each patch may be the shadow of, m; negative if it is that
        of a rock that is tracked.
    least
        Points that must be dark for a rock to be possible.
    gain
        Factor by which a look must be sharper than those before to be taken.
    cores
        How many there are: shadows that a rock of the size may throw, each of as many points.
    """
    high, wide = labels.shape
    in_view = _squares_in_view(coarse, radii, position, axes, fx, fy, cx, cy, wide, high)
    for i in prange(lit.shape[1]):
        _look_along(
            i, lit, dark, explained, radii, coarse, in_view, every, position, axes, fx, fy, cx, cy,
            labels, largest, least, gain, cores,
        )  # fmt: skip
