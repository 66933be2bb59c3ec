"""Textures of the terrain's albedo and of its scattered light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunarsim.sensors.rendering.albedo_field import albedo_field, albedo_from_camera
from lunarsim.sensors.rendering.programs import ALBEDO_MAP, GLOW, MOTTLES
from lunarsim.sensors.rendering.scattered_light import ScatteredLightMap, scattered_light_map
from lunarsim.typing import Array
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain

# Number of lights whose maps are cached.
_MAX_CACHED_LIGHTS = 4


class SurfaceTextures:
    """Textures of albedo map, albedo variation and scattered light of one terrain.

    A texture is created when an image first needs it. Scattered light is cached for the last few
    lights, albedo variation for the last one.

    Parameters
    ----------
    ctx
        OpenGL context.
    terrain
        Terrain with the relief, and with the albedo map if it has one.
    """

    def __init__(self, ctx: moderngl.Context, terrain: Terrain) -> None:
        self._ctx = ctx
        self._relief = terrain.relief
        self._albedo = terrain.albedo
        self._albedo_texture: moderngl.Texture | None = None
        self._glow: dict[Light, tuple[ScatteredLightMap, moderngl.Texture]] = {}
        self._mottles: tuple[int, moderngl.Texture] | None = None

    @property
    def has_albedo_map(self) -> bool:
        """Whether the terrain has an albedo map."""
        return self._albedo is not None

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
        if self._albedo is not None:
            g = self._albedo.grid
            side = g.posting * np.array([g.cols, g.rows])
            block["albedo_from"][:2] = 1.0 / side
            block["albedo_from"][2:] = (viewpoint[:2] - [g.x0, g.y0] + 0.5 * g.posting) / side
            if self._albedo_texture is None:
                self._albedo_texture = self._filtered_texture(self._albedo.values, "f4")
                self._albedo_texture.repeat_x = self._albedo_texture.repeat_y = False
            self._albedo_texture.use(ALBEDO_MAP)

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
            self._mottles = (seed, self._filtered_texture(albedo_field(seed), "f1"))
        return self._mottles[1]

    def _filtered_texture(self, values: NDArray[Any], dtype: str) -> moderngl.Texture:
        """Create a texture of values (rows, cols) that is averaged over pixels."""
        texture = self._ctx.texture(values.shape[::-1], 1, values.tobytes(), dtype=dtype)
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR)
        return texture
