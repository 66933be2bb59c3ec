"""Camera detector: conversion of incident light to counts."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.camera import CameraModel
from lunarsim.sensors._detector_kernels import read_out
from lunarsim.typing import Array

# Above this number of electrons the Poisson distribution is approximated by a normal one: its
# skewness is then below 0.06.
_MIN_NORMAL_ELECTRONS = 300.0


def illumination_falloff(camera: CameraModel, power: float) -> NDArray[np.float32]:
    """Return the relative illumination (height, width) of an image with vignetting.

    The illumination is the cosine of the angle to the boresight to the power `power`.
    """
    x, y = camera.tangents
    return np.asarray((1.0 + x * x + y * y) ** (-0.5 * power), np.float32)


@lru_cache(maxsize=4)
def dark_current(
    shape: tuple[int, int], hot_fraction: float, mean_current: float, seed: int
) -> Array:
    """Sample the dark current (height, width), electrons/s, of a detector's pixels.

    Parameters
    ----------
    shape
        Height and width, pixels.
    hot_fraction, mean_current
        Fraction of hot pixels, and the mean of their exponentially distributed dark current,
        electrons per second.
    seed
        Seed of the hot pixels.
    """
    height, width = shape
    rng = np.random.default_rng([seed, width, height])
    hot = rng.random(shape) < hot_fraction
    return np.where(hot, rng.exponential(1.0, shape) * mean_current, 0.0)


def counts_from_electrons(
    electrons: NDArray[np.float32],
    rng: np.random.Generator,
    *,
    shot_noise: bool,
    read_noise: float,
    full_well: float,
    gain: float,
    bits: int,
) -> NDArray[np.unsignedinteger[Any]]:
    """Convert electrons (height, width) to counts: noise, saturation, quantization.

    `electrons` is overwritten. `shot_noise` is whether photon noise is added, `read_noise` the
    standard deviation of the read noise, electrons, and `full_well` the saturation, electrons. Full
    scale of the converter, which has `bits` bits, is `full_well` over `gain`.
    """
    few = np.ones(electrons.shape, np.bool_)
    normal = np.zeros(electrons.shape, np.float32)
    if shot_noise or read_noise > 0.0:
        if shot_noise:
            # Poisson for few electrons; the kernel adds normal noise for many.
            few = electrons < np.float32(_MIN_NORMAL_ELECTRONS)
            electrons[few] = rng.poisson(electrons[few])
        rng.standard_normal(dtype=np.float32, out=normal)
    top = 2**bits - 1
    counts = np.empty(electrons.shape, np.uint8 if bits <= 8 else np.uint16)
    read_out(
        counts, electrons, normal, few, np.float32(read_noise**2),
        np.float32(full_well if gain < 1.0 else np.inf), np.float32(gain * top / full_well),
        np.float32(top),
    )  # fmt: skip
    return counts
