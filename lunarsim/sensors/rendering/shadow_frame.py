"""Area and resolution of a shadow map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering.relief_tiles import TileChoice
from lunarsim.typing import Array, BoolArray

# Resolution of the shadow map over that of a pixel on the terrain.
_DETAIL = 1.5
_MAX_SIDE_TEXELS = 4096
_MAX_AREA_TEXELS = 6_000_000
# A point within this many texels behind a face turned away from the Sun is in shadow, so that no
# light leaks in at the foot of a rock.
_OVERHANG_TEXELS = 0.6


@dataclass(frozen=True)
class ShadowFrame:
    """Geometry of a shadow map: area, axes, resolution and range of heights.

    A ray from the Sun is identified by its intersection with the horizontal plane of the camera, in
    axes along and across the Sun's azimuth.

    Attributes
    ----------
    lean
        Horizontal displacement of a ray per metre of height (2,), ENU.
    axes
        Transform from ENU to the map's axes, along and across (2, 2).
    corner
        Corner of the map in its axes, relative to the camera (2,), m.
    texel
        Side of a texel, m.
    size
        Texels along and across.
    heights
        Maximum and minimum elevation in the map, relative to the camera, m.
    slack
        Minimum height of an occluder above a point that it shadows, m.
    """

    lean: Array
    axes: Array
    corner: Array
    texel: float
    size: tuple[int, int]
    heights: tuple[float, float]
    slack: float

    @classmethod
    def of(
        cls,
        view: View,
        sun: Array,
        choice: TileChoice,
        top: float,
        lowest: float,
        tallest_rock: float,
    ) -> ShadowFrame:
        """Return the geometry of a shadow map that contains everything a view shows.

        Parameters
        ----------
        view
            Camera view of the image.
        sun
            Unit vector to the Sun (3,), ENU, above the horizon.
        choice
            Tiles of the relief in the view.
        top, lowest
            Maximum and minimum elevation of everything drawn, m.
        tallest_rock
            Height of the tallest rock, m.
        """
        horizontal = float(np.hypot(sun[0], sun[1]))
        lean = sun[:2] / sun[2]
        along = sun[:2] / horizontal if horizontal > 1e-9 else np.array([1.0, 0.0])
        axes = np.array([along, [-along[1], along[0]]])
        corner, extent = _extent(view, choice, lean, axes, tallest_rock)
        distance = max(choice.nearest, 1e-3)
        texel = distance / max(view.fx, view.fy) / _DETAIL
        texel = float(
            max(texel, extent.max() / _MAX_SIDE_TEXELS, np.sqrt(np.prod(extent) / _MAX_AREA_TEXELS))
        )
        wide, high = np.minimum(np.ceil(extent / texel).astype(int).clip(1), _MAX_SIDE_TEXELS)
        slack = -_OVERHANG_TEXELS * texel * min(sun[2] / max(horizontal, 1e-9), 2.0)
        return cls(
            lean, axes, corner, texel, (int(wide), int(high)),
            (top - view.position[2] + 1.0, lowest - view.position[2] - 1.0), slack,
        )  # fmt: skip

    def shades(self, corners: Array, viewpoint: Array) -> BoolArray:
        """Return which boxes may cast a shadow onto the area of the map (n,).

        `corners` (n, 8, 3) are the corners of the boxes and `viewpoint` (3,) is the camera, ENU, m.
        """
        place = corners - viewpoint
        place = (place[..., :2] - place[..., 2:] * self.lean) @ self.axes.T
        high_corner = self.corner + self.texel * np.array(self.size)
        return np.asarray(
            (place.max(1) >= self.corner).all(1) & (place.min(1) <= high_corner).all(1)
        )

    def texels_of(self, points: Array) -> Array:
        """Return the map positions (..., 2), texels, of points relative to the camera."""
        place = (points[..., :2] - points[..., 2:] * self.lean) @ self.axes.T
        return np.asarray((place - self.corner) / self.texel)

    def to_texels(self) -> Array:
        """Return the affine transform (2, 4) from metres relative to the camera to texels."""
        turn = self.axes / self.texel
        return np.column_stack((turn, -turn @ self.lean, -self.corner / self.texel))

    def matrix(self) -> Array:
        """Return the matrix (4, 4) from metres relative to the camera to clip coordinates."""
        out = np.zeros((4, 4))
        out[:2] = 2.0 * self.to_texels() / np.array(self.size)[:, None]
        out[:2, 3] -= 1.0
        high, low = self.heights
        out[2, 2] = -2.0 / (high - low)
        out[2, 3] = 2.0 * high / (high - low) - 1.0
        out[3, 3] = 1.0
        return out


def _extent(
    view: View, choice: TileChoice, lean: Array, axes: Array, tallest_rock: float
) -> tuple[Array, Array]:
    """Return corner (2,) and extent (2,) of the shadow map, m, in its axes.

    `choice` are the visible tiles, `lean` and `axes` are those of `ShadowFrame`, and `tallest_rock`
    is the height of the tallest rock, m.

    The map contains everything visible: the part of the view's pyramid between the minimum and
    maximum elevation of the tiles in view, and within these tiles.
    """
    low, high = choice.low, choice.high + np.array([0.0, 0.0, tallest_rock])
    u, v = view.border_tangents[:2], view.border_tangents[2:]
    border = np.array([[a, b, 1.0] for a in u for b in v]) @ view.axes.T
    # Rays that descend beyond the tiles, or not at all, end far beyond the tiles but at the same
    # elevation: shorter rays would exclude terrain below them.
    reach = 3.0 * np.linalg.norm(np.maximum(high - view.position, view.position - low)[:2])
    seen = []
    for ray in border:
        run = np.hypot(ray[0], ray[1])
        for level in (low[2], high[2]):
            drop = level - view.position[2]
            t = drop / ray[2] if ray[2] * drop > 0.0 else np.inf
            t = min(t, reach / max(run, 1e-9))
            seen.append([t * ray[0], t * ray[1], drop])
    box = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                    for z in (low[2], high[2])]) - view.position  # fmt: skip
    in_view, in_box = (
        (points[:, :2] - points[:, 2:] * lean) @ axes.T for points in (np.array(seen), box)
    )
    low_corner = np.maximum(in_view.min(0), in_box.min(0))
    high_corner = np.minimum(in_view.max(0), in_box.max(0))
    margin = 0.01 * np.maximum(high_corner - low_corner, 0.0) + 1e-3
    return low_corner - margin, np.maximum(high_corner - low_corner, 0.0) + 2.0 * margin
