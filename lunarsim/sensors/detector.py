"""A camera's detector: from the light that falls on it to counts."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.camera import CameraModel
from lunarsim.sensors._detector_kernels import read_out

Array = NDArray[np.float64]

# Electrons from which on Poisson's law is taken as a normal one: its skewness is then below 0.06.
_FEW = 300.0


def fall_off(camera: CameraModel, power: float) -> NDArray[np.float32]:
    """Return the share of the light that reaches each pixel (height, width).

    It falls as a power of the cosine of the angle to the boresight.
    """
    x, y = camera.tangents
    return np.asarray((1.0 + x * x + y * y) ** (-0.5 * power), np.float32)


@lru_cache(maxsize=4)
def dark_current(shape: tuple[int, int], share: float, mean: float, seed: int) -> Array:
    """Return the electrons a second that each pixel (height, width) makes without light.

    Parameters
    ----------
    shape
        Height and width.
    share, mean
        Share of the pixels that are hot, and the mean of their exponentially distributed current.
    seed
        Of their places.
    """
    height, width = shape
    rng = np.random.default_rng([seed, width, height])
    hot = rng.random(shape) < share
    return np.where(hot, rng.exponential(1.0, shape) * mean, 0.0)


def counted(
    electrons: NDArray[np.float32],
    rng: np.random.Generator,
    *,
    shot_noise: bool,
    read_noise: float,
    full_well: float,
    gain: float,
    bits: int,
) -> NDArray[np.unsignedinteger[Any]]:
    """Return the counts (height, width) of electrons, which may be overwritten; see `Camera`."""
    few = np.ones(electrons.shape, np.bool_)
    normal = np.zeros(electrons.shape, np.float32)
    if shot_noise or read_noise > 0.0:
        if shot_noise:
            # Where photons are few they are counted; where many, their noise is normal.
            few = electrons < np.float32(_FEW)
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
