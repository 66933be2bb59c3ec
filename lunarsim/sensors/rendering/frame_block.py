"""Parameters of an image for the shaders, in one uniform block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.world.light import Light

# Layout of frame.glsl; pairs fill complete groups of four floats, as std140 requires.
FRAME = np.dtype(
    [
        ("axes", "(3,4)f4"),
        ("intrinsics", "4f4"),
        ("image", "2f4"),
        ("clip", "2f4"),
        ("eye", "4f4"),
        ("sunlight", "4f4"),
        ("surface", "4f4"),
        ("cells", "2f4"),
        ("eye_cell", "2f4"),
        ("eye_in_cell", "2f4"),
        ("lean", "2f4"),
        ("to_map", "(2,4)f4"),
        ("map_size", "2f4"),
        ("map_texel", "2f4"),
        ("map_dark", "2f4"),
        ("heights", "2f4"),
        ("from_map", "(2,2)f4"),
        ("map_corner", "2f4"),
        ("_", "2f4"),
        ("penumbra", "4f4"),
        ("glow_from", "4f4"),
        ("mottle_from", "4f4"),
        ("albedo_from", "4f4"),
    ]
)


def frame_block(
    view: View, clip: tuple[float, float], light: Light, grid: Grid, cells: tuple[int, int],
    datum: float, frame: ShadowFrame | None, texture: tuple[int, int],
) -> NDArray[np.void]:  # fmt: skip
    """Return the parameters of an image for the shaders, as an OpenGL uniform block.

    Parameters
    ----------
    view, clip
        Camera, and its minimum and maximum depth, m.
    light
        Light and photometry.
    grid
        Grid of the relief.
    cells
        Columns and rows of cells in the relief's texture.
    datum
        Elevation that is zero in that texture, m.
    frame, texture
        Shadow map (None: no shadows), and the size of its texture, texels.
    """
    block = np.zeros((), FRAME)
    block["axes"][:, :3] = view.axes.T
    block["intrinsics"] = view.fx, view.fy, view.cx, view.cy
    block["image"] = view.width, view.height
    block["clip"] = clip
    block["eye"][:3] = view.position
    block["eye"][3] = view.position[2] - datum
    sun = light.direction
    if sun[2] > 0.0:
        block["sunlight"][:3] = sun
    mcewen = float(light.photometry == "lunar-lambert")
    block["surface"] = light.albedo, light.albedo * light.ambient, mcewen, 1.0 / grid.posting
    posts = (view.position[:2] - np.array([grid.x0, grid.y0])) / grid.posting
    cell = np.floor(posts)
    block["cells"] = cells
    block["eye_cell"] = cell
    block["eye_in_cell"] = posts - cell
    if frame is None:
        block["map_dark"] = -1e30, 0.0  # below every depth in the map
        return block
    block["lean"] = frame.lean
    block["to_map"] = frame.to_texels()
    block["map_size"] = frame.size
    block["map_texel"] = 1.0 / texture[0], 1.0 / texture[1]
    high, low = frame.heights
    block["map_dark"] = (high - frame.slack) / (high - low), -1.0 / (high - low)
    block["heights"] = frame.heights
    block["from_map"] = frame.axes * frame.texel  # rows are the columns of the inverse transform
    block["map_corner"] = frame.axes.T @ frame.corner
    return block
