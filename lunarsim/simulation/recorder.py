"""Collects what happens in a flight."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.contract import Candidates, Decision
from lunarsim.simulation.flight import COLUMNS
from lunarsim.vehicle.state import State

Array = NDArray[np.float64]

# LiDAR returns kept of each scan: enough to draw it.
_KEPT_RETURNS = 4096


class Recorder:
    """Rows, events, decisions and scans of one flight."""

    def __init__(self) -> None:
        self._rows: list[Array] = []
        self._scans: list[Array] = []
        self.events: list[dict[str, Any]] = []
        self.decisions: list[dict[str, Any]] = []
        self.candidates = np.zeros((0, 5))

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

    def event(self, time: float, name: str, **details: Any) -> None:
        """Note that something happened."""
        self.events.append({"time": time, "name": name, **details})

    def decision(self, time: float, old: Array, decision: Decision) -> None:
        """Note a decision that changed the site."""
        self.decisions.append(
            {
                "time": time,
                "from": old,
                "to": decision.site,
                "reason": decision.reason,
                **decision.details,
            }
        )

    def choice(self, candidates: Candidates) -> None:
        """Keep the sites that the policy chooses from, in place of the last ones."""
        self.candidates = np.column_stack(
            (candidates.position, candidates.p_safe, candidates.propellant)
        )

    def scan(self, scan: LidarScan, estimate: Estimate) -> None:
        """Keep a thinned copy of a scan, as the lander placed it."""
        points = scan.points(estimate.position, estimate.attitude)
        points = points[np.isfinite(points).all(axis=1)]
        points = points[:: max(1, len(points) // _KEPT_RETURNS)]
        self._scans.append(np.column_stack((points, np.full(len(points), scan.time))))

    @property
    def scans(self) -> Array:
        """All kept returns (n, 4)."""
        return np.concatenate(self._scans) if self._scans else np.zeros((0, 4))

    def trajectory(self) -> dict[str, Array]:
        """Return the rows as columns."""
        table = np.array(self._rows)
        return {name: table[:, i].copy() for i, name in enumerate(COLUMNS)}
