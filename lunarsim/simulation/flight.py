"""Record of one descent, in files that other tools can open.

A flight is saved as a folder:

``flight.json``
    Scenario, seed, policy, target, outcome, decisions, events, digests of the other files.
``trajectory.parquet``, ``navigation.parquet``, ``commands.parquet``, ``actuators.parquet``
    True states; estimates with covariance; commands; thrusters and gimbal (pandas, polars, DuckDB).
``readings.NAME.parquet``
    Measurements of a sensor, if they are recorded.
``images.NAME.parquet``, ``images/NAME/000000.png``
    Time, pose and geometry of a camera's images, and the images, if they are recorded.
``maps/NAME.nc``
    The last hazard map of each mapper, NetCDF-4 with coordinates and units (xarray).
``maps/NAME.TABLE.parquet``
    Other data of a mapper, for instance the rocks that it tracks.
``scans.parquet``
    LiDAR returns in the local frame, thinned.
``candidates.parquet``
    Candidate sites of the last decision.

`Flight.load` restores everything exactly, except the covariance of the first map's estimate, which
is not saved.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

import lunarsim
from lunarsim.atomic_files import atomic_write_netcdf, atomic_write_text
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.simulation.columns import (
    CANDIDATES,
    COLUMN_TABLES,
    LOCAL_FRAME,
    MAX_READINGS_BYTES,
    NAVIGATION,
    SCANS,
    SCHEMA_VERSION,
    TRAJECTORY,
    TRUE_FRAME,
    vector_columns,
)
from lunarsim.simulation.flight_files import (
    digest_of,
    read_columns,
    read_layers,
    read_record,
    read_rows,
    read_table,
    read_trajectory,
    reading,
    save_columns,
    save_table,
)
from lunarsim.simulation.image_record import (
    ImageRecord,
    load_images,
    remove_images,
    save_images,
)
from lunarsim.simulation.map_record import MapRecord, map_remarks_by_mapper
from lunarsim.typing import Array
from lunarsim.vehicle.touchdown import LandingOutcome, Touchdown

if TYPE_CHECKING:
    from lunarsim import FlightFigures


# Frames of positions in ``flight.json`` and of the maps.
FRAMES: dict[str, str] = {"target, outcome": TRUE_FRAME, "decisions, events, maps": LOCAL_FRAME}
_LAYERS = {
    "p_safe": "1", "observed": "1", "elevation": "m", "variance": "m2",
    "eligible": "1", "value": "1", "in_domain": "1",
}  # fmt: skip
_BOOLEAN_LAYERS = ("observed", "eligible", "in_domain")

# Events of a range sensor whose beams miss the map, and hit it again.
OFF_MAP, ON_MAP = "beams-off-map", "beams-on-map"


@dataclass
class Flight:
    """Record of one simulated descent: trajectory, events, maps and outcome.

    Attributes
    ----------
    scenario
        Scenario as TOML.
    seed
        Root entropy and spawn key of the flight's seed sequence.
    policy
        Name of the policy.
    outcome
        Landing outcome.
    target
        Target of the mission (3,), true frame, m.
    trajectory
        One value per control cycle (n,) of each column, by name. The site is the one before the
        decision of the cycle.
    navigation
        Estimated state, site frame, and upper triangle of its covariance, at the times of the
        trajectory: columns (n,) by name. Empty in a record of schema version 1, like `commands`
        and `actuators`.
    commands
        Commands and guidance target of each control cycle: columns (n,) by name.
    actuators
        Commands to thrusters and gimbal in each period of the thrusters: columns (n,) by name.
        Empty for a lander without simulated thrusters.
    decisions
        One dictionary per decision that changed the site.
    events
        One dictionary per event: time, name, details.
    maps
        Last map of each mapper that mapped anything, by name.
    decision_mapper
        Name of the mapper whose map the decisions used.
    first_map
        Navigation estimate when a map was first updated, or None; its covariance is not saved.
    scans
        LiDAR returns, local frame, and scan time (n, 4), thinned, float32.
    candidates
        Candidate sites of the last decision (n, 5), float32: position in the local frame, m,
        probability of safe terrain, and propellant, kg.
    readings
        Readings of each recorded sensor that measured at least once: columns (n,) by name, by
        sensor. Recorded are sensors with ``is_recorded`` and, if ``[record] measurements`` is
        true, all sensors except cameras. LiDAR scans and inertial samples have one row per pixel
        or sample.
    images
        Images of each recorded camera that took at least one, by sensor. Recorded are cameras with
        ``is_recorded`` and, if ``[record] images`` is true, all cameras.
    """

    scenario: str
    seed: dict[str, Any]
    policy: str
    outcome: LandingOutcome
    target: Array
    trajectory: dict[str, Array]
    navigation: dict[str, Array] = field(default_factory=dict)
    commands: dict[str, Array] = field(default_factory=dict)
    actuators: dict[str, Array] = field(default_factory=dict)
    decisions: list[dict[str, Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    maps: dict[str, MapRecord] = field(default_factory=dict)
    decision_mapper: str = ""
    first_map: Estimate | None = None
    scans: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 4), np.float32))
    candidates: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 5), np.float32))
    readings: dict[str, dict[str, Array]] = field(default_factory=dict)
    images: dict[str, ImageRecord] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scans = np.asarray(self.scans, dtype=np.float32)
        self.candidates = np.asarray(self.candidates, dtype=np.float32)
        self.decisions = _plain(self.decisions)
        self.events = _plain(self.events)

    @property
    def hazard_map(self) -> HazardMap | None:
        """Last hazard map of the mapper that decisions used; None if it has none."""
        record = self.maps.get(self.decision_mapper)
        return None if record is None else record.hazard_map

    @property
    def map_error(self) -> Array:
        """Local minus true coordinates (3,), m, of the map that decisions used.

        It is zero if there is no such map.
        """
        record = self.maps.get(self.decision_mapper)
        return np.zeros(3) if record is None else record.error

    @property
    def positions(self) -> Array:
        """True position of the lander at each control cycle (n, 3), m."""
        return vector_columns(self.trajectory, "position")

    @property
    def sites(self) -> Array:
        """Landing site before the decision of each control cycle (n, 3), local frame, m."""
        return vector_columns(self.trajectory, "site")

    @property
    def propellant_used(self) -> float:
        """Propellant used during the flight, kg."""
        mass = self.trajectory["mass"]
        return float(mass[0] - mass[-1])

    @property
    def duration(self) -> float:
        """Duration of the flight, s."""
        return float(self.trajectory["time"][-1])

    @property
    def lost(self) -> bool:
        """Whether navigation reported at the end of the flight that it was lost."""
        return bool(self.trajectory["lost"][-1])

    @property
    def first_lost_time(self) -> float | None:
        """Time at which navigation first reported that it was lost, s; None if never."""
        rows = np.flatnonzero(self.trajectory["lost"])
        return float(self.trajectory["time"][rows[0]]) if len(rows) else None

    @property
    def divert_distance(self) -> float:
        """Horizontal distance from the site before the first divert to the last site, m.

        It is 0 without a divert.
        """
        if not self.decisions:
            return 0.0
        first, last = self.decisions[0]["from"], self.decisions[-1]["to"]
        return float(np.hypot(last[0] - first[0], last[1] - first[1]))

    def __str__(self) -> str:
        outcome = self.outcome
        facts = self._facts()
        width = max(len(name) for name, _ in facts)
        lines = [
            "landed safely" if outcome.safe else "not safe: " + ", ".join(outcome.failure_causes)
        ]
        lines += [f"  {name:{width}}  {value}" for name, value in facts]
        if self.decisions:
            lines.append("diverts (east, north in m; local frame):")
        for decision in self.decisions:
            east, north = decision["to"][:2]
            lines.append(
                f"{decision['time']:6.1f} s  to ({east:.1f}, {north:.1f}): {decision['reason']}"
            )
        return "\n".join(lines)

    def _facts(self) -> list[tuple[str, str]]:
        """Return pairs of name and value of the main results, for the text of the flight."""
        facts = [
            ("time of flight", f"{self.duration:.1f} s"),
            ("propellant", f"{self.propellant_used:.1f} kg"),
            ("divert", f"{self.divert_distance:.1f} m"),
        ]
        if self.first_lost_time is not None:
            end = "not recovered" if self.lost else "recovered later"
            facts.append(("navigation", f"lost at {self.first_lost_time:.1f} s, {end}"))
        beyond = _map_edge_remark(self.events, self.duration)
        if beyond is not None:
            facts.append(("no returns", beyond))
        facts += [
            (f"map {name!r}", words)
            for name, words in map_remarks_by_mapper(self.maps, self.decision_mapper).items()
        ]
        facts += [
            ("software", f"{e['role']}: {e['reason']}: {e['detail']}")
            for e in self.events
            if e["name"] == "software-failed"
        ]
        touchdown = self.outcome.touchdown
        if touchdown is not None:
            x, y = touchdown.position[:2]
            facts += [
                ("touchdown", f"({x:.1f}, {y:.1f}) m (east, north; true frame)"),
                ("vertical speed", f"{touchdown.vertical_speed:.2f} m/s"),
                ("horizontal speed", f"{touchdown.horizontal_speed:.2f} m/s"),
                ("tilt at contact", f"{np.rad2deg(touchdown.tilt):.1f} deg"),
                ("slope under the legs", f"{np.rad2deg(touchdown.slope):.1f} deg"),
                ("roughness under the belly", f"{touchdown.roughness:.2f} m"),
                ("tip-over margin", f"{touchdown.tip_margin:.2f}"),
            ]
        return facts

    def plot(self) -> FlightFigures:
        """Plot descent, maps and touchdown; a notebook shows the three figures.

        The terrain is generated again from the scenario and the seed of the record.

        Raises
        ------
        InputError
            If the terrain cannot be generated, for instance because a raster file is missing.
        """
        return lunarsim.plot_flight(self)

    # --- files ----------------------------------------------------------------------------

    def save(self, folder: str | Path) -> Path:
        """Write the record of the flight into `folder`; return the folder.

        The folder is created if it does not exist.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        # Maps and tables of an earlier flight in this folder.
        tables = [folder / f"{table.name}.parquet" for table in COLUMN_TABLES]
        for old in [*(folder / "maps").glob("*"), *folder.glob("readings.*.parquet"), *tables]:
            old.unlink(missing_ok=True)
        remove_images(folder)
        for table in COLUMN_TABLES:
            if columns := getattr(self, table.name):
                save_columns(table, columns, folder)
        for table in (SCANS, CANDIDATES):
            save_columns(table, table.as_columns(getattr(self, table.name)), folder)
        for name, columns in self.readings.items():
            save_table(pa.table(columns), folder / f"readings.{name}.parquet")
        image_files = [save_images(folder, name, images) for name, images in self.images.items()]
        for name, record in self.maps.items():
            _save_map(name, record, folder / "maps")
        written = {*folder.glob("*.parquet"), *(folder / "maps").glob("*"), *chain(*image_files)}
        digests = {str(path.relative_to(folder)): digest_of(path) for path in sorted(written)}
        text = json.dumps(self._record() | {"digests": digests}, indent=1)
        atomic_write_text(folder / "flight.json", text)
        return folder

    def _record(self) -> dict[str, Any]:
        """Return the content of ``flight.json`` without the digests of the other files."""
        first = self.first_map
        return {
            # A record that was loaded from version 1 has no estimates.
            "schema_version": SCHEMA_VERSION if self.navigation else 1,
            "tables": [table.name for table in COLUMN_TABLES if getattr(self, table.name)],
            "frames": FRAMES,
            "scenario": self.scenario,
            "seed": self.seed,
            "policy": self.policy,
            "target": _plain(self.target),
            "outcome": _plain(asdict(self.outcome)),
            "decisions": self.decisions,
            "events": self.events,
            "decision_mapper": self.decision_mapper,
            "maps": list(self.maps),
            "readings": list(self.readings),
            "images": list(self.images),
            "first_map": None if first is None else _plain(asdict(first) | {"covariance": None}),
            "lost": self.lost,
            "first_lost_s": self.first_lost_time,
            "propellant_used_kg": self.propellant_used,
            "divert_distance_m": self.divert_distance,
            "duration_s": self.duration,
        }

    @classmethod
    def load(cls, folder: str | Path) -> Flight:
        """Read the record of a flight from a folder that `save` has written.

        Raises
        ------
        InputError
            If the folder holds no flight, or one of its files is damaged.
        """
        folder = Path(folder)
        record = read_record(folder)
        first = record["first_map"]
        trajectory = read_trajectory(folder, list(TRAJECTORY.columns()))
        rows = {NAVIGATION: len(trajectory["time"])}
        with reading(folder / "flight.json"):
            return cls(
                scenario=record["scenario"],
                seed=record["seed"],
                policy=record["policy"],
                outcome=_landing_outcome(record["outcome"]),
                target=_target(record["target"]),
                trajectory=trajectory,
                **{
                    table.name: read_table(folder, table, rows.get(table))
                    for table in COLUMN_TABLES
                    if table is not TRAJECTORY and table.name in record.get("tables", [])
                },
                decisions=record["decisions"],
                events=record["events"],
                maps={name: _load_map(name, folder) for name in record["maps"]},
                decision_mapper=record["decision_mapper"],
                first_map=None if first is None else _estimate(first),
                scans=read_rows(folder, SCANS.name, list(SCANS.columns())),
                candidates=read_rows(folder, CANDIDATES.name, list(CANDIDATES.columns())),
                readings={
                    # Encoded, a table may be larger than its numbers.
                    name: read_columns(
                        folder,
                        folder / f"readings.{name}.parquet",
                        max_bytes=2 * MAX_READINGS_BYTES,
                    )
                    for name in record.get("readings", [])
                },
                images={name: load_images(folder, name) for name in record.get("images", [])},
            )


def _plain(value: Any) -> Any:
    """Return nested data with NumPy arrays and numbers as lists and Python numbers."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value


def _target(record: Any) -> Array:
    """Return the target (3,), m, from its entry in ``flight.json``."""
    target = np.array(record, dtype=np.float64)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise ValueError(f"target must be three finite numbers, not {record}")
    return target


def _landing_outcome(record: dict[str, Any]) -> LandingOutcome:
    """Build a landing outcome from its entry in ``flight.json``."""
    touchdown = record["touchdown"]
    if touchdown is not None:
        touchdown = Touchdown(**touchdown | {"position": np.array(touchdown["position"])})
    return LandingOutcome(record["safe"], tuple(record["failure_causes"]), touchdown)


def _estimate(record: dict[str, Any]) -> Estimate:
    """Build an estimate from its entry in ``flight.json``, with a covariance of NaN."""
    position, velocity, attitude, rate = (
        np.array(record[k]) for k in ("position", "velocity", "attitude", "rate")
    )
    unknown = np.full((9, 9), np.nan)
    lost = bool(record.get("lost", False))
    return Estimate(
        record["time"], position, velocity, attitude, rate, record["mass"], unknown, lost
    )


def _save_map(name: str, record: MapRecord, folder: Path) -> None:
    """Write the last map of a mapper as NetCDF, and its tables as Parquet files."""
    import xarray as xr  # noqa: PLC0415  (loads slowly)

    folder.mkdir(exist_ok=True)
    m, grid = record.hazard_map, record.hazard_map.grid
    layers = {
        layer: (
            ("y", "x"),
            data.astype(np.int8) if layer in _BOOLEAN_LAYERS else data,
            {"units": unit},
        )
        for layer, unit in _LAYERS.items()
        if (data := getattr(m, layer)) is not None
    }
    dataset = xr.Dataset(
        layers,
        {"x": ("x", grid.x, {"units": "m"}), "y": ("y", grid.y, {"units": "m"})},
        {
            "frame": "local ENU; subtract navigation_error_m for the true frame",
            "posting_m": grid.posting,
            "x0_m": grid.x0,
            "y0_m": grid.y0,
            "navigation_error_m": np.asarray(record.error),
            **({} if record.time is None else {"time_s": record.time}),
        },
    )
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    atomic_write_netcdf(folder / f"{name}.nc", dataset, dict.fromkeys(layers, packed))
    for table, columns in record.tables.items():
        save_table(pa.table(columns), folder / f"{name}.{table}.parquet")


def _load_map(name: str, folder: Path) -> MapRecord:
    """Read the last map of a mapper and its tables from the folder of a flight."""
    path = folder / "maps" / f"{name}.nc"
    grid, layers, error, time = read_layers(folder, path, list(_LAYERS), _BOOLEAN_LAYERS)
    tables = {
        table.name.removeprefix(f"{name}.").removesuffix(".parquet"): read_columns(folder, table)
        for table in sorted(path.parent.glob(f"{name}.*.parquet"))
    }
    with reading(path):
        return MapRecord(HazardMap(grid, **layers), error, tables, time)


def _map_edge_remark(events: list[dict[str, Any]], duration: float) -> str | None:
    """Return in words how long range sensors missed the map; None: never.

    `events` are those of a flight, and `duration` is its duration, s.
    """
    seconds: dict[str, float] = {}
    for event in events:
        if event["name"] in (OFF_MAP, ON_MAP):
            sign = -1.0 if event["name"] == OFF_MAP else 1.0
            seconds[event["sensor"]] = seconds.get(event["sensor"], 0.0) + sign * event["time"]
    # A sensor that still misses the map at the end has a negative sum.
    total = {name: s if s > 0.0 else s + duration for name, s in seconds.items()}
    named = ", ".join(f"{name} {s:.1f} s" for name, s in total.items())
    return f"{named}: beams miss the map (add [far_terrain])" if named else None
