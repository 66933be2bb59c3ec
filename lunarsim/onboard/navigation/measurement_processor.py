"""Shared context and interface of the measurement processors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from lunarsim.models.instruments import LidarInstrument
from lunarsim.onboard.navigation.aiding_measurements import AidingMeasurements
from lunarsim.onboard.navigation.corrected_scan import (
    DRIFTED_SCANNER_SIGMAS,
    CorrectedScan,
    scanner_block,
    scanner_covariance,
)
from lunarsim.onboard.navigation.error_state import POSE, REFERENCE_POSE, ErrorState
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.inertial import ATTITUDE, POSITION, VELOCITY
from lunarsim.typing import Array, IntArray

# Maximum standard deviation of a rock coordinate after covariance inflation, m.
_MAX_POSITION_SIGMA_M = 100.0


@dataclass(frozen=True)
class FilterContext:
    """Filter state and helper functions that the measurement processors share.

    Attributes
    ----------
    state
        Error state.
    aiding
        Processor of ranges, speeds and attitudes, with all innovation monitors.
    events
        List that receives the events.
    max_sigmas
        Maximum standard deviations (head,) after covariance inflation, from `maximum_sigmas`.
    """

    state: ErrorState
    aiding: AidingMeasurements
    events: list[NavigationEvent]
    max_sigmas: Array

    def scanner_indices(self, sensor: str) -> IntArray:
        """Return the indices of a scanner's five calibration errors in the error state.

        The result is (5,), or (0,) if the state has no errors of this scanner.
        """
        name = scanner_block(sensor)
        if not self.state.has(name):
            return np.zeros(0, np.int64)
        place = self.state.block(name)
        return np.arange(place.start, place.stop)

    def correct_scan(self, sensor: str, scan: Any) -> CorrectedScan:
        """Return a scan with the estimated pose, corrected for estimated scanner errors."""
        name = scanner_block(sensor)
        value = self.state.value(name) if self.state.has(name) else np.zeros(5)
        return CorrectedScan.of(scan, self.state.inertial, value)

    def local_jacobian(self, sensor: str) -> tuple[IntArray, Array]:
        """Return which state errors a scan in the local frame depends on, and a Jacobian.

        The errors are given by their indices (k,). The Jacobian (11, k) converts them to the 11
        errors of a `CorrectedScan`.
        """
        scanner_indices = self.scanner_indices(sensor)
        return np.concatenate((POSE, scanner_indices)), np.eye(11, 6 + len(scanner_indices))

    def record_outcome(self, sensor: str, kind: str, outcome: Any, time: float) -> None:
        """Monitor the outcome of a scan update, and inflate the covariance after an alarm.

        After an alarm the entire state is inflated. The error can be in the current pose, the
        reference pose, the map offset, the rocks or their correlated errors, and errors that were
        not inflated would pull the others back. After a drift the scanner's variances are
        increased. `kind` names the kind of scan update, and `time` is in s.
        """
        scanner_indices, all_indices = self.scanner_indices(sensor), np.arange(self.state.size)
        max_sigmas = np.concatenate(
            (self.max_sigmas, np.full(self.state.tail, _MAX_POSITION_SIGMA_M))
        )
        self.aiding.record_outcome(
            sensor,
            kind,
            outcome,
            all_indices,
            max_sigmas,
            time,
            drift_cause=(scanner_indices, DRIFTED_SCANNER_SIGMAS[: len(scanner_indices)]),
        )


def scanner_blocks(instruments: Mapping[str, Any]) -> dict[str, Array]:
    """Return the initial covariance (5, 5) of each LiDAR's errors, by block name.

    A block is a named group of errors in the error state.
    """
    return {
        scanner_block(name): scanner_covariance(instrument)
        for name, instrument in instruments.items()
        if isinstance(instrument, LidarInstrument)
    }


def maximum_sigmas(state: ErrorState) -> Array:
    """Return the maximum standard deviations (head,) of errors after an inflation.

    The maxima are three times the initial values; for the pose of the lander and the reference
    scan, they are 30 m and 0.2 rad, and 3 m/s for the velocity.
    """
    out = 3.0 * np.sqrt(state.covariance.diagonal()[: state.head])
    out[POSITION], out[VELOCITY], out[ATTITUDE] = 30.0, 3.0, 0.2
    if state.has(REFERENCE_POSE):
        out[state.block(REFERENCE_POSE)] = np.repeat([30.0, 0.2], 3)
    return np.asarray(out)


class MeasurementProcessor(Protocol):
    """Interface of a processor that updates the filter with some measurement types."""

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Process a measurement; return whether the processor used it for an update.

        Parameters
        ----------
        sensor, measurement, time
            Sensor name, its measurement, and time in s.
        used
            Whether an earlier processor has used the measurement; it must not be used twice.
        """
        ...
