"""Draw the figure of a descent: its profile, and time histories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lunarsim.frames import quat_to_matrix
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.simulation.columns import vector_columns
from lunarsim.simulation.flight import Flight
from lunarsim.viz.style import COLOURS, flight_title, new_figure, save

# If an event occurs more often, only the first is drawn.
_MAX_MARKS = 8
# Events that are marked: label, marker and colour.
_EVENT_STYLES = {
    "scan": ("LiDAR scan", "s", COLOURS[2]),
    "image": ("first camera image", "o", COLOURS[3]),
    "lock": ("lock onto the map", "^", COLOURS[4]),
}
_LOST_STYLE = ("navigation lost", "X", "black")
_DIVERT_STYLE = ("divert", "D", COLOURS[1])
# Names of the phases in the trajectory.
_PHASES = {1: "vertical descent", 2: "abort", 3: "braking", 4: "hover"}


def draw_descent(flight: Flight, path: Path | None = None) -> Figure:
    """Draw a flight's altitude profile, and speeds, tilt, thrust and events over time.

    The figure is returned, and also written to the PNG file `path` if it is given.
    """
    figure = new_figure(12, 8.2)
    names = ("events", "speed", "tilt", "thrust", "propellant")
    axes: dict[str, Any] = figure.subplot_mosaic(
        [["profile", name] for name in names],
        height_ratios=[0.45, 1.0, 1.0, 1.0, 1.0],
        width_ratios=[1.0, 1.15],
    )
    lander = Scenario.world_from_toml(flight.scenario).true_lander()
    marks = _event_marks(flight)
    _draw_profile(axes["profile"], flight, marks)
    _draw_events(axes["events"], marks)
    _draw_speed_and_tilt(axes["speed"], axes["tilt"], flight)
    _draw_engine(axes["thrust"], axes["propellant"], flight, lander)
    for name in names:
        _draw_phases_and_diverts(axes[name], flight, marks, with_legend=name == names[0])
        axes[name].tick_params(labelbottom=name == names[-1])
    axes[names[-1]].set_xlabel("Time (s)")
    figure.suptitle(flight_title(flight))
    if path is not None:
        save(figure, path)
    return figure


def _event_marks(flight: Flight) -> list[tuple[str, str, str, list[float]]]:
    """Return label, marker, colour and times (s) of each kind of event in a flight.

    Kinds without an event are omitted. Of scans, images and locks, only the first is given if there
    are more than 8.
    """
    found = []
    for name, (label, marker, colour) in _EVENT_STYLES.items():
        times = [float(e["time"]) for e in flight.events if e["name"] == name]
        if len(times) > _MAX_MARKS:
            found.append((f"first of {len(times)}: {label}", marker, colour, times[:1]))
        elif times:
            found.append((label, marker, colour, times))
    lost = np.asarray(flight.trajectory["lost"], dtype=bool)
    begins = np.flatnonzero(lost & ~np.concatenate(([False], lost[:-1])))
    if len(begins):
        found.append((*_LOST_STYLE, flight.trajectory["time"][begins].tolist()))
    diverts = [float(d["time"]) for d in flight.decisions]
    if diverts:
        found.append((*_DIVERT_STYLE, diverts))
    return found


def _draw_profile(
    profile: Any, flight: Flight, marks: list[tuple[str, str, str, list[float]]]
) -> None:
    """Draw altitude over horizontal distance, with marks of the events.

    `marks` has label, marker, colour and times of each kind of event.
    """
    t = flight.trajectory
    end = flight.positions[-1]
    altitude = t["position_z"] - end[2]
    away = np.hypot(t["position_x"] - end[0], t["position_y"] - end[1])
    profile.plot(away, altitude, color=COLOURS[0], lw=1.8)
    handles = [Line2D([], [], color=COLOURS[0], label="path")]
    last = "touchdown" if flight.outcome.touchdown is not None else "end"
    for label, marker, colour, times in [*marks, (last, "v", "black", [float(t["time"][-1])])]:
        rows = [int(np.argmin(np.abs(t["time"] - time))) for time in times]
        profile.plot(away[rows], altitude[rows], marker, color=colour, ms=7, mec="black", mew=0.6)
        handles.append(
            Line2D([], [], ls="", marker=marker, color=colour, mec="black", mew=0.6, label=label)
        )
    profile.legend(handles=handles, loc="upper left")
    profile.set_xlabel(f"Horizontal distance to {last} (m)")
    profile.set_ylabel(f"Altitude above {last} (m)")
    profile.grid(alpha=0.3)


def _draw_events(events: Any, marks: list[tuple[str, str, str, list[float]]]) -> None:
    """Draw the times of events, one row of marks per kind of event."""
    for row, (_, marker, colour, times) in enumerate(marks):
        events.plot(times, [row] * len(times), marker, color=colour, ms=7, mec="black", mew=0.6)
    events.set_yticks(range(len(marks)), [label for label, *_ in marks])
    events.set_ylim(max(len(marks), 1) - 0.5, -0.5)  # a flight may have none


def _draw_speed_and_tilt(speed: Any, tilt: Any, flight: Flight) -> None:
    t = flight.trajectory
    speed.plot(t["time"], -t["velocity_z"], color=COLOURS[0], label="descent rate")
    horizontal = np.hypot(t["velocity_x"], t["velocity_y"])
    speed.plot(t["time"], horizontal, color=COLOURS[1], ls="--", label="horizontal speed")
    speed.set_ylabel("Speed (m/s)")
    q = vector_columns(t, "attitude", "xyzw")
    angle = np.rad2deg(np.arccos(np.clip(quat_to_matrix(q)[:, 2, 2], -1.0, 1.0)))
    tilt.plot(t["time"], angle, color=COLOURS[2], label="tilt from the vertical")
    tilt.set_ylabel("Tilt (deg)")


def _draw_engine(thrust: Any, propellant: Any, flight: Flight, lander: Lander) -> None:
    t = flight.trajectory
    thrust.plot(t["time"], t["thrust"] / 1e3, color=COLOURS[3], label="thrust")
    for limit in (lander.thrust_min, lander.thrust_max):
        thrust.axhline(limit / 1e3, color="0.5", lw=0.8, ls="--")
    thrust.plot([], [], color="0.5", lw=0.8, ls="--", label="throttle limits")
    thrust.set_ylabel("Thrust (kN)")
    left = t["mass"] - lander.dry_mass
    propellant.plot(t["time"], left, color=COLOURS[4], label="remaining propellant")
    propellant.set_ylabel("Propellant (kg)")


def _draw_phases_and_diverts(
    axes: Any, flight: Flight, marks: list[tuple[str, str, str, list[float]]], *, with_legend: bool
) -> None:
    """Draw diverts and phase changes as vertical lines over the flight time.

    `marks` has label, marker, colour and times of each kind of event.
    """
    t = flight.trajectory
    axes.set_xlim(0.0, t["time"][-1] or None)
    axes.grid(alpha=0.3)
    for label, _, colour, times in marks:
        for i, time in enumerate(times if label == _DIVERT_STYLE[0] else ()):
            name = label if with_legend and i == 0 else None
            axes.axvline(time, color=colour, lw=0.9, ls=":", label=name)
    phase = t["phase"].astype(int)
    for row in np.flatnonzero(np.diff(phase)) + 1:
        name = _PHASES.get(int(phase[row]), "approach")
        axes.axvline(
            t["time"][row], color="0.4", lw=0.9, label=f"start of {name}" if with_legend else None
        )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")
