"""Compiled part of the evidence for clear ground: whether a shadow would fall on lit ground."""

from __future__ import annotations

from lunarsim._jit import kernel, prange
from lunarsim.models._pinhole_kernels import to_pixel

# Columns of a node of the coarse grid before those of the core's points.
SHARPNESS, EAST, NORTH, HEIGHT, POINTS = 0, 1, 2, 3, 4


@kernel(inline=True)
def _between(coarse, i, j, u, v, k):
    """Return column k of the coarse grid at the part (u, v) of the square from node (i, j)."""
    top = coarse[i, j, k] + u * (coarse[i, j + 1, k] - coarse[i, j, k])
    low = coarse[i + 1, j, k] + u * (coarse[i + 1, j + 1, k] - coarse[i + 1, j, k])
    return top + v * (low - top)


@kernel()
def _dark_points(
    coarse, i, j, u, v, east, north, up, radius, axes, fx, fy, cx, cy, labels, largest
):  # fmt: skip
    """Return how many points of a shadow's core are dark, and how many of these are explained.

    -1 if one is out of view. Dark is what may be the shadow of so large a rock.
    """
    high, wide = labels.shape
    dark = explained = 0
    for k in range(POINTS, coarse.shape[2], 2):
        e = east + radius * _between(coarse, i, j, u, v, k)
        n = north + radius * _between(coarse, i, j, u, v, k + 1)
        z = axes[0, 2] * e + axes[1, 2] * n + axes[2, 2] * up
        if z <= 0.0:
            return -1, 0
        x = axes[0, 0] * e + axes[1, 0] * n + axes[2, 0] * up
        y = axes[0, 1] * e + axes[1, 1] * n + axes[2, 1] * up
        px, py = to_pixel(x, y, z, fx, fy, cx, cy)
        if not (px >= 0.0 and py >= 0.0 and px <= wide - 1 and py <= high - 1):
            return -1, 0
        of = largest[labels[int(py + 0.5), int(px + 0.5)]]
        if abs(of) >= radius:
            dark += 1
            if of < 0.0:
                explained += 1
    return dark, explained


@kernel(parallel=True)
def look(
    lit, dark, explained, radii, coarse, every, position, axes, fx, fy, cx, cy, labels, largest,
    least, gain,
):  # fmt: skip
    """Note for every place and size of rock whether its shadow would fall on lit ground.

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
        of the place, elevation of the ground, and east and north of the points of the core for a
        rock of radius 1.
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
    """
    sizes, rows, cols = lit.shape
    for i in prange(rows):
        vi = min(i // every, coarse.shape[0] - 2)
        v = i / every - vi
        for j in range(cols):
            uj = min(j // every, coarse.shape[1] - 2)
            u = j / every - uj
            sharpness = _between(coarse, vi, uj, u, v, SHARPNESS)
            if not sharpness > 0.0:
                continue
            east = _between(coarse, vi, uj, u, v, EAST) - position[0]
            north = _between(coarse, vi, uj, u, v, NORTH) - position[1]
            up = _between(coarse, vi, uj, u, v, HEIGHT) - position[2]
            for s in range(sizes):
                if sharpness <= gain * max(lit[s, i, j], dark[s, i, j]):
                    continue
                count, known = _dark_points(
                    coarse, vi, uj, u, v, east, north, up, radii[s], axes, fx, fy, cx, cy, labels,
                    largest,
                )  # fmt: skip
                if count >= least:
                    dark[s, i, j] = sharpness
                    explained[s, i, j] = 2 * known > count
                elif count >= 0:
                    lit[s, i, j] = sharpness
