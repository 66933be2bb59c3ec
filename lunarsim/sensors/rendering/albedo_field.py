"""Albedo variation: a random field on the terrain, and a factor for every rock."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering.shading_model import ALBEDO_FIELD_RANGE
from lunarsim.typing import Array
from lunarsim.world.light import Light

_SIDE = 1024
# Texels per correlation length.
_DETAIL = 8


@lru_cache(maxsize=4)
def albedo_field(seed: int) -> NDArray[np.uint8]:
    """Generate the albedo variation: a periodic random field (1024, 1024), uint8.

    Its correlation is exponential, with a correlation length of 8 elements. Values are normal with
    mean 128 and standard deviation 255 / 8, limited to four deviations.
    """
    rng = np.random.default_rng([seed, 0])
    k = 2.0 * np.pi * np.fft.fftfreq(_SIDE)
    power = (1.0 + _DETAIL**2 * (k[:, None] ** 2 + k[: _SIDE // 2 + 1] ** 2)) ** -1.5
    power[0, 0] = 0.0
    noise = np.fft.rfft2(rng.standard_normal((_SIDE, _SIDE)))
    field = np.fft.irfft2(noise * np.sqrt(power), (_SIDE, _SIDE))
    field *= 255.0 / (2.0 * ALBEDO_FIELD_RANGE * field.std())
    return np.clip(np.rint(128.0 + field), 0, 255).astype(np.uint8)


def albedo_from_camera(light: Light, viewpoint: Array) -> Array:
    """Return the transform from metres relative to the camera to the albedo texture.

    The values (4,) are the scale in x and y, 1/m, and the offset in x and y, texture widths.
    """
    scale = _DETAIL / (light.albedo_correlation_length * _SIDE)
    return np.array([scale, scale, *((viewpoint[:2] * scale) % 1.0)])


def rock_albedos(light: Light, count: int) -> Array:
    """Sample the albedo of every rock (count,), relative to the mean of the terrain.

    The albedo is log-normal with mean `boulder_albedo`; the value of rock i does not depend on
    `count`.
    """
    spread = np.sqrt(np.log1p(light.boulder_albedo_variation**2))
    normal = np.random.default_rng([light.albedo_seed, 1]).standard_normal(count)
    return np.asarray(light.boulder_albedo * np.exp(spread * normal - 0.5 * spread**2))
