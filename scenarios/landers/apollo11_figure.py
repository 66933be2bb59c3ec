"""Plot simulated Apollo 11 descents together with the flight record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from landers import apollo11

from lunarsim.viz.style import COLOURS, new_figure

_FULL_THRUST_N = 46_706.0  # 100 % throttle, N


def draw_descent(runs: Sequence[Any], look_angles: Callable[[Any], np.ndarray], path: Path) -> Path:
    """Plot altitude, pitch, throttle, look angle to the site and terrain of descents.

    `look_angles` returns the look angle (n,), rad, of a flight. Returns `path`, the output file.
    """
    figure = new_figure(11.0, 8.0)
    axes = figure.subplots(2, 2)
    recorded = apollo11.record()
    known = np.isfinite(recorded.altitude)
    black = {"color": "black", "linewidth": 1.0, "label": "record"}
    axes[0, 0].plot(recorded.time[known], recorded.altitude[known] / 1e3, **black)
    axes[0, 1].plot(recorded.time, np.rad2deg(recorded.pitch), **black)
    for run, colour in zip(runs, COLOURS, strict=False):
        _plot_run(axes, run, colour, look_angles(run.flight))
    _plot_terrain(axes[0, 0], runs[0])
    for panel, label in zip(
        axes.ravel(),
        ("Altitude above the site (km)", "Pitch from the vertical of the site (deg)",
         "Throttle (% of 46,706 N)", "Look angle to the site in P64 (deg)"),
        strict=True,
    ):  # fmt: skip
        panel.set_xlabel("Time since ignition (s)")
        panel.set_ylabel(label)
        panel.legend()
        for phase in (apollo11.P64, apollo11.P66):
            panel.axvline(phase, color="0.8", linewidth=0.8, zorder=0)
    axes[1, 1].axhspan(-5.0, 65.0, color="0.93", zorder=0)
    axes[1, 1].set_xlim(400.0, apollo11.LANDING)
    figure.suptitle(
        "Apollo 11 descent: simulation with the Apollo 11 load, and flight record "
        "(grey lines: start of P64 and P66)"
    )
    figure.savefig(path, dpi=110)
    return path


def _plot_run(axes: Any, run: Any, colour: str, look: np.ndarray) -> None:
    """Plot altitude, pitch, throttle and look angle of one simulated descent."""
    flight, lander = run.flight, run.sim.lander
    track = apollo11.track_of(flight, run.sim.world.moon, lander.com_height)
    line = {"color": colour, "linewidth": 1.2, "label": run.name}
    axes[0, 0].plot(track.time, track.altitude / 1e3, **line)
    axes[0, 1].plot(track.time, np.rad2deg(track.pitch), **line)
    axes[1, 0].plot(track.time, 100.0 * flight.trajectory["thrust"] / _FULL_THRUST_N, **line)
    approach = flight.trajectory["phase"] == 0
    axes[1, 1].plot(track.time[approach], np.rad2deg(look[approach]), **line)


def _plot_terrain(panel: Any, run: Any) -> None:
    """Plot the terrain height under the vehicle, multiplied by 10."""
    about, positions = run.sim.world.far_terrain, run.flight.positions[::20]
    height = about.elevation(about.surface_arc(positions))
    panel.plot(
        run.flight.trajectory["time"][::20], 10.0 * height / 1e3, color="0.55", linewidth=1.0,
        label="terrain height (P65), x 10",
    )  # fmt: skip
