"""Render a chase view, the onboard camera view and gauges of a simulated flight."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError
from lunarsim.frames import quat_rotate
from lunarsim.models.pinhole import View
from lunarsim.simulation import Simulation
from lunarsim.simulation.image_rendering import first_camera
from lunarsim.view.chase_view import ChaseView, Moment
from lunarsim.view.drawing import BACKGROUND, Image, draw_gauges, draw_text, project

__all__ = ["HEIGHT", "PANEL", "WIDTH", "ChaseViewRenderer", "project"]

# Size of the chase view, and width of the camera view and the gauges, pixels.
HEIGHT, WIDTH, PANEL = 360, 560, 240
# Focal length of the chase camera, pixels.
_FOCAL = 520.0


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
        self.simulation = simulation
        camera = first_camera(simulation.scenario)
        self._camera, self._shrunk = camera, PANEL / max(camera.width, camera.height)
        self._chase = ChaseView(
            simulation.world, simulation.lander, self._moment(), (WIDTH, HEIGHT), _FOCAL
        )
        self._chase.set_exposure((self.chase(), self._onboard()))

    def _moment(self) -> Moment:
        """Return the true state of the lander at the current time, and its site."""
        s = self.simulation
        y, site = s.state, s.true_to_local.to_site(s.site)
        return Moment(
            y.position, y.velocity, y.attitude, y.mass, float(y.thrust), site, s.outcome is None
        )

    def chase(self) -> View:
        """Return the pose of the chase camera, behind the lander and aimed at it."""
        return self._chase.camera(self._moment())

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
        return self._chase.terrain_image(view)

    def draw(self) -> Image:
        """Return an RGB image of all views and gauges at the current time (360, 800, 3)."""
        moment = self._moment()
        chase = self._chase.draw(moment)
        draw_text(chase, "chase view", (8, 18))
        below = self._onboard()
        onboard = np.full((PANEL, PANEL, 3), BACKGROUND, np.uint8)
        try:
            seen = self.seen_by(below)
            self._chase.draw_site(seen, below, moment)
            onboard[: seen.shape[0], : seen.shape[1]] = seen
        except InputError:  # the camera is below the terrain
            draw_text(onboard, "below the terrain", (8, 40))
        draw_text(onboard, "onboard camera", (8, PANEL - 10))
        side_panel = np.vstack((onboard, self.gauges()))
        return np.hstack((chase, side_panel))

    def gauges(self) -> Image:
        """Return an RGB image of gauges that show the true state (120, 240, 3)."""
        s = self.simulation
        y, vehicle = s.state, s.lander
        tilt = np.degrees(np.arccos(np.clip(quat_rotate(y.attitude, [0.0, 0.0, 1.0])[2], -1, 1)))
        left = y.mass - vehicle.dry_mass
        away = y.position - s.true_to_local.to_site(s.site)
        rows = [
            ("height", f"{away[2] - vehicle.com_height:.1f} m", None),
            ("to site", f"{np.hypot(away[0], away[1]):.1f} m", None),
            ("down, lateral", f"{-y.velocity[2]:.1f}, {np.hypot(*y.velocity[:2]):.1f} m/s", None),
            ("tilt", f"{tilt:.1f} deg", tilt / 90.0),
            ("thrust", f"{y.thrust:.0f} N", y.thrust / vehicle.thrust_max),
            ("propellant", f"{left:.0f} kg", left / vehicle.propellant_mass),
        ]
        return draw_gauges(rows, PANEL, HEIGHT - PANEL)
