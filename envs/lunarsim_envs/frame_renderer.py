"""Render frames of a flight with site decisions: descent path and hazard map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from lunarsim.onboard.policies import Observation
from lunarsim.simulation import Simulation
from lunarsim.simulation.map_record import map_remark

# Height and horizontal distance shown in the close-up of the landing, m.
_LOW, _ASIDE = 60.0, 60.0
_PATH, _HERE = "#0072B2", "#D55E00"


class FrameRenderer:
    """Plot descent path and hazard map of one flight, one image (frame) per call.

    The axis limits are those of the first decision.

    Parameters
    ----------
    simulation, observation
        Simulation of the flight, and observation of the policy, at the first site decision.
    """

    def __init__(self, simulation: Simulation, observation: Observation) -> None:
        self.simulation = simulation
        figure = Figure(figsize=(8.0, 3.6), dpi=100)
        self._canvas = FigureCanvasAgg(figure)
        high, low, plan = figure.subplots(1, 3, width_ratios=[1.0, 0.8, 1.25])
        figure.subplots_adjust(left=0.075, right=0.93, bottom=0.14, top=0.86, wspace=0.42)
        away, up = self._profile(observation)
        self._paths = [ax.plot([], [], color=_PATH)[0] for ax in (high, low)]
        self._heres = [ax.plot([], [], "o", color=_HERE)[0] for ax in (high, low)]
        _format_axes(high, (0.0, 1.05 * max(away[0], 1.0)), (-10.0, 1.05 * up[0]), "Descent")
        _format_axes(low, (0.0, _ASIDE), (-2.0, _LOW), f"Last {_LOW:g} m")
        high.set_ylabel("Altitude above site (m)")
        grid = observation.hazard_map.grid
        plan.set_facecolor("0.8")
        self._image = plan.imshow(
            np.full(grid.shape, np.nan), origin="lower", extent=grid.extent, vmin=0.0, vmax=1.0,
            cmap="viridis",
        )  # fmt: skip
        figure.colorbar(self._image, ax=plan, label="Probability of safety", fraction=0.046)
        west, east, south, north = grid.extent
        plan.set(xlim=(west, east), ylim=(south, north), xlabel="East (m)")
        plan.set_ylabel("North (m)", labelpad=2.0)
        (self._sites,) = plan.plot([], [], "o", mfc="white", mec="black", ms=4, ls="")
        self._target = Circle((0.0, 0.0), simulation.lander.leg_radius, fill=False, ec=_HERE, lw=2)
        plan.add_patch(self._target)
        self._map_title = plan.text(
            0.5, 1.03, "", transform=plan.transAxes, ha="center", fontsize=8
        )
        self._title = figure.text(0.5, 0.96, "", ha="center", fontsize=9)
        # Axes are drawn once; each frame draws the moving artists over a copy of them.
        self._moving = [
            self._image, *self._paths, *self._heres, self._sites, self._target, self._map_title,
            self._title,
        ]  # fmt: skip
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)
        self._figure = figure

    def _profile(self, observation: Observation) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the flown path as distance and height relative to the site (n,), m."""
        rows = self.simulation.recorder.trajectory()
        site = observation.site
        away = np.hypot(rows["estimated_x"] - site[0], rows["estimated_y"] - site[1])
        return away, rows["estimated_z"] - site[2]

    @property
    def map_title(self) -> str:
        """Title of the map in the last frame."""
        return str(self._map_title.get_text())

    @property
    def title(self) -> str:
        """Title of the last frame: time, action, reward and outcome."""
        return str(self._title.get_text())

    @property
    def target(self) -> tuple[float, float]:
        """East and north coordinate of the site in the last frame, m."""
        east, north = self._target.center
        return float(east), float(north)

    @property
    def place(self) -> tuple[float, float]:
        """Horizontal distance and height of the lander in the last frame, m."""
        away, up = self._heres[0].get_data()
        return float(np.asarray(away)[-1]), float(np.asarray(up)[-1])

    def draw(
        self, observation: Observation, action: int | None, reward: float | None,
        time_scale: float | None = None,
    ) -> NDArray[np.uint8]:  # fmt: skip
        """Return an RGB image of the current state (360, 800, 3) in the local frame.

        Parameters
        ----------
        observation
            Current observation of the policy.
        action, reward
            Number of the last action and its reward; None before the first decision.
        time_scale
            Factor on the time-to-go that the last action set; None if it did not change.
        """
        away, up = self._profile(observation)
        for path, here in zip(self._paths, self._heres, strict=True):
            path.set_data(away, up)
            here.set_data(away[-1:], up[-1:])
        m = observation.hazard_map
        self._image.set_data(np.where(m.observed, m.p_safe, np.nan))
        self._image.set_extent(m.grid.extent)
        self._sites.set_data(*observation.candidates.position[:, :2].T)
        self._target.center = tuple(observation.site[:2])
        words = map_remark(m)
        title = "Hazard map" if words is None else f"Map {words.partition(':')[0]}"
        self._map_title.set_text(title)
        self._title.set_text(self._title_text(action, reward, time_scale))
        self._canvas.restore_region(self._still)
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _title_text(
        self, action: int | None, reward: float | None, time_scale: float | None
    ) -> str:
        """Return the frame title: time, last action, its reward and the flight's outcome."""
        words = [f"t = {self.simulation.time:.1f} s"]
        if action is not None:
            words.append("keep the site" if action == 0 else f"divert to candidate {action}")
        if time_scale is not None:
            words.append(f"time scale {time_scale:g}")
        if reward is not None:
            words.append(f"reward {reward:+.3f}")
        outcome = self.simulation.outcome
        if outcome is not None:
            words.append(
                "landed safely" if outcome.safe else "failed: " + ", ".join(outcome.failure_causes)
            )
        return ",  ".join(words)


def _format_axes(axes: Any, x: tuple[float, float], y: tuple[float, float], title: str) -> None:
    """Set limits `x` and `y`, labels, title and grid lines of a path plot."""
    axes.set(xlim=x, ylim=y, xlabel="Distance from site (m)", title=title)
    axes.grid(alpha=0.3)
