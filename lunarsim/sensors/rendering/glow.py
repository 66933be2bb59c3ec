"""`glow_map`: how much light each place of a relief gets from the lit ground that it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.sensors.rendering import _glow_kernels as kernels
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield

Array = NDArray[np.float64]

# At most so many posts along a side: light from about changes slowly.
_SIDE = 192
_AZIMUTHS = 16
_GROWTH = 1.2


@dataclass(frozen=True)
class GlowMap:
    """Light thrown on a relief by itself, once.

    Attributes
    ----------
    corner
        Place of the first value (2,), ENU, m.
    posting
        Distance of values, m.
    values
        Irradiance over the Sun's, and the mean I/F of the ground about (rows, cols, 2), float32.
    """

    corner: Array
    posting: float
    values: NDArray[np.float32]

    def from_camera(self, eye: Array) -> Array:
        """Return scale and offset (4,) from metres about the camera to the texture."""
        rows, cols = self.values.shape[:2]
        size = np.array([cols, rows])
        posts = (eye[:2] - self.corner) / self.posting
        return np.concatenate((1.0 / (self.posting * size), (posts + 0.5) / size))


def glow_map(relief: Heightfield, light: Light) -> GlowMap:
    """Return the light that a relief throws on itself.

    Each place shines with the hemispherical albedo at its angle of incidence, the same in all
    directions; it is lit by the middle of the Sun. Rocks take part in receiving only.

    Parameters
    ----------
    relief
        The relief; what is unknown of it counts as level with the lowest known.
    light
        The Sun and the law of reflection.
    """
    step = max(1, -(-max(relief.z.shape) // _SIDE))
    z = relief.z[::step, ::step].astype(np.float64)
    z = np.where(np.isfinite(z), z, np.nanmin(relief.z))
    posting = step * relief.grid.posting
    shine = np.zeros(z.shape)
    values = np.zeros((*z.shape, 2), np.float32)
    sun = light.direction
    if sun[2] > 0.0 and min(z.shape) > 1:
        north, east = np.gradient(z, posting)
        cosine = (sun[2] - east * sun[0] - north * sun[1]) / np.sqrt(1.0 + east**2 + north**2)
        lit = kernels.lit_posts(z, posting, sun)
        cosine = np.where(lit, np.maximum(cosine, 0.0), 0.0)
        shine = cosine * light.hemispheric_albedo(cosine)
        slope = np.stack((east, north), axis=-1)
        values[..., 0] = kernels.gathered(z, slope, posting, shine, _AZIMUTHS, _GROWTH)
        # The filter's running sums leave some -1e-17 behind where nothing shines.
        values[..., 1] = np.maximum(ndimage.uniform_filter(shine, 5, mode="nearest"), 0.0)
    corner = np.array([relief.grid.x0, relief.grid.y0])
    return GlowMap(corner, posting, values)
