"""Penumbrae: the Sun's disc in the shadow map, and bounds of the texels."""

from __future__ import annotations

import moderngl
import numpy as np

from lunarsim.sensors.rendering.programs import BLOCK, BOUNDS, SHADOW, disable_filtering
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.sensors.rendering.target import ShadowMap
from lunarsim.typing import Array

# Maximum search distance for an edge, blocks of the shadow map.
_MAX_SEARCH_BLOCKS = 128


def sun_disc_axes(frame: ShadowFrame, sun: Array, diameter: float) -> Array:
    """Return half the width of penumbrae in a shadow map, per height of the occluder.

    The values (2,), texels per metre, are those along the Sun's azimuth and across. The height is
    that of the occluder above the shaded point; `sun` (3,) is the unit vector to the Sun, and
    `diameter` its apparent diameter, rad. An occluder at height h over a point hides parts of the
    disc within h tan(r) / sin(e)^2 along the azimuth, and h tan(r) / sin(e) across, with the radius
    r of the disc and the elevation e of the Sun; to first order in r.
    """
    radius = np.tan(0.5 * diameter)
    sine = max(float(sun[2]), float(radius))
    return np.asarray(radius / frame.texel * np.array([1.0 / sine**2, 1.0 / sine]))


class PenumbraBounds:
    """Minimum and maximum depth of a shadow map around each of its blocks.

    The bounds identify blocks that are completely lit or completely in shadow.

    Parameters
    ----------
    ctx
        OpenGL context.
    programs
        Programs of the context.
    shadow
        Shadow map.
    """

    def __init__(
        self, ctx: moderngl.Context, programs: dict[str, moderngl.Program], shadow: ShadowMap
    ) -> None:
        self._shadow = shadow
        size = (-(-shadow.texture.width // BLOCK), -(-shadow.texture.height // BLOCK))
        self.size = size
        self._textures = [ctx.texture(size, 4, dtype="f4") for _ in range(2)]
        for texture in self._textures:
            disable_filtering(texture)
        self._buffers = [ctx.framebuffer([texture]) for texture in self._textures]
        self._programs = programs
        self._screens = {
            name: ctx.vertex_array(programs[name], []) for name in ("bounds", "spread")
        }

    def draw(self, frame: ShadowFrame, axes: Array, half_width: float) -> None:
        """Compute minimum and maximum depth around each block of a drawn shadow map.

        Parameters
        ----------
        frame
            Frame of the map.
        axes
            Half axes of the Sun's disc per unit of depth (2,), texels.
        half_width
            Maximum half width of a penumbra, texels.
        """
        last = [-(-n // BLOCK) - 1 for n in frame.size]
        far = int(min(np.ceil(half_width / BLOCK) + 1, _MAX_SEARCH_BLOCKS))
        self._shadow.texture.use(SHADOW)
        self._programs["bounds"]["last"] = (frame.size[0] - 1, frame.size[1] - 1)
        self._pass("bounds", 0, last)
        for k, way in enumerate(((far, 0), (0, far))):
            self._textures[k].use(BOUNDS)
            self._programs["spread"]["spread"] = (*last, *way)
            # The sum over both axes is then at most the true distance.
            self._programs["spread"]["growth"] = BLOCK / float(axes[k]) / np.sqrt(2.0)
            self._pass("spread", 1 - k, last)
        self._textures[0].use(BOUNDS)

    def _pass(self, name: str, target: int, last: list[int]) -> None:
        buffer = self._buffers[target]
        buffer.use()
        buffer.viewport = (0, 0, last[0] + 1, last[1] + 1)
        self._screens[name].render(moderngl.TRIANGLES, vertices=3)
