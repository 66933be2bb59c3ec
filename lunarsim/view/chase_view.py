"""Render the terrain from behind the lander, with the lander and its site.

Terrain, rocks and shadows are rendered as for the onboard camera. The lander is drawn over the
image with the same Sun direction, and casts no shadow.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from lunarsim.frames import quat_rotate, sensor_axes
from lunarsim.models.lander import Lander
from lunarsim.models.pinhole import View
from lunarsim.typing import Array
from lunarsim.view.drawing import BACKGROUND, Image, fill_polygon, project
from lunarsim.view.lander_shape import body_faces, flame_vector, leg_lines
from lunarsim.world import World

# Distance of the camera behind the lander, leg radii.
_BEHIND = 7.0
# Minimum and maximum depression angle of the camera, rad; height of the maximum, m.
_FLAT, _STEEP, _LOW = 0.35, 0.96, 60.0
_HEADROOM = 1.5
_MIN_CAMERA_HEIGHT_M = 1.5
_BODY, _LEG, _FLAME, _SITE = (214, 200, 168), (150, 150, 156), (255, 178, 84), (0, 200, 130)
# Half width of the flame, leg radii.
_FLAME_WIDTH = 0.18


class Moment(NamedTuple):
    """True state of the lander at one time, and its site.

    Attributes
    ----------
    position, velocity
        Centre of mass (3,), m, and velocity (3,), m/s, true ENU.
    attitude
        Quaternion (4,), body to ENU, scalar last.
    mass, thrust
        Mass, kg, and thrust of the main engine, N.
    site
        Current landing site (3,), true ENU, m.
    is_flying
        Whether the flight has not ended.
    """

    position: Array
    velocity: Array
    attitude: Array
    mass: float
    thrust: float
    site: Array
    is_flying: bool


class ChaseView:
    """Images of a flight from behind the lander.

    Parameters
    ----------
    world, lander
        True world and lander of the flight.
    first
        State at the start: the camera stays behind the lander as seen along this velocity.
    size
        Width and height of the image, pixels.
    focal_length
        Focal length, pixels.

    Raises
    ------
    RenderingError
        If OpenGL is missing.
    """

    def __init__(
        self, world: World, lander: Lander, first: Moment, size: tuple[int, int],
        focal_length: float,
    ) -> None:  # fmt: skip
        from lunarsim.sensors.rendering import render_world  # noqa: PLC0415  (loads OpenGL)

        self.world, self.lander = world, lander
        self._size, self._focal_length = size, focal_length
        self._render = partial(render_world, world)
        way = first.velocity[:2]
        if np.linalg.norm(way) < 0.1:
            way = first.site[:2] - first.position[:2]
        length = float(np.linalg.norm(way))
        self._along = np.array([*way, 0.0]) / length if length > 0.1 else np.array([0.0, 1.0, 0.0])
        self._white = 1.0

    def set_exposure(self, views: Sequence[View]) -> None:
        """Set the radiance shown as white: 1.5 times the 90th percentile of lit pixels.

        A flight keeps one exposure, so that the brightness of its images is comparable.
        """
        seen = np.concatenate([self._render(v).radiance.ravel() for v in views])
        lit = seen[seen > 0.0]
        self._white = _HEADROOM * float(np.percentile(lit, 90.0)) if lit.size else 1.0

    def camera(self, moment: Moment) -> View:
        """Return the pose of the camera, behind the lander and aimed at it.

        Its depression angle is that of the line from lander to site, within limits.
        """
        away = moment.position - moment.site
        most = _FLAT + (_STEEP - _FLAT) * min(max(away[2] / _LOW, 0.0), 1.0)
        down = np.arctan2(away[2], float(np.hypot(away[0], away[1])))
        down = np.clip(down, _FLAT, most)
        behind = np.array([0.0, 0.0, np.sin(down)]) - np.cos(down) * self._along
        position = moment.position + _BEHIND * self.lander.leg_radius * behind
        position[2] = max(position[2], self._terrain_height(position) + _MIN_CAMERA_HEIGHT_M)
        width, height = self._size
        return View(
            position, sensor_axes(moment.position - position), self._focal_length,
            self._focal_length, 0.5 * (width - 1), 0.5 * (height - 1), width, height,
        )  # fmt: skip

    def _terrain_height(self, position: Array) -> float:
        """Return the maximum elevation around a position (3,), m; -inf if it is unknown."""
        step = self.world.terrain.relief.grid.posting
        around = position[:2] + step * np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]])
        heights = self.world.terrain.elevation(around)
        return float(np.max(heights[np.isfinite(heights)], initial=-np.inf))

    def terrain_image(self, view: View) -> Image:
        """Render the terrain from a camera pose as an RGB image (height, width, 3)."""
        radiance = self._render(view).radiance
        tone = 235.0 * np.clip(radiance / self._white, 0.0, 1.0) ** (1.0 / 2.2)
        image = np.repeat(tone[..., None], 3, axis=2).astype(np.uint8)
        return np.maximum(image, np.array(BACKGROUND, np.uint8))

    def draw(self, moment: Moment) -> Image:
        """Return an RGB image (height, width, 3) of terrain, site and lander."""
        view = self.camera(moment)
        image = self.terrain_image(view)
        self.draw_site(image, view, moment)
        self._draw_lander(image, view, moment)
        return image

    def draw_site(self, image: Image, view: View, moment: Moment) -> None:
        """Draw a circle of the leg radius around the current site, if it is in view."""
        turn = np.linspace(0.0, 2.0 * np.pi, 37)
        ring = np.column_stack((np.cos(turn), np.sin(turn), np.zeros(37))) * self.lander.leg_radius
        points = project(view, moment.site + ring)
        if points is not None:
            cv2.polylines(image, [points], True, _SITE, 1, cv2.LINE_AA)

    def _draw_lander(self, image: Image, view: View, moment: Moment) -> None:
        """Draw flame, legs and body over an image.

        The faces of the body are drawn from far to near, so that near ones cover far ones.
        """

        def to_enu(points: Array) -> Array:
            return np.asarray(moment.position + quat_rotate(moment.attitude, points))

        if moment.is_flying:
            base, tip = flame_vector(self.lander, moment.thrust)
            for across in np.eye(3)[:2] * _FLAME_WIDTH * self.lander.leg_radius:
                corners = np.array([base - across, base + across, base + tip])
                fill_polygon(image, view, to_enu(corners), _FLAME)
        for leg in leg_lines(self.lander):
            ends = project(view, to_enu(leg))
            if ends is not None:
                cv2.line(image, tuple(ends[0]), tuple(ends[1]), _LEG, 2, cv2.LINE_AA)
        faces = [to_enu(face) for face in body_faces(self.lander)]
        faces.sort(key=lambda face: -float(np.linalg.norm(face.mean(axis=0) - view.position)))
        sun = self.world.light.direction
        for face in faces:
            normal = np.cross(face[1] - face[0], face[2] - face[1])
            normal /= np.linalg.norm(normal)
            light = 0.25 + 0.75 * max(float(normal @ sun), 0.0)
            fill_polygon(image, view, face, tuple(round(light * c) for c in _BODY))
