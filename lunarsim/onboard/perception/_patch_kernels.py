"""Compiled measuring of dark patches: one pass over the labelled pixels of an image."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel

# Columns of the table of patches.
ALONG, ACROSS, LENGTH, WIDTH, PIXELS, EDGE, SEEN, BORDER, TX, TY, SPAN_ALONG, SPAN_ACROSS = range(
    12
)
COLUMNS = 12


@kernel()
def measure_patches(labels, count, edges, x, y, position, axes, ground, sun_e, sun_n):
    """Measure the patches of a label image on a level plane.

    Parameters
    ----------
    labels
        Patch of each pixel (height, width), 0 for none.
    count
        Greatest label.
    edges
        Where the image has an edge (height, width), uint8.
    x, y
        Tangents of the line of sight of each pixel, right and down (height, width).
    position, axes
        Of the camera, as `View` has them.
    ground
        Elevation of the plane, m.
    sun_e, sun_n
        Horizontal unit vector towards the Sun.

    Returns
    -------
    out
        (count + 1, 12): mean coordinate towards the Sun and to the left of it from below the
        camera, m; length and width of the rectangle with the same variances, m; pixels; pixels
        at the rim and how many of these lie on an edge of the image; whether the patch touches
        the border or the horizon; mean tangents; size of a pixel along the Sun and across at the
        patch, m.
    """
    out = np.zeros((count + 1, COLUMNS))
    height, width = labels.shape
    drop = ground - position[2]
    for i in range(height):
        for j in range(width):
            k = labels[i, j]
            if k == 0:
                continue
            tx = x[i, j]
            ty = y[i, j]
            dz = axes[2, 0] * tx + axes[2, 1] * ty + axes[2, 2]
            rim = i == 0 or j == 0 or i == height - 1 or j == width - 1
            if rim or dz * drop <= 0.0 or abs(dz) < 1e-3:
                out[k, BORDER] = 1.0
            else:
                rim = (
                    labels[i - 1, j] != k
                    or labels[i + 1, j] != k
                    or labels[i, j - 1] != k
                    or labels[i, j + 1] != k
                )
            out[k, PIXELS] += 1.0
            out[k, TX] += tx
            out[k, TY] += ty
            if rim:
                out[k, EDGE] += 1.0
                if edges[i, j] != 0:
                    out[k, SEEN] += 1.0
            if dz * drop <= 0.0:
                continue
            depth = drop / dz
            de = axes[0, 0] * tx + axes[0, 1] * ty + axes[0, 2]
            dn = axes[1, 0] * tx + axes[1, 1] * ty + axes[1, 2]
            e = depth * de
            n = depth * dn
            along = e * sun_e + n * sun_n
            across = n * sun_e - e * sun_n
            out[k, ALONG] += along
            out[k, ACROSS] += across
            out[k, LENGTH] += along * along
            out[k, WIDTH] += across * across
            if not rim:
                continue
            # How far the point on the ground moves along and across for a pixel right and down;
            # the scale 1 / f is applied by the caller.
            ue = depth * (axes[0, 0] - de * axes[2, 0] / dz)
            un = depth * (axes[1, 0] - dn * axes[2, 0] / dz)
            ve = depth * (axes[0, 1] - de * axes[2, 1] / dz)
            vn = depth * (axes[1, 1] - dn * axes[2, 1] / dz)
            out[k, SPAN_ALONG] += np.hypot(ue * sun_e + un * sun_n, ve * sun_e + vn * sun_n)
            out[k, SPAN_ACROSS] += np.hypot(un * sun_e - ue * sun_n, vn * sun_e - ve * sun_n)
    for k in range(1, count + 1):
        pixels = max(out[k, PIXELS], 1.0)
        out[k, TX] /= pixels
        out[k, TY] /= pixels
        for mean, size in ((ALONG, LENGTH), (ACROSS, WIDTH)):
            out[k, mean] /= pixels
            variance = out[k, size] / pixels - out[k, mean] ** 2
            out[k, size] = np.sqrt(12.0 * max(variance, 0.0))
        rims = max(out[k, EDGE], 1.0)
        out[k, SPAN_ALONG] /= rims
        out[k, SPAN_ACROSS] /= rims
    return out
