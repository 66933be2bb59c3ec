"""Analytic terrain beyond a map: a plane or sphere with one cone on it."""

import math

import numpy as np


class Cone:
    """Cone of a height and base radius, m, at (x, y), m, on the plane z = 0."""

    def __init__(self, x, y, height, base):
        self.x, self.y, self.height, self.base = x, y, height, base

    def z(self, x, y):
        """Return its height at points."""
        away = np.hypot(np.asarray(x) - self.x, np.asarray(y) - self.y)
        return np.maximum(self.height * (1.0 - away / self.base), 0.0)

    def hit(self, origin, ray):
        """Return the range of the first hit of a ray on cone or plane, or NaN.

        The cone is z = H (1 - d / B): (H - z)^2 B^2 = H^2 d^2 with 0 <= z <= H.
        """
        (px, py, pz), (dx, dy, dz) = origin, ray
        qx, qy, k = px - self.x, py - self.y, (self.base / self.height) ** 2
        w = self.height - pz
        a = dx * dx + dy * dy - k * dz * dz
        b = 2.0 * (qx * dx + qy * dy + k * w * dz)
        c = qx * qx + qy * qy - k * w * w
        found = [-pz / dz] if dz < 0.0 else []
        root = b * b - 4.0 * a * c
        if root >= 0.0 and a != 0.0:
            both = [(-b + s * math.sqrt(root)) / (2.0 * a) for s in (-1.0, 1.0)]
            found += [t for t in both if 0.0 <= pz + t * dz <= self.height]
        return min((t for t in found if t > 0.0), default=math.nan)

    def visible(self, point, azimuth, elevation, diameter, rays=60):
        """Return the fraction of the Sun's disc that is visible, from rays over the disc."""
        side = (np.arange(rays) + 0.5) / rays * 2.0 - 1.0
        lit = total = 0
        for u in side:
            for v in side:
                if u * u + v * v > 1.0:
                    continue
                az = azimuth + 0.5 * diameter * u / math.cos(elevation)
                el = elevation + 0.5 * diameter * v
                ray = (math.cos(el) * math.sin(az), math.cos(el) * math.cos(az), math.sin(el))
                total += 1
                lit += math.isnan(self.hit(point, ray))
        return lit / total


def sphere_range(height, angle, radius):
    """Return the range from a height to a sphere along a beam at an angle from the vertical."""
    r = radius + height
    return r * math.cos(angle) - math.sqrt(radius**2 - (r * math.sin(angle)) ** 2)
