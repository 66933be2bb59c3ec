"""Render a chase view, the onboard camera view and gauges of a flight.

Terrain, rocks and shadows are rendered as for the onboard camera. The lander in the chase view is
drawn over the image with the same Sun direction, and casts no shadow.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_rotate, sensor_axes
from lunarsim.models.pinhole import View
from lunarsim.simulation import Simulation
from lunarsim.simulation.image_rendering import first_camera
from lunarsim.typing import Array

Image = NDArray[np.uint8]

# Size of the chase view, and width of the camera view and the gauges, pixels.
HEIGHT, WIDTH, ASIDE = 360, 560, 240
# Distance of the chase camera behind the lander, leg radii; focal length, pixels.
_BEHIND, _FOCAL = 7.0, 520.0
# Minimum and maximum depression angle of the chase camera, rad; height of the maximum, m.
_FLAT, _STEEP, _LOW = 0.35, 0.96, 60.0
_HEADROOM = 1.5
_LEAST_OVER = 1.5  # minimum height of the chase camera above the terrain, m
_SKY, _WORDS, _DIM = (6, 6, 10), (235, 235, 235), (70, 74, 84)
_BODY, _LEG, _FLAME, _AIM = (214, 200, 168), (150, 150, 156), (255, 178, 84), (0, 200, 130)
_BAR = (86, 180, 233)
# Underside and top of the body above the pad plane, and its half width, leg radii; its sides.
_UNDER, _TOP, _HALF, _SIDES = 0.25, 1.1, 0.55, 8


class ChaseViewRenderer:
    """Draw a chase view, the onboard camera view and gauges of one simulated flight.

    Parameters
    ----------
    simulation
        Simulation of the flight, which has just reached its first site decision.

    Raises
    ------
    RenderingError
        If OpenGL is missing.
    """

    def __init__(self, simulation: Simulation) -> None:
        from lunarsim.sensors.rendering import renderer_of  # noqa: PLC0415  (loads OpenGL)

        self.simulation = simulation
        self._renderer = renderer_of(simulation.world.terrain)
        camera = first_camera(simulation.scenario)
        self._camera, self._shrunk = camera, ASIDE / max(camera.width, camera.height)
        way = simulation.state.velocity[:2]
        if np.linalg.norm(way) < 0.1:
            way = simulation.site[:2] - simulation.state.position[:2]
        size = float(np.linalg.norm(way))
        self._along = np.array([*way, 0.0]) / size if size > 0.1 else np.array([0.0, 1.0, 0.0])
        # One exposure for the complete flight, so that brightness is comparable.
        self._bright = self._exposure()

    def chase(self) -> View:
        """Return the pose of the chase camera, behind the lander and aimed at it.

        Its depression angle is that of the line from lander to site, within limits.
        """
        s = self.simulation
        at = s.state.position
        away = at - s.true_to_local.to_site(s.site)
        most = _FLAT + (_STEEP - _FLAT) * min(max(away[2] / _LOW, 0.0), 1.0)
        down = np.arctan2(away[2], float(np.hypot(away[0], away[1])))
        down = np.clip(down, _FLAT, most)
        behind = np.array([0.0, 0.0, np.sin(down)]) - np.cos(down) * self._along
        position = at + _BEHIND * s.lander.leg_radius * behind
        terrain_height = float(s.world.terrain.elevation(position[:2]))
        if np.isfinite(terrain_height):
            position[2] = max(position[2], terrain_height + _LEAST_OVER)
        middle = 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
        return View(position, sensor_axes(at - position), _FOCAL, _FOCAL, *middle, WIDTH, HEIGHT)

    def _exposure(self) -> float:
        """Return the radiance shown as white: 1.5 times the 90th percentile of lit pixels."""
        light = self.simulation.world.light
        views = (self.chase(), self._onboard())
        seen = np.concatenate([self._renderer.render(v, light).radiance.ravel() for v in views])
        lit = seen[seen > 0.0]
        return _HEADROOM * float(np.percentile(lit, 90.0)) if lit.size else 1.0

    def _onboard(self) -> View:
        """Return pose and intrinsics of the onboard camera at reduced resolution."""
        view, share = self._camera.view(self.simulation.state), self._shrunk
        width, height = round(share * view.width), round(share * view.height)
        return View(
            view.position, view.axes, share * view.fx, share * view.fy,
            share * (view.cx + 0.5) - 0.5, share * (view.cy + 0.5) - 0.5, width, height,
        )  # fmt: skip

    def seen_by(self, view: View) -> Image:
        """Render the terrain as seen from a camera pose; RGB image (height, width, 3)."""
        radiance = self._renderer.render(view, self.simulation.world.light).radiance
        tone = 235.0 * np.clip(radiance / self._bright, 0.0, 1.0) ** (1.0 / 2.2)
        image = np.repeat(tone[..., None], 3, axis=2).astype(np.uint8)
        return np.maximum(image, np.array(_SKY, np.uint8))

    def draw(self) -> Image:
        """Return an RGB image of all views and gauges at the current time (360, 800, 3)."""
        view = self.chase()
        chase = self.seen_by(view)
        self._mark(chase, view)
        self._lander(chase, view)
        _say(chase, "chase view", (8, 18))
        below = self._onboard()
        onboard = np.full((ASIDE, ASIDE, 3), _SKY, np.uint8)
        try:
            seen = self.seen_by(below)
            self._mark(seen, below)
            onboard[: seen.shape[0], : seen.shape[1]] = seen
        except InputError:  # the camera is below the terrain
            _say(onboard, "below the terrain", (8, 40))
        _say(onboard, "onboard camera", (8, ASIDE - 10))
        side_panel = np.vstack((onboard, self.gauges()))
        return np.hstack((chase, side_panel))

    def _mark(self, image: Image, view: View) -> None:
        """Draw a circle of the leg radius around the current site, if it is in view."""
        s = self.simulation
        site = s.true_to_local.to_site(s.site)
        turn = np.linspace(0.0, 2.0 * np.pi, 37)
        ring = np.column_stack((np.cos(turn), np.sin(turn), np.zeros(37))) * s.lander.leg_radius
        points = project(view, site + ring)
        if points is not None:
            cv2.polylines(image, [points], True, _AIM, 1, cv2.LINE_AA)

    def _lander(self, image: Image, view: View) -> None:
        """Draw the lander over a rendered image: flame, legs and body.

        The faces of the body are drawn from far to near, so that near ones cover far ones.
        """
        s = self.simulation
        size, foot = s.lander.leg_radius, -s.lander.com_height
        low, high = foot + _UNDER * size, foot + _TOP * size

        def world(points: Any) -> Array:
            turned = [quat_rotate(s.state.attitude, p) for p in points]
            return np.asarray(s.state.position + np.array(turned))

        if s.outcome is None:
            length = 2.2 * size * float(s.state.thrust) / s.lander.thrust_max
            flame = [(-0.18 * size, 0, low), (0.18 * size, 0, low), (0, 0, low - length)]
            crossed = [(0, -0.18 * size, low), (0, 0.18 * size, low), (0, 0, low - length)]
            for one in (flame, crossed):
                _fill(image, view, world(one), _FLAME)
        for pad in s.lander.pads:
            knee = (0.5 * pad[0], 0.5 * pad[1], 0.5 * (low + high))
            ends = project(view, world([knee, pad]))
            if ends is not None:
                cv2.line(image, tuple(ends[0]), tuple(ends[1]), _LEG, 2, cv2.LINE_AA)
        turn = 2.0 * np.pi * (np.arange(_SIDES) + 0.5) / _SIDES
        ring = np.column_stack((np.cos(turn), np.sin(turn))) * _HALF * size
        lower = world(np.column_stack((ring, np.full(_SIDES, low))))
        upper = world(np.column_stack((0.75 * ring, np.full(_SIDES, high))))
        faces = [np.array([lower[k - 1], lower[k], upper[k], upper[k - 1]]) for k in range(_SIDES)]
        faces += [upper, lower[::-1]]
        faces.sort(key=lambda face: -float(np.linalg.norm(face.mean(axis=0) - view.position)))
        sun = s.world.light.direction
        for face in faces:
            normal = np.cross(face[1] - face[0], face[2] - face[1])
            normal /= np.linalg.norm(normal)
            light = 0.25 + 0.75 * max(float(normal @ sun), 0.0)
            _fill(image, view, face, tuple(round(light * c) for c in _BODY))

    def gauges(self) -> Image:
        """Return an RGB image of gauges that show the true state (120, 240, 3)."""
        s = self.simulation
        y, vehicle = s.state, s.lander
        tilt = np.degrees(np.arccos(np.clip(quat_rotate(y.attitude, [0.0, 0.0, 1.0])[2], -1, 1)))
        left = y.mass - vehicle.dry_mass
        away = y.position - s.true_to_local.to_site(s.site)
        shown = [
            ("height", f"{away[2] - vehicle.com_height:.1f} m", None),
            ("to site", f"{np.hypot(away[0], away[1]):.1f} m", None),
            ("down, lateral", f"{-y.velocity[2]:.1f}, {np.hypot(*y.velocity[:2]):.1f} m/s", None),
            ("tilt", f"{tilt:.1f} deg", tilt / 90.0),
            ("thrust", f"{y.thrust:.0f} N", y.thrust / vehicle.thrust_max),
            ("propellant", f"{left:.0f} kg", left / vehicle.propellant_mass),
        ]
        image = np.full((HEIGHT - ASIDE, ASIDE, 3), _SKY, np.uint8)
        for i, (name, value, share) in enumerate(shown):
            top = 16 + 19 * i
            _say(image, name, (8, top))
            _say(image, value, (112, top))
            if share is not None:
                full = round(224 * min(max(float(share), 0.0), 1.0))
                cv2.rectangle(image, (8, top + 4), (232, top + 6), _DIM, -1)
                cv2.rectangle(image, (8, top + 4), (8 + full, top + 6), _BAR, -1)
        return image


def _say(image: Image, words: str, at: tuple[int, int]) -> None:
    for colour, wide in ((_SKY, 3), (_WORDS, 1)):
        cv2.putText(image, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, wide, cv2.LINE_AA)


def project(view: View, points: Array) -> NDArray[np.int32] | None:
    """Project points (n, 3) to pixels (n, 2); None if a point is behind the camera."""
    seen = (np.asarray(points) - view.position) @ view.axes
    if (seen[:, 2] < 0.1).any():
        return None
    flat = seen[:, :2] / seen[:, 2:] * (view.fx, view.fy) + (view.cx, view.cy)
    return np.round(np.clip(flat, -4e3, 4e3)).astype(np.int32)


def _fill(image: Image, view: View, points: Array, colour: tuple[int, ...]) -> None:
    flat = project(view, points)
    if flat is not None:
        cv2.fillPoly(image, [flat], colour, cv2.LINE_AA)
