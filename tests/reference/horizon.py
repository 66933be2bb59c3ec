"""Horizon of terrain on a sphere, by vectors from the centre of the sphere, point by point."""

import math


def elevation_angle(eye, distance, height, radius):
    """Return the elevation angle, rad, of a point at an arc length and a height above a sphere."""
    arc = distance / radius
    east = (radius + height) * math.sin(arc)
    up = (radius + height) * math.cos(arc) - (radius + eye)
    return math.atan2(up, east)


def raised(angle, heights, distances, eye, radius):
    """Return elevation angles raised to those of the terrain, and the reach of the terrain."""
    angles, reach = [], []
    for start, row in zip(angle, heights, strict=True):
        known = [(s, z) for s, z in zip(distances, row, strict=True) if not math.isnan(z)]
        angles.append(max([start, *(elevation_angle(eye, s, z, radius) for s, z in known)]))
        reach.append(known[-1][0] if known else 0.0)
    return angles, reach


def dense_horizon(height_at, azimuth, eye, radius, max_range, step):
    """Return the elevation angle, rad, of the horizon in one direction by small equal steps."""
    count = int(max_range / step)
    return max(
        elevation_angle(eye, s, height_at(s * math.sin(azimuth), s * math.cos(azimuth)), radius)
        for s in (step * (i + 1) for i in range(count))
    )
