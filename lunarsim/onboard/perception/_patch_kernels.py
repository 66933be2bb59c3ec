# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled measurement of dark patches in one pass over a label image."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Columns of the table of patches: mean coordinate towards the Sun and to the left of it from below
# the camera, m; length and width of the rectangle with the same variances, m; pixels; pixels at the
# rim and how many of these lie on an edge of the image; whether the patch touches the border or the
# horizon; mean tangents; size of a pixel along the Sun and across at the patch, m; covariance of
# the two coordinates, m^2; pixels that are darker than half way to lit terrain.
(
    ALONG, ACROSS, LENGTH, WIDTH, PIXELS, EDGE, SEEN, BORDER, TX, TY, SPAN_ALONG, SPAN_ACROSS,
    SKEW, DEEP,
) = range(14)  # fmt: skip
COLUMNS = 14


@kernel(inline=True)
def _borders_on(label, up, down, left, right):
    """Return whether a neighbour of a pixel has another label than the pixel.

    `label` is that of the pixel, `up` to `right` are those of its four neighbours.
    """
    return up != label or down != label or left != label or right != label


@kernel(inline=True)
def _count_pixel(out, label, tx, ty, is_rim, is_edge, is_deep):
    """Count a pixel in row `label` of the patch table `out` and add its tangents.

    `tx` and `ty` are the tangents of its line of sight. The flags state whether the pixel is at
    the rim of its patch, on a brightness edge of the image (counted only at the rim), and darker
    than half way to lit terrain (deep).
    """
    out[label, PIXELS] += 1.0
    if is_deep:
        out[label, DEEP] += 1.0
    out[label, TX] += tx
    out[label, TY] += ty
    if is_rim:
        out[label, EDGE] += 1.0
        if is_edge:
            out[label, SEEN] += 1.0


@kernel(inline=True)
def _add_moments(out, label, along, across):
    """Add the position of a pixel to the moments of its patch.

    `along` and `across` are its coordinates towards the Sun and to the left of it, m. The moments
    are in row `label` of the table `out`.
    """
    out[label, ALONG] += along
    out[label, ACROSS] += across
    out[label, LENGTH] += along * along
    out[label, WIDTH] += across * across
    out[label, SKEW] += along * across


@kernel()
def _line_of_sight(tx, ty, right, down, ahead):
    """Return the line of sight of a pixel: east, north and up for a depth of 1 m.

    `tx` and `ty` are its tangents to the right and down; `right`, `down` and `ahead` are the
    sensor axes, as tuples of east, north and up.
    """
    return (
        right[0] * tx + down[0] * ty + ahead[0],
        right[1] * tx + down[1] * ty + ahead[1],
        right[2] * tx + down[2] * ty + ahead[2],
    )


@kernel()
def _to_sun(east, north, sun):
    """Return the components of a horizontal vector along the Sun and to its left.

    `east` and `north` are the vector, and `sun` (2) is the horizontal unit vector towards the Sun.
    """
    return east * sun[0] + north * sun[1], north * sun[0] - east * sun[1]


@kernel()
def _pixel_size_on_terrain(depth, ray, right, down, sun):
    """Return the size of a pixel on the terrain along the Sun and across it.

    The sizes are in m times the focal length in pixels. `depth` is the depth of the terrain point,
    m, `ray` its line of sight, `right` and `down` are sensor axes, and `sun` is the horizontal
    unit vector towards the Sun.
    """
    # Displacement of the terrain point along and across for one pixel right and down.
    along_u, across_u = _to_sun(
        depth * (right[0] - ray[0] * right[2] / ray[2]),
        depth * (right[1] - ray[1] * right[2] / ray[2]),
        sun,
    )
    along_v, across_v = _to_sun(
        depth * (down[0] - ray[0] * down[2] / ray[2]),
        depth * (down[1] - ray[1] * down[2] / ray[2]),
        sun,
    )
    return np.hypot(along_u, along_v), np.hypot(across_u, across_v)


@kernel()
def _sums_to_means(out):
    """Convert the sums over each patch in `out` to the results of `measure_patches`.

    `out` (patches + 1, 14) is changed in place: sums become means, second moments become lengths,
    widths and the covariance.
    """
    for k in range(1, out.shape[0]):
        pixels = max(out[k, PIXELS], 1.0)
        out[k, TX] /= pixels
        out[k, TY] /= pixels
        for mean, size in ((ALONG, LENGTH), (ACROSS, WIDTH)):
            out[k, mean] /= pixels
            variance = out[k, size] / pixels - out[k, mean] ** 2
            out[k, size] = np.sqrt(12.0 * max(variance, 0.0))
        out[k, SKEW] = out[k, SKEW] / pixels - out[k, ALONG] * out[k, ACROSS]
        rims = max(out[k, EDGE], 1.0)
        out[k, SPAN_ALONG] /= rims
        out[k, SPAN_ACROSS] /= rims


@kernel()
def measure_patches(
    labels,
    count,
    edge_mask,
    deep_mask,
    tan_right,
    tan_down,
    position,
    axes,
    elevation,
    sun_e,
    sun_n,
):
    """Measure position, size and darkness of dark patches on a horizontal plane.

    The result (count + 1, 14) has the columns listed at the top of the module; sizes of pixels are
    multiplied by the focal length. `labels` are the patches in the image (0: none), `edge_mask`
    marks brightness edges, and `deep_mask` pixels darker than half way to lit terrain. `tan_right`
    and `tan_down` are the tangents of the line of sight of each pixel; all are (height, width). The
    pixels are projected from the camera at `position` (3,), m, with the matrix `axes` (3, 3) from
    sensor axes to ENU, onto the plane at `elevation`, m. (`sun_e`, `sun_n`) is the horizontal unit
    vector towards the Sun.
    """
    out = np.zeros((count + 1, COLUMNS))
    height, width = labels.shape
    drop = elevation - position[2]
    sun = (sun_e, sun_n)
    right = (axes[0, 0], axes[1, 0], axes[2, 0])
    down = (axes[0, 1], axes[1, 1], axes[2, 1])
    ahead = (axes[0, 2], axes[1, 2], axes[2, 2])
    for i in range(height):
        for j in range(width):
            k = labels[i, j]
            if k == 0:
                continue
            ray = _line_of_sight(tan_right[i, j], tan_down[i, j], right, down, ahead)
            rim = i == 0 or j == 0 or i == height - 1 or j == width - 1
            if rim or ray[2] * drop <= 0.0 or abs(ray[2]) < 1e-3:
                out[k, BORDER] = 1.0
            else:
                rim = _borders_on(
                    k, labels[i - 1, j], labels[i + 1, j], labels[i, j - 1], labels[i, j + 1]
                )
            _count_pixel(
                out,
                k,
                tan_right[i, j],
                tan_down[i, j],
                rim,
                edge_mask[i, j] != 0,
                deep_mask[i, j] != 0,
            )
            if ray[2] * drop <= 0.0:
                continue
            depth = drop / ray[2]
            along, across = _to_sun(depth * ray[0], depth * ray[1], sun)
            _add_moments(out, k, along, across)
            if rim:
                along, across = _pixel_size_on_terrain(depth, ray, right, down, sun)
                out[k, SPAN_ALONG] += along
                out[k, SPAN_ACROSS] += across
    _sums_to_means(out)
    return out
