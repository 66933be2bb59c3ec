"""`Flight`: the record of one descent, in files that other tools open.

A flight is saved as one folder:

``flight.json``
    Scenario, seed, policy, verdict, decisions, events.
``trajectory.parquet``
    One row a control cycle (pandas, polars, DuckDB).
``hazard_map.nc``
    The last hazard map, NetCDF-4 with coordinates and units (xarray).
``scans.parquet``
    LiDAR returns in the estimated frame, thinned.
``candidates.parquet``
    Sites that the policy chose from at the last decision.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.vehicle.touchdown import Verdict

Array = NDArray[np.float64]

# Columns of the trajectory and their units, in order.
COLUMNS: dict[str, str] = {
    "time": "s",
    **{f"position_{a}": "m" for a in "xyz"},
    **{f"velocity_{a}": "m/s" for a in "xyz"},
    **{f"attitude_{a}": "1" for a in "xyzw"},
    **{f"rate_{a}": "rad/s" for a in "xyz"},
    "mass": "kg",
    "thrust": "N",
    **{f"estimated_{a}": "m" for a in "xyz"},
    **{f"estimated_velocity_{a}": "m/s" for a in "xyz"},
    **{f"site_{a}": "m" for a in "xyz"},
    "time_to_go": "s",
    "phase": "0 approach, 1 vertical descent",
}


@dataclass
class Flight:
    """The record of one descent.

    Attributes
    ----------
    scenario
        The scenario as TOML.
    seed
        Root entropy and spawn key of the flight's seed sequence.
    policy
        Name of the policy.
    verdict
        How it ended.
    trajectory
        Columns (n,) by name; see `COLUMNS`.
    decisions
        One dictionary a decision that changed the site.
    events
        One dictionary an event: time, name, details.
    hazard_map
        The last map, or None if nothing was mapped.
    map_error
        Estimated minus true position when the map was last drawn (3,), m.
    scans
        LiDAR returns, estimated ENU and scan time (n, 4), thinned.
    candidates
        Sites at the last decision: estimated ENU, p_safe, propellant (n, 5).
    """

    scenario: str
    seed: dict[str, Any]
    policy: str
    verdict: Verdict
    trajectory: dict[str, Array]
    decisions: list[dict[str, Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    hazard_map: HazardMap | None = None
    map_error: Array = field(default_factory=lambda: np.zeros(3))
    scans: Array = field(default_factory=lambda: np.zeros((0, 4)))
    candidates: Array = field(default_factory=lambda: np.zeros((0, 5)))

    @property
    def positions(self) -> Array:
        """True positions (n, 3), m."""
        return np.column_stack([self.trajectory[f"position_{a}"] for a in "xyz"])

    @property
    def propellant_used(self) -> float:
        """Propellant burnt, kg."""
        mass = self.trajectory["mass"]
        return float(mass[0] - mass[-1])

    @property
    def duration(self) -> float:
        """Time of flight, s."""
        return float(self.trajectory["time"][-1])

    @property
    def divert_distance(self) -> float:
        """Distance over the ground from the first site to the last, m."""
        x, y = self.trajectory["site_x"], self.trajectory["site_y"]
        return float(np.hypot(x[-1] - x[0], y[-1] - y[0]))

    def save(self, folder: str | Path) -> Path:
        """Write the flight into `folder`, which is made; return it."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        table = pa.table({name: self.trajectory[name] for name in COLUMNS})
        units = {f"unit:{name}": unit for name, unit in COLUMNS.items()}
        pq.write_table(table.replace_schema_metadata(units), folder / "trajectory.parquet")
        for name, columns in (
            ("scans", ("x", "y", "z", "time")),
            ("candidates", ("x", "y", "z", "p_safe", "propellant")),
        ):
            data = getattr(self, name).astype(np.float32)
            cloud = pa.table({column: data[:, i] for i, column in enumerate(columns)})
            pq.write_table(cloud, folder / f"{name}.parquet")
        if self.hazard_map is not None:
            _save_map(self.hazard_map, self.map_error, folder / "hazard_map.nc")
        record = {
            "scenario": self.scenario,
            "seed": self.seed,
            "policy": self.policy,
            "verdict": _plain(asdict(self.verdict)),
            "decisions": _plain(self.decisions),
            "events": _plain(self.events),
            "propellant_used_kg": self.propellant_used,
            "divert_distance_m": self.divert_distance,
            "duration_s": self.duration,
        }
        (folder / "flight.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
        return folder


def _plain(value: Any) -> Any:
    """Return `value` with arrays as lists, for JSON."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value


def _save_map(hazard_map: HazardMap, error: Array, path: Path) -> None:
    grid = hazard_map.grid
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"y": grid.rows, "x": grid.cols}
        file.attrs["posting_m"] = grid.posting
        file.attrs["navigation_error_m"] = np.asarray(error)
        file.attrs["frame"] = "estimated ENU; subtract navigation_error_m for the true frame"
        for name, values in (("x", grid.x), ("y", grid.y)):
            axis = file.create_variable(name, (name,), data=values)
            axis.attrs["units"] = "m"
        layers: dict[str, tuple[Any, str]] = {
            "p_safe": (hazard_map.p_safe, "1"),
            "observed": (hazard_map.observed.astype(np.int8), "1"),
            "elevation": (hazard_map.elevation, "m"),
            "variance": (hazard_map.variance, "m2"),
        }
        for name, (data, unit) in layers.items():
            if data is None:
                continue
            if data.dtype == np.float32:
                # 16 significant bits are beyond any sensor here and compress far better.
                stored = (data.view(np.uint32) & np.uint32(0xFFFFFF00)).view(np.float32)
            else:
                stored = data
            layer = file.create_variable(
                name, ("y", "x"), data=stored, compression="gzip", compression_opts=1, shuffle=True
            )
            layer.attrs["units"] = unit
