"""Collects what happens in a flight."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.measurements import LidarScan, Picture
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.contract import Candidates, Decision
from lunarsim.simulation.flight import COLUMNS
from lunarsim.vehicle.state import State

Array = NDArray[np.float64]

# LiDAR returns kept of each scan: enough to draw it.
_KEPT_RETURNS = 4096
# Least time between two scans kept, s.
_SCAN_INTERVAL = 0.5
# Measurements of a sensor closer than this in time are one run, s.
_RUN = 1.0


class Recorder:
    """Rows, events, decisions and scans of one flight."""

    def __init__(self) -> None:
        self._rows: list[Array] = []
        self._scans: list[Array] = []
        self._seen: list[dict[str, Any]] = []
        self._last: dict[str, float] = {}

    def row(
        self,
        time: float,
        state: State,
        estimate: Estimate,
        site: Array,
        time_to_go: float,
        phase: int,
    ) -> None:
        """Add a row of the trajectory."""
        self._rows.append(
            np.concatenate(
                (
                    [time],
                    state.as_vector(),
                    estimate.position,
                    estimate.velocity,
                    site,
                    [time_to_go, phase],
                )
            )
        )

    def events(self, telemetry: list[tuple[float, str, dict[str, Any]]]) -> list[dict[str, Any]]:
        """Return what happened, each as a dictionary."""
        told = [{"time": time, "name": name, **details} for time, name, details in telemetry]
        return sorted(self._seen + told, key=lambda event: float(event["time"]))

    def decisions(self, diverts: list[tuple[float, Array, Decision]]) -> list[dict[str, Any]]:
        """Return the decisions that changed the site, each as a dictionary."""
        return [
            {"time": time, "from": old, "to": new.site, "reason": new.reason, **new.details}
            for time, old, new in diverts
        ]

    def choice(self, candidates: Candidates | None) -> Array:
        """Return the sites that the policy chose from last (n, 5)."""
        if candidates is None:
            return np.zeros((0, 5))
        return np.column_stack((candidates.position, candidates.p_safe, candidates.propellant))

    def measurement(
        self, sensor: str, measurement: Any, estimate: Estimate, altitude: float
    ) -> None:
        """Note the first of a run of scans or pictures, and keep some returns of scans."""
        if isinstance(measurement, LidarScan):
            self._keep(measurement, estimate)
        elif not isinstance(measurement, Picture):
            return
        time = measurement.time
        if time > self._last.get(sensor, -np.inf) + _RUN:
            name = "scan" if isinstance(measurement, LidarScan) else "picture"
            self._seen.append({"time": time, "name": name, "sensor": sensor, "altitude": altitude})
        self._last[sensor] = time

    def _keep(self, scan: LidarScan, estimate: Estimate) -> None:
        """Keep a thinned copy of a scan, as the lander placed it, two a second at the most."""
        if self._scans and scan.time < self._scans[-1][0, 3] + _SCAN_INTERVAL - 1e-9:
            return
        points = scan.points(estimate.position, estimate.attitude)
        points = points[np.isfinite(points).all(axis=1)]
        points = points[:: max(1, len(points) // _KEPT_RETURNS)]
        if len(points):
            self._scans.append(np.column_stack((points, np.full(len(points), scan.time))))

    @property
    def scans(self) -> Array:
        """All kept returns (n, 4)."""
        return np.concatenate(self._scans) if self._scans else np.zeros((0, 4))

    def trajectory(self) -> dict[str, Array]:
        """Return the rows as columns."""
        table = np.array(self._rows)
        return {name: table[:, i].copy() for i, name in enumerate(COLUMNS)}
