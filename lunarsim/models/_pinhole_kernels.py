# mypy: allow-untyped-defs, no-check-untyped-defs
"""Pinhole projection for compiled kernels, one point or pixel at a time."""

from __future__ import annotations

from lunarsim._jit import kernel


@kernel(inline=True)
def to_pixel(x, y, z, fx, fy, cx, cy):
    """Project a point (x, y, z) in sensor coordinates to a pixel (u, v).

    `fx`, `fy` are the focal lengths and `cx`, `cy` the principal point, pixels; z must not be 0.
    """
    return fx * x / z + cx, fy * y / z + cy


@kernel(inline=True)
def to_tangents(u, v, fx, fy, cx, cy):
    """Return the tangents of a pixel's line of sight, x / z (right) and y / z (down).

    `u`, `v` is the pixel, `fx`, `fy` are the focal lengths and `cx`, `cy` the principal point.
    """
    return (u - cx) / fx, (v - cy) / fy
