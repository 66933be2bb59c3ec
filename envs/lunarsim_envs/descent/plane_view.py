"""Render a descent in the vertical plane through start and target, with gauges."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_rotate
from lunarsim.typing import Array
from lunarsim_envs.descent.batch import FLYING, DescentBatch

Image = NDArray[np.uint8]

# Side of the square view and width of the gauges to its right, pixels.
SIDE, ASIDE = 440, 200
_SKY, _GROUND, _LINE = (16, 18, 24), (96, 92, 86), (190, 184, 172)
_BODY, _FLAME, _PATH, _AIM = (222, 222, 226), (255, 170, 60), (86, 180, 233), (0, 200, 130)
_WORDS, _DIM = (235, 235, 235), (70, 74, 84)
# Minimum extent of the view, m; extent over the remaining distance; minimum lander width, pixels.
_NEAREST, _ROOM, _LEAST = 24.0, 1.3, 26.0
# Underside and top of the body above the pad plane, and its half width, in leg radii.
_UNDER, _TOP, _HALF = 0.25, 1.1, 0.55


class PlaneView:
    """Draw one lander of a batch, its path and gauges, in a vertical plane.

    Parameters
    ----------
    lanes, lane
        Batch of landers, and index of the lander to draw.
    """

    def __init__(self, lanes: DescentBatch, lane: int = 0) -> None:
        self._lanes, self._lane = lanes, lane
        self._path: list[Array] = []
        self._along = np.array([1.0, 0.0])

    def begin(self) -> None:
        """Start the drawn path of a flight in the plane of lander and target."""
        away = (self._lanes.y[self._lane, :2] - self._lanes.target[self._lane, :2]).copy()
        far = float(np.linalg.norm(away))
        self._along = away / far if far > 1.0 else np.array([1.0, 0.0])
        self._path = []
        self.note()

    def note(self) -> None:
        """Append the current position of the lander to the path that is drawn."""
        self._path.append(self._project(self._lanes.y[self._lane, :3]))

    def _project(self, points: Array) -> Array:
        """Project points (..., 3) to the plane, as offsets (..., 2) from the target, m."""
        off = points - self._lanes.target[self._lane]
        return np.stack((off[..., :2] @ self._along, off[..., 2]), axis=-1)

    def draw(self) -> Image:
        """Return an RGB image of the current state (440, 640, 3)."""
        here = self._project(self._lanes.y[self._lane, :3])
        extent = max(_NEAREST, _ROOM * max(abs(float(here[0])), float(here[1])))
        left, low = 0.5 * float(here[0]) - 0.5 * extent, -0.12 * extent
        scale = SIDE / extent

        def pixels(points: Array) -> NDArray[np.int32]:
            spot = (np.asarray(points) - (left, low)) * scale
            spot[..., 1] = SIDE - spot[..., 1]
            return np.round(np.clip(spot, -4 * SIDE, 5 * SIDE)).astype(np.int32)

        image = np.full((SIDE, SIDE, 3), _SKY, np.uint8)
        profile = pixels(self._terrain_profile(left, extent))
        corners = np.array([[SIDE, 2 * SIDE], [0, 2 * SIDE]], np.int32)
        cv2.fillPoly(image, [np.vstack((profile, corners))], _GROUND)
        cv2.polylines(image, [profile], False, _LINE, 1, cv2.LINE_AA)
        aim = pixels(np.zeros(2))
        cv2.line(image, aim + np.array([0, 3]), aim - np.array([0, 12]), _AIM, 2, cv2.LINE_AA)
        cv2.polylines(image, [pixels(np.array(self._path))], False, _PATH, 1, cv2.LINE_AA)
        self._lander(image, pixels, scale)
        cv2.putText(image, f"{extent:.0f} m across", (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.42,
                    _WORDS, 1, cv2.LINE_AA)  # fmt: skip
        return np.hstack((image, self._gauges()))

    def _terrain_profile(self, left: float, extent: float) -> Array:
        """Return the terrain profile in the view plane as distance and height (n, 2), m.

        `left` is the distance of the left edge from the target and `extent` the width of the view,
        m. Unknown terrain has the height of the target.
        """
        lanes, worlds = self._lanes, self._lanes.worlds
        z = worlds.terrains[lanes.world[self._lane]]
        x0, y0, posting = worlds.frame
        along = np.linspace(left, left + extent, 2 * SIDE)
        target = lanes.target[self._lane]
        xy = target[:2] + along[:, None] * self._along
        col, row = np.round((xy - (x0, y0)) / posting).astype(int).T
        known = (row >= 0) & (col >= 0) & (row < z.shape[0]) & (col < z.shape[1])
        height = np.zeros(len(along))
        height[known] = np.nan_to_num(z[row[known], col[known]] - target[2])
        return np.column_stack((along, height))

    def _lander(
        self, image: Image, to_pixels: Callable[[Array], NDArray[np.int32]], pixels_per_metre: float
    ) -> None:
        """Draw legs, body and flame of the lander on `image`.

        `to_pixels` converts positions in the view plane, m, to pixels.
        """
        lanes, y = self._lanes, self._lanes.y[self._lane]
        vehicle = lanes.craft.dynamics.lander
        size = vehicle.leg_radius
        # Enlarge a distant lander to a visible size.
        more = max(1.0, _LEAST / (2.0 * size * pixels_per_metre))
        foot = -vehicle.com_height
        across = np.array([*self._along, 0.0])
        side = across @ np.array([quat_rotate(y[6:10], axis) for axis in np.eye(3)]).T
        side = np.array([side[0], side[1], 0.0])
        side /= max(float(np.linalg.norm(side)), 1e-9)

        def at(lateral: float, up: float) -> NDArray[np.int32]:
            point = quat_rotate(y[6:10], size * lateral * side + np.array([0.0, 0.0, up]))
            return to_pixels(self._project(y[:3] + more * point))

        low, high = foot + _UNDER * size, foot + _TOP * size
        if lanes.ended[self._lane] == FLYING:
            length = 1.6 * size * float(y[14]) / vehicle.thrust_max
            flame = np.array([at(-0.2, low), at(0.2, low), at(0.0, low - length)])
            cv2.fillPoly(image, [flame], _FLAME, cv2.LINE_AA)
        for lateral in (-1.0, 1.0):
            cv2.line(image, at(0.5 * lateral, 0.5 * (low + high)), at(lateral, foot), _BODY, 2,
                     cv2.LINE_AA)  # fmt: skip
        body = [at(-_HALF, low), at(_HALF, low), at(0.7 * _HALF, high), at(-0.7 * _HALF, high)]
        cv2.fillPoly(image, [np.array(body)], _BODY, cv2.LINE_AA)

    def _gauges(self) -> Image:
        """Return an RGB image of gauges and of the landing outcome (440, 200, 3)."""
        lanes, y = self._lanes, self._lanes.y[self._lane]
        vehicle = lanes.craft.true_lander
        tilt = np.degrees(np.arccos(np.clip(quat_rotate(y[6:10], [0.0, 0.0, 1.0])[2], -1.0, 1.0)))
        off = self._project(y[:3])
        gauges = [
            ("time", f"{lanes.time[self._lane]:.1f} s", None),
            ("height", f"{off[1] - vehicle.com_height:.1f} m", None),
            ("to target", f"{lanes.miss[self._lane]:.1f} m", None),
            ("down", f"{-y[5]:.1f} m/s", None),
            ("lateral", f"{np.hypot(y[3], y[4]):.1f} m/s", None),
            ("tilt", f"{tilt:.1f} deg", tilt / 90.0),
            ("thrust", f"{y[14]:.0f} N", y[14] / vehicle.thrust_max),
            ("propellant", f"{y[13] - vehicle.dry_mass:.0f} kg",
             (y[13] - vehicle.dry_mass) / vehicle.propellant_mass),
        ]  # fmt: skip
        image = np.full((SIDE, ASIDE, 3), _SKY, np.uint8)
        font = cv2.FONT_HERSHEY_SIMPLEX
        for i, (name, value, share) in enumerate(gauges):
            top = 28 + 46 * i
            cv2.putText(image, name, (10, top), font, 0.42, _LINE, 1, cv2.LINE_AA)
            cv2.putText(image, value, (108, top), font, 0.42, _WORDS, 1, cv2.LINE_AA)
            if share is not None:
                full = round(180 * min(max(float(share), 0.0), 1.0))
                cv2.rectangle(image, (10, top + 8), (190, top + 16), _DIM, -1)
                cv2.rectangle(image, (10, top + 8), (10 + full, top + 16), _PATH, -1)
        if lanes.ended[self._lane] != FLYING:
            safe = bool(lanes.safe[self._lane])
            words = ("landed safely",) if safe else lanes.failure_causes(self._lane)
            colour = _AIM if safe else (230, 90, 60)
            for i, word in enumerate(words[:3]):
                cv2.putText(image, word, (10, 398 + 16 * i), font, 0.42, colour, 1, cv2.LINE_AA)
        return image
