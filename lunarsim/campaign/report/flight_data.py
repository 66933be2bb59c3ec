"""Read touchdown limits and recorded trajectories for a campaign report."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow.compute as pc

from lunarsim.campaign.factors import folder_name
from lunarsim.campaign.results import Results
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight_files import read_trajectory
from lunarsim.typing import Array
from lunarsim.untrusted_files import read_bounded_bytes

# Maximum number of recorded trajectories per arm, and of points of each.
MAX_PATHS, _MAX_POINTS = 50, 100


class LimitedMetric(NamedTuple):
    """Column of the results for an axis: its label with unit, and its limit or None."""

    column: str
    label: str
    limit: float | None = None


class RecordedPath(NamedTuple):
    """Trajectory of a recorded flight of an arm, relative to the end of the flight.

    `distance` (n,) is the horizontal distance, m, and `height` (n,) the height, m.
    """

    arm: str
    is_safe: bool
    distance: Array
    height: Array


def touchdown_axes(results: Results) -> tuple[list[tuple[LimitedMetric, LimitedMetric]], str]:
    """Return the axes of the plots of touchdown speed and attitude, with limits.

    Also return the reason why there are no limits; it is empty if there are.
    """
    limits, remark = _limits(results)
    speed = (
        LimitedMetric("horizontal_speed_m_s", "Horizontal speed at contact (m/s)",
                      limits.get("horizontal_speed_limit")),
        LimitedMetric("vertical_speed_m_s", "Vertical speed at contact (m/s)",
                      limits.get("vertical_speed_limit")),
    )  # fmt: skip
    attitude = (
        LimitedMetric("slope_deg", "Slope under the legs (deg)", limits.get("slope_limit")),
        LimitedMetric("tilt_deg", "Tilt at contact (deg)", limits.get("tilt_limit")),
    )
    return [speed, attitude], remark


def _limits(results: Results) -> tuple[dict[str, float], str]:
    """Return the limits of the lander by name, m/s and deg, or the reason for none."""
    path = results.folder / "scenario.toml"
    keys = {key for arm in results.manifest["arms"] for key in arm["values"]}
    keys |= set(results.manifest["inputs"])
    if not path.is_file():
        return {}, "Limits are not drawn: the folder has no scenario."
    if any(
        k in ("vehicle", "vehicle.kind") or "_limit_" in k or k.startswith("legs") for k in keys
    ):
        return {}, "Limits are not drawn: they differ between flights."
    text = read_bounded_bytes(path).decode(errors="replace")
    try:
        scenario = Scenario.world_from_toml(text, path.parent.resolve())
        lander = scenario.true_lander()
    except InputError:
        return {}, "Limits are not drawn: the scenario in the folder cannot be loaded."
    if scenario.legs is not None:
        return {}, "Limits are not drawn: the simulated motion on the legs decides."
    speeds = {
        n: float(getattr(lander, n)) for n in ("horizontal_speed_limit", "vertical_speed_limit")
    }
    angles = {n: float(np.rad2deg(getattr(lander, n))) for n in ("slope_limit", "tilt_limit")}
    return speeds | angles, ""


def recorded_paths(results: Results) -> list[RecordedPath]:
    """Read the trajectories of recorded flights, at most `MAX_PATHS` per arm.

    Raises
    ------
    InputError
        If a record is damaged.
    """
    found = []
    for arm in results.arms:
        rows = results.table.filter(pc.equal(results.table["arm"], arm))
        flights = zip(rows["flight"].to_pylist(), rows["safe"].to_pylist(), strict=True)
        records = [
            (folder, bool(safe)) for flight, safe in flights
            if (folder := results.folder / "flights" / folder_name(arm) / f"{flight:05d}").is_dir()
        ]  # fmt: skip
        for folder, safe in records[:: max(1, -(-len(records) // MAX_PATHS))]:
            position = read_trajectory(folder, [f"position_{axis}" for axis in "xyz"] + ["time"])
            x, y, z = (position[f"position_{axis}"] for axis in "xyz")
            kept = np.unique(np.linspace(0, len(x) - 1, _MAX_POINTS).astype(int))
            distance = np.hypot(x - x[-1], y - y[-1])
            found.append(RecordedPath(arm, safe, distance[kept], (z - z[-1])[kept]))
    return found
