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
def _range_around(image, i, j):
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
def _raise_direction_slope(out, patch, direction, slope, brightness_range, min_range):
    """Raise the maximum relative slope of a patch along one direction.

    Element [`patch`, `direction`] of `out` (patches, 5) holds the maximum; it changes only if this
    slope is larger. The relative slope is the brightness gradient `slope` over `brightness_range`.
    If the range is below `min_range`, nothing is done.
    """
    if brightness_range >= min_range:
        out[patch, direction] = max(out[patch, direction], slope / brightness_range)


@kernel(inline=True)
def _raise_slopes(out, patch, image, i, j, min_range):
    """Raise the maximum relative slopes of a patch by those at pixel (i, j).

    `image` is the brightness. Row `patch` of `out` (patches, 5) holds the maxima for four
    directions and the steepest slope; smaller slopes, and edges with a brightness range below
    `min_range`, change nothing.
    """
    gu = 0.5 * (image[i, j + 1] - image[i, j - 1])
    gv = 0.5 * (image[i + 1, j] - image[i - 1, j])
    steep = math.sqrt(gu * gu + gv * gv)
    # The range is at least twice the slope along a row or a column.
    if not steep > 0.02:
        return
    brightness_range = _range_around(image, i, j)
    if not brightness_range >= min_range:
        return
    out[patch, 4] = max(out[patch, 4], steep / brightness_range)
    # Beside a lit face, the range all about belongs to another edge.
    half = ABOUT * brightness_range
    along = max(_range_along(image, i, j, 0, 1), half)
    _raise_direction_slope(out, patch, 0, abs(gu), along, min_range)
    along = max(_range_along(image, i, j, 1, 1), half)
    _raise_direction_slope(out, patch, 1, abs(gu + gv) * _DIAGONAL, along, min_range)
    along = max(_range_along(image, i, j, 1, 0), half)
    _raise_direction_slope(out, patch, 2, abs(gv), along, min_range)
    along = max(_range_along(image, i, j, 1, -1), half)
    _raise_direction_slope(out, patch, 3, abs(gv - gu) * _DIAGONAL, along, min_range)


@kernel()
def edge_slopes(image, labels, count, stride, min_range):
    """Return the maximum relative brightness slope at the edge of each dark patch.

    The result (count + 1, 5), 1/pixels, has one row per label and columns for the directions
    right, right and down, down, left and down, and for the steepest slope; 0 for no edge. A slope
    is divided by the brightness range of the edge within 3 pixels. The steepest slope is divided
    by the range in all directions. A slope along one direction is divided by the range along it,
    but by at least half of the range in all directions. Edges with a range below `min_range` are
    ignored.

    `labels` (height, width) are the patches in `image`, from 1 to `count`, 0 for none. Only
    patches whose label is a multiple of `stride` are measured; the other rows stay 0.
    """
    out = np.zeros((count + 1, SLOPES))
    height, width = labels.shape
    margin = REACH + 1
    for i in range(margin, height - margin):
        for j in range(margin, width - margin):
            k = labels[i, j]
            if k == 0 or k % stride != 0:
                continue
            up, low = labels[i - 1, j] != k, labels[i + 1, j] != k
            left, right = labels[i, j - 1] != k, labels[i, j + 1] != k
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
def sum_dark_and_bright(image, labels, ring_labels, count, min_excess):
    """Sum positions over each dark patch and over the bright pixels beside it.

    The result (count + 1, 6) has one row per label: weight and weighted column and row of the
    bright pixels, then number, column and row of the dark ones. `image` is the brightness relative
    to lit terrain, `labels` are the patches from 1 to `count` (0: none), and `ring_labels` the
    adjacent patch of pixels outside (0: none), all (height, width). The weight of a bright pixel
    is its brightness minus 1 and minus `min_excess`, at most 1; pixels without a positive weight
    are ignored.
    """
    out = np.zeros((count + 1, 6))
    height, width = labels.shape
    for i in range(height):
        for j in range(width):
            k = labels[i, j]
            if k != 0:
                out[k, PIXELS] += 1.0
                out[k, DARK_U] += j
                out[k, DARK_V] += i
                continue
            k = ring_labels[i, j]
            if k == 0:
                continue
            more = min(image[i, j] - 1.0 - min_excess, 1.0)
            if more > 0.0:
                out[k, WEIGHT] += more
                out[k, BRIGHT_U] += more * j
                out[k, BRIGHT_V] += more * i
    return out


@kernel()
def sum_black_and_lit(
    relative,
    relative_to_lit,
    labels,
    ring_labels,
    count,
    black_level,
    grey_level,
    max_grey_weight,
    min_excess,
):
    """Sum positions over the black pixels of each dark patch and over its lit pixels.

    The result (count + 1, 6) has one row per label: weight and weighted column and row of the
    black pixels, then of the lit ones. `labels` are the patches from 1 to `count` (0: none), and
    `ring_labels` the adjacent patch of pixels outside (0: none), both (height, width). Pixels in a
    patch are rated by `relative`, their brightness relative to nearby slopes: black below
    `black_level`, lit above `grey_level`; the weight is the difference to this level, for lit ones
    at most `max_grey_weight`. Pixels outside are rated by `relative_to_lit`, their brightness
    relative to lit pixels nearby: they are lit, with the weight of this minus 1 and minus
    `min_excess`, from 0 to 1.
    """
    out = np.zeros((count + 1, 6))
    height, width = labels.shape
    for i in range(height):
        for j in range(width):
            k = labels[i, j]
            if k != 0:
                dark = black_level - relative[i, j]
                if dark > 0.0:
                    out[k, BLACK] += dark
                    out[k, BLACK_U] += dark * j
                    out[k, BLACK_V] += dark * i
                more = min(relative[i, j] - grey_level, max_grey_weight)
            else:
                k = ring_labels[i, j]
                if k == 0:
                    continue
                more = min(relative_to_lit[i, j] - 1.0 - min_excess, 1.0)
            if more > 0.0:
                out[k, LIT] += more
                out[k, LIT_U] += more * j
                out[k, LIT_V] += more * i
    return out
