"""Layout of a recording in the Rerun viewer: 3D view, log, plots and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lunarsim.typing import Array

# Entities that are drawn from the start of the flight to the time of the view.
PATHS = ("world/true_path", "world/estimated_path")
TIMELINE = "time"
_PLOTS = {
    "altitude": "Altitude above the target",
    "speed": "Speed",
    "tilt": "Tilt from the vertical",
    "thrust": "Thrust",
    "propellant": "Propellant",
}
_ERRORS = {f"navigation_error_{axis}": f"Navigation error, {axis}" for axis in
           ("east", "north", "up")}  # fmt: skip


def flight_blueprint(
    start: Array, target: Array, cameras: Sequence[str] = (), *, is_live: bool = False
) -> Any:
    """Return the layout of the recording of a flight.

    Parameters
    ----------
    start, target
        Position of the lander at the start, and target (3,), m: the first view shows both.
    cameras
        Names of the cameras whose images are recorded.
    is_live
        Whether the time of the view follows a flight that is being simulated.
    """
    import rerun.blueprint as rrb  # noqa: PLC0415  (an extra)

    past = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    overrides: Any = {path: rrb.VisibleTimeRanges([past]) for path in PATHS}
    scene = rrb.Spatial3DView(
        origin="world", name="Flight", overrides=overrides, line_grid=False,
        background=[20, 20, 26], eye_controls=_viewpoint(start, target),
    )  # fmt: skip

    def plots(names: dict[str, str]) -> Any:
        views = [rrb.TimeSeriesView(origin=f"plots/{name}", name=title)
                 for name, title in names.items()]  # fmt: skip
        return rrb.Vertical(*views, name="State" if names is _PLOTS else "Navigation error")

    images = [rrb.Spatial2DView(origin=f"world/cameras/{name}", name=f"Camera {name}")
              for name in cameras]  # fmt: skip
    log = rrb.TextLogView(origin="log", name="Decisions and events")
    below = rrb.Horizontal(log, *images) if images else log
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, below, row_shares=[3, 1.4] if images else [3, 1]),
            rrb.Tabs(plots(_PLOTS), plots(_ERRORS)),
            column_shares=[2, 1],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed",
                      play_state="following" if is_live else None),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )  # fmt: skip


def _viewpoint(start: Array, target: Array) -> Any:
    """Return a viewpoint beside the last part of the path, aimed at the target."""
    import rerun.blueprint as rrb  # noqa: PLC0415  (an extra)

    way = start - target
    length = max(float(np.linalg.norm(way)), 20.0)
    beside = np.array([way[1], -way[0], 0.0])
    size = float(np.linalg.norm(beside))
    beside = beside / size if size > 1.0 else np.array([0.0, -1.0, 0.0])
    position = target + 0.1 * way + 0.22 * length * beside + np.array([0.0, 0.0, 0.08 * length])
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=target + 0.03 * way,
        eye_up=[0.0, 0.0, 1.0],
    )  # fmt: skip
