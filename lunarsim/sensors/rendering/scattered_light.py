"""Irradiance of a relief by the sunlit terrain around each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.sensors.rendering import _scattered_light_kernels as kernels
from lunarsim.typing import Array
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield

# Maximum number of grid points along a side: scattered light varies slowly.
_MAX_POSTS_PER_SIDE = 192
_AZIMUTHS = 16
_DISTANCE_FACTOR = 1.2


@dataclass(frozen=True)
class ScatteredLightMap:
    """Map of the irradiance of a relief by sunlight scattered once from the terrain.

    Attributes
    ----------
    corner
        Position of the first value (2,), ENU, m.
    posting
        Distance between values, m.
    values
        Irradiance relative to that of the Sun, and mean radiance factor I/F of the surrounding
        terrain (rows, cols, 2), float32.
    """

    corner: Array
    posting: float
    values: NDArray[np.float32]

    def from_camera(self, viewpoint: Array) -> Array:
        """Return the transform from metres relative to the camera to the map's texture.

        The values (4,) are the scale in x and y, 1/m, and the offset in x and y, texture widths.
        """
        rows, cols = self.values.shape[:2]
        size = np.array([cols, rows])
        posts = (viewpoint[:2] - self.corner) / self.posting
        return np.concatenate((1.0 / (self.posting * size), (posts + 0.5) / size))


def scattered_light_map(relief: Heightfield, light: Light) -> ScatteredLightMap:
    """Compute the irradiance of a relief by sunlight scattered from the terrain.

    Terrain reflects equally in all directions, with the hemispherical albedo at its angle of
    incidence, and is lit by a point Sun. Rocks receive scattered light but do not reflect it.

    Parameters
    ----------
    relief
        Relief; no-data counts as terrain at the minimum elevation.
    light
        Sun and photometry.
    """
    step = max(1, -(-max(relief.z.shape) // _MAX_POSTS_PER_SIDE))
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
        values[..., 0] = kernels.scattered_irradiance(
            z, slope, posting, shine, _AZIMUTHS, _DISTANCE_FACTOR
        )
        # The filter's running sums leave values of about -1e-17 in dark areas.
        values[..., 1] = np.maximum(ndimage.uniform_filter(shine, 5, mode="nearest"), 0.0)
    corner = np.array([relief.grid.x0, relief.grid.y0])
    return ScatteredLightMap(corner, posting, values)
