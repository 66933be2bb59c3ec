"""Pictures, and what cameras, links and beliefs do to them."""

from __future__ import annotations

import cv2
import numpy as np

from lunarsim.grid import Grid
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief, place_rocks


def rocky(seed, cover, slope_deg, shape="mixed"):
    """Relief 600 m wide with rocks by Golombek's law within 45 m of its middle."""
    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), 600.0, 6.0)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(slope_deg))
    low, high = np.searchsorted(grid.x, [-45.0, 45.0])
    inner = Grid(grid.x[low], grid.y[low], 6.0, high - low, high - low)
    middle = Heightfield(inner, np.ascontiguousarray(relief.z[low:high, low:high]))
    diameters = sample_diameters(90.0**2, cover, 0.25, 3.0, rng)
    return Terrain(relief, place_rocks(middle, diameters, rng, model=RockModel(shape)))


def defocused(counts, rng, sigma=2.0):
    """A picture through optics that are out of focus; the detector's noise comes after them."""
    soft = cv2.GaussianBlur(counts.astype(np.float32), (0, 0), sigma)
    return _read(soft, rng)


def smeared(counts, rng, length=12.0):
    """A picture with an image that moved in some direction while the shutter was open."""
    angle = rng.uniform(0.0, np.pi)
    half = int(np.ceil(length))
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for t in np.linspace(-0.5, 0.5, 100) * length:
        kernel[half + round(t * np.sin(angle)), half + round(t * np.cos(angle))] += 0.01
    return _read(cv2.filter2D(counts.astype(np.float32), -1, kernel), rng)


def noisy(counts, rng, share=0.2):
    """A picture under noise of a share of its brightness."""
    grey = counts.astype(float)
    return _read(grey + share * np.median(grey) * rng.standard_normal(grey.shape), rng)


def halved(counts, rng, value, sprinkled=0.0):
    """A picture of which one half, of four, never came; a share of its pixels is a count off."""
    out = counts.copy()
    rows, cols = out.shape
    halves = (np.s_[rows // 2 :], np.s_[: rows // 2], np.s_[:, cols // 2 :], np.s_[:, : cols // 2])
    half = halves[rng.integers(4)]
    out[half] = value
    out[half] += (rng.random(out[half].shape) < sprinkled).astype(out.dtype)
    return out


def _read(grey, rng):
    return np.rint(grey + 0.6 * rng.standard_normal(grey.shape)).clip(0, 255).astype(np.uint8)


def all_faults(counts, rng):
    """Name and picture of everything that can go wrong with one picture by itself."""
    shape = counts.shape
    stripes = counts.copy()
    stripes[100:130] = stripes[100]
    floats = counts.astype(float)
    return {
        "black": np.zeros(shape, np.uint8),
        "white": np.full(shape, 255, np.uint8),
        "black with read noise": (rng.random(shape) < 0.02).astype(np.uint8),
        "grey": np.full(shape, 90, np.uint8),
        "grey with shot noise": _read(np.full(shape, 90.0) + rng.standard_normal(shape), rng),
        "no numbers": np.full(shape, np.nan),
        "half no numbers": halved(floats, rng, np.nan),
        "noise": rng.integers(0, 256, shape).astype(np.uint8),
        "normal noise": _read(120.0 + 15.0 * rng.standard_normal(shape), rng),
        "soft noise": _read(120.0 + 400.0 * cv2.GaussianBlur(
            rng.standard_normal(shape), (0, 0), 2.5), rng),
        "picture under noise": noisy(counts, rng),
        "far too dark": (0.05 * counts).astype(np.uint8),
        "overexposed": np.clip(350.0 / np.median(counts) * floats, 0, 255).astype(np.uint8),
        "defocus": defocused(counts, rng),
        "strong defocus": defocused(counts, rng, 4.0),
        "smear": smeared(counts, rng, 20.0),  # of 12 pixels, one in about a hundred passes
        "half black": halved(counts, rng, 0),
        "half black with read noise": halved(counts, rng, 0, 0.05),
        "half white": halved(counts, rng, 255),
        "half grey": halved(counts, rng, 70),
        "repeated rows": stripes,
        "wrong size": counts[:-1],
        "colour": np.dstack((counts,) * 3),
        "words": counts.astype(str),
        "complex": counts.astype(complex),
        "true or false": counts > 60,
    }  # fmt: skip
