# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled measurements of shadow edges and lit faces in an image."""

from __future__ import annotations

import math

import numpy as np

from lunarsim._jit import kernel

# Distance within which the brightness range about an edge is taken, pixels.
REACH = 3
# Minimum range along a direction, as a fraction of the range all about.
ABOUT = 0.5
# Directions of slopes: right, right and down, down, left and down; and that of the steepest slope.
SLOPES = 5
# Sums over the bright pixels beside a patch (weight, column, row), and over the patch (number,
# column, row).
WEIGHT, BRIGHT_U, BRIGHT_V, PIXELS, DARK_U, DARK_V = range(6)
# Sums over the black pixels of a patch, and over its grey ones with the bright ones beside it.
BLACK, BLACK_U, BLACK_V, LIT, LIT_U, LIT_V = range(6)
_DIAGONAL = math.sqrt(0.5)


@kernel(inline=True)
def _range_about(image, i, j):
    """Return the brightness range within 3 pixels of pixel (i, j)."""
    low = high = image[i, j]
    for di in range(-REACH, REACH + 1):
        for dj in range(-REACH, REACH + 1):
            value = image[i + di, j + dj]
            low = min(low, value)
            high = max(high, value)
    return high - low


@kernel(inline=True)
def _range_along(image, i, j, down, right):
    """Return the brightness range within 3 pixels along a line through pixel (i, j).

    One step along the line is `down` rows and `right` columns.
    """
    low = high = image[i, j]
    for n in range(-REACH, REACH + 1):
        value = image[i + n * down, j + n * right]
        low = min(low, value)
        high = max(high, value)
    return high - low


@kernel(inline=True)
def _raise_along(out, k, direction, slope, size, min_range):
    """Update the maximum relative slope of patch `k` along one direction.

    `out` (patches, 5) holds the maxima and `direction` is the column. `slope` is the brightness
    gradient and `size` the brightness range by which it is divided, if the range is at least
    `min_range`.
    """
    if size >= min_range:
        out[k, direction] = max(out[k, direction], slope / size)


@kernel(inline=True)
def _raise_slopes(out, k, image, i, j, min_range):
    """Update the maximum relative slopes of patch `k` with those at pixel (i, j).

    `out` (patches, 5) holds the maxima; brightness ranges below `min_range` are ignored.
    """
    gu = 0.5 * (image[i, j + 1] - image[i, j - 1])
    gv = 0.5 * (image[i + 1, j] - image[i - 1, j])
    steep = math.sqrt(gu * gu + gv * gv)
    # The range is at least twice the slope along a row or a column.
    if not steep > 0.02:
        return
    size = _range_about(image, i, j)
    if not size >= min_range:
        return
    out[k, 4] = max(out[k, 4], steep / size)
    # Beside a lit face, the range all about belongs to another edge.
    half = ABOUT * size
    along = max(_range_along(image, i, j, 0, 1), half)
    _raise_along(out, k, 0, abs(gu), along, min_range)
    along = max(_range_along(image, i, j, 1, 1), half)
    _raise_along(out, k, 1, abs(gu + gv) * _DIAGONAL, along, min_range)
    along = max(_range_along(image, i, j, 1, 0), half)
    _raise_along(out, k, 2, abs(gv), along, min_range)
    along = max(_range_along(image, i, j, 1, -1), half)
    _raise_along(out, k, 3, abs(gv - gu) * _DIAGONAL, along, min_range)


@kernel()
def edge_slopes(image, patch, count, every, min_range):
    """Return the maximum relative brightness slope at the edge of each dark patch.

    The slope is divided by the brightness range of the edge. Along a direction this is the range
    along it, or half of the range all around if this is larger. For the steepest slope it is the
    range all around.

    Parameters
    ----------
    image
        Brightness (height, width).
    patch
        Patch of each pixel (height, width), 1 to `count`, 0 for none.
    count
        Number of patches.
    every
        Only patches whose number is a multiple of this value are measured.
    min_range
        Minimum brightness range of an edge.

    Returns
    -------
    out
        Relative slopes (count + 1, 5), 1 / pixels: in four directions and in the steepest; 0 for no
        edge and for patches that were not measured.
    """
    out = np.zeros((count + 1, SLOPES))
    height, width = patch.shape
    margin = REACH + 1
    for i in range(margin, height - margin):
        for j in range(margin, width - margin):
            k = patch[i, j]
            if k == 0 or k % every != 0:
                continue
            up, low = patch[i - 1, j] != k, patch[i + 1, j] != k
            left, right = patch[i, j - 1] != k, patch[i, j + 1] != k
            if not (up or low or left or right):
                continue
            _raise_slopes(out, k, image, i, j, min_range)
            # The edge lies between this pixel and its neighbour outside.
            if up:
                _raise_slopes(out, k, image, i - 1, j, min_range)
            if low:
                _raise_slopes(out, k, image, i + 1, j, min_range)
            if left:
                _raise_slopes(out, k, image, i, j - 1, min_range)
            if right:
                _raise_slopes(out, k, image, i, j + 1, min_range)
    return out


@kernel()
def two_sides(image, patch, ring, count, cut):
    """Sum positions over each dark patch and over the bright pixels beside it.

    Parameters
    ----------
    image
        Brightness relative to lit terrain (height, width).
    patch
        Patch of each pixel (height, width), 0 for none.
    ring
        Patch adjacent to each pixel outside the patches (height, width), 0 for none.
    count
        Number of patches.
    cut
        Excess of brightness above lit terrain from which a pixel counts. Its weight is its
        brightness minus 1 and minus this excess, at most 1.

    Returns
    -------
    out
        Sums (count + 1, 6): weight and weighted column and row of the bright pixels; number, column
        and row of the dark pixels.
    """
    out = np.zeros((count + 1, 6))
    height, width = patch.shape
    for i in range(height):
        for j in range(width):
            k = patch[i, j]
            if k != 0:
                out[k, PIXELS] += 1.0
                out[k, DARK_U] += j
                out[k, DARK_V] += i
                continue
            k = ring[i, j]
            if k == 0:
                continue
            more = min(image[i, j] - 1.0 - cut, 1.0)
            if more > 0.0:
                out[k, WEIGHT] += more
                out[k, BRIGHT_U] += more * j
                out[k, BRIGHT_V] += more * i
    return out


@kernel()
def black_and_lit(relative, above, patch, ring, count, black, grey, most, cut):
    """Sum positions over the black pixels of each dark patch and over its lit pixels.

    Parameters
    ----------
    relative
        Brightness relative to nearby slopes, for black and grey pixels (height, width).
    above
        Brightness relative to lit pixels nearby, for bright pixels (height, width).
    patch, ring, count
        Patch of each pixel (height, width), patch adjacent to each other pixel (height, width),
        both 0 for none, and number of patches.
    black
        Level below which a pixel of the patch is black; its weight is the difference to this level.
    grey, most
        Level above which a pixel of the patch is lit; its weight is the excess above this level, at
        most `most`.
    cut
        Excess of brightness above lit terrain from which a pixel outside the patch counts as lit.
        Its weight is its brightness minus 1 and minus this excess, at most 1.

    Returns
    -------
    out
        Sums (count + 1, 6): weight and weighted column and row of the black pixels, then of the lit
        pixels.
    """
    out = np.zeros((count + 1, 6))
    height, width = patch.shape
    for i in range(height):
        for j in range(width):
            k = patch[i, j]
            if k != 0:
                dark = black - relative[i, j]
                if dark > 0.0:
                    out[k, BLACK] += dark
                    out[k, BLACK_U] += dark * j
                    out[k, BLACK_V] += dark * i
                more = min(relative[i, j] - grey, most)
            else:
                k = ring[i, j]
                if k == 0:
                    continue
                more = min(above[i, j] - 1.0 - cut, 1.0)
            if more > 0.0:
                out[k, LIT] += more
                out[k, LIT_U] += more * j
                out[k, LIT_V] += more * i
    return out
