"""Optical depth of a sheet of dust by integration of its extinction along a ray."""

import numpy as np


def optical_depth(vertical, core_radius, angle, origin, ray, steps=200_000):
    """Integrate the extinction from `origin` to the plane z = 0 along a descending `ray`.

    The extinction at the distance r from the axis and at the height z is
    ``d(r) / h(r) exp(-z / h(r))`` with the vertical optical depth d and the scale height h.
    """
    length = -origin[2] / ray[2]
    s = (np.arange(steps) + 0.5) * length / steps
    x, y, z = (origin[k] + s * ray[k] for k in range(3))
    r = np.hypot(x, y)
    d = vertical / np.sqrt(1.0 + (r / core_radius) ** 2)
    h = np.tan(angle) * np.sqrt(core_radius**2 + r**2)
    return float(np.sum(d / h * np.exp(-z / h)) * length / steps)
