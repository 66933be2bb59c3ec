"""Textures of the terrain's albedo variation and of its scattered light."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering.albedo_field import albedo_field, albedo_from_camera
from lunarsim.sensors.rendering.programs import GLOW, MOTTLES
from lunarsim.sensors.rendering.scattered_light import ScatteredLightMap, scattered_light_map
from lunarsim.typing import Array
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield

# Number of lights whose maps are cached.
_MAX_CACHED_LIGHTS = 4


class SurfaceTextures:
    """Textures of albedo variation and scattered light of one terrain.

    A texture is created when a light first needs it. Scattered light is cached for the last few
    lights, albedo variation for the last one.

    Parameters
    ----------
    ctx
        OpenGL context.
    relief
        Relief of the terrain.
    """

    def __init__(self, ctx: moderngl.Context, relief: Heightfield) -> None:
        self._ctx = ctx
        self._relief = relief
        self._glow: dict[Light, tuple[ScatteredLightMap, moderngl.Texture]] = {}
        self._mottles: tuple[int, moderngl.Texture] | None = None

    def use(self, light: Light, viewpoint: Array, block: NDArray[np.void]) -> None:
        """Bind the textures that a light needs, and write their coordinate transforms.

        Parameters
        ----------
        light
            Light of the image.
        viewpoint
            Position of the camera (3,), ENU, m.
        block
            Uniform block of the image, in which the transforms are written.
        """
        if light.scattered_light:
            found, texture = self._glow_of(light)
            block["glow_from"] = found.from_camera(viewpoint)
            texture.use(GLOW)
        if light.albedo_variation > 0.0:
            block["mottle_from"] = albedo_from_camera(light, viewpoint)
            self._mottles_of(light.albedo_seed).use(MOTTLES)

    def _glow_of(self, light: Light) -> tuple[ScatteredLightMap, moderngl.Texture]:
        # The scattered light does not depend on these fields.
        key = replace(light, diameter=0.0, earthshine=0.0, albedo_variation=0.0, boulder_albedo=1.0,
                      boulder_albedo_variation=0.0, albedo_seed=0, ambient=0.0)  # fmt: skip
        if key not in self._glow:
            if len(self._glow) >= _MAX_CACHED_LIGHTS:
                del self._glow[next(iter(self._glow))]
            found = scattered_light_map(self._relief, light)
            rows, cols = found.values.shape[:2]
            texture = self._ctx.texture((cols, rows), 2, found.values.tobytes(), dtype="f4")
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            texture.repeat_x = texture.repeat_y = False
            self._glow[key] = (found, texture)
        return self._glow[key]

    def _mottles_of(self, seed: int) -> moderngl.Texture:
        if self._mottles is None or self._mottles[0] != seed:
            field = albedo_field(seed)
            texture = self._ctx.texture(field.shape[::-1], 1, field.tobytes())
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR)
            self._mottles = (seed, texture)
        return self._mottles[1]
