"""A plain crater that wears away: the heat equation on a square of posts, by its spectrum."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RectBivariateSpline


def worn(x: np.ndarray, y: np.ndarray, radius: float, depth: float, age: float) -> np.ndarray:
    """Return elevations at places from the middle, m.

    Parameters
    ----------
    x, y
        m (n,).
    radius, depth
        Of the new crater; depth from rim to floor, m.
    age
        kappa t / radius^2.
    """
    side, step = 16.0, 1.0 / 32.0  # crater radii
    axis = np.arange(-side / 2, side / 2, step)
    u, v = np.meshgrid(axis, axis)
    r = np.sqrt(u * u + v * v)
    # A rim of 0.036 of the diameter where the depth is 0.2 of it, and an apron to three radii.
    rim = 0.036 / 0.2
    fade = np.where(r < 3.0, 1.0 - (np.clip(r, 1.0, 3.0) - 1.0) / 2.0, 0.0)
    apron = rim / np.maximum(r, 1.0) ** 3 * (3.0 * fade**2 - 2.0 * fade**3)
    z = np.where(r < 1.0, rim - (1.0 - r**2), apron)
    k = 2.0 * np.pi * np.fft.fftfreq(axis.size, step)
    decay = np.exp(-age * (k[:, None] ** 2 + k[None, :] ** 2))
    z = np.fft.ifft2(np.fft.fft2(z) * decay).real
    u, v = x / radius, y / radius
    within = (np.maximum(np.abs(u), np.abs(v)) <= axis[-1]) & (np.minimum(u, v) >= axis[0])
    return np.where(within, RectBivariateSpline(axis, axis, depth * z).ev(v, u), 0.0)
