"""What filters are made of: parts that share one error state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.instruments import LidarInstrument
from lunarsim.onboard.navigation.aids import Aids
from lunarsim.onboard.navigation.error_state import KEY, POSE, ErrorState
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.inertial import ATTITUDE, POSITION, VELOCITY
from lunarsim.onboard.navigation.seen_scan import (
    LET_GO,
    SeenScan,
    scanner_block,
    scanner_covariance,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Standard deviation beyond which a doubt widens no coordinate of a rock, m.
_MOST_PLACE = 100.0


@dataclass(frozen=True)
class Shared:
    """What the parts of a filter share.

    Attributes
    ----------
    state
        All that errs.
    aids
        Takes in ranges, speeds and attitudes, and watches over every kind of measurement.
    events
        What is reported.
    most
        Deviations beyond which a doubt widens no error: see `most_of`.
    """

    state: ErrorState
    aids: Aids
    events: list[NavigationEvent]
    most: Array

    def scanner(self, sensor: str) -> Index:
        """Return where a scanner's errors lie in the state (5,), or (0,) if it has none."""
        name = scanner_block(sensor)
        if not self.state.has(name):
            return np.zeros(0, np.int64)
        place = self.state.block(name)
        return np.arange(place.start, place.stop)

    def seen(self, sensor: str, scan: Any) -> SeenScan:
        """Return a scan as it is seen from where the lander is thought to be, the state's frame."""
        name = scanner_block(sensor)
        value = self.state.value(name) if self.state.has(name) else np.zeros(5)
        return SeenScan.of(scan, self.state.inertial, value)

    def local_errors(self, sensor: str) -> tuple[Index, Array]:
        """Return on what of the state (k,) a scan's errors depend, and how (11, k), its frame."""
        own = self.scanner(sensor)
        return np.concatenate((POSE, own)), np.eye(11, 6 + len(own))

    def judge(self, sensor: str, kind: str, outcome: Any, time: float) -> None:
        """Watch what came of a scan.

        Where it is doubted the whole state grows alike: what is wrong is in the pose, the pose at
        the scan kept, the map's place, rocks and all that errs with them, and what had not grown
        would draw the rest back. Where it drifts the scanner's errors are let go.
        """
        own, every = self.scanner(sensor), np.arange(self.state.size)
        most = np.concatenate((self.most, np.full(self.state.tail, _MOST_PLACE)))
        self.aids.judge(
            sensor, kind, outcome, every, most, time, drifting=(own, LET_GO[: len(own)])
        )


def scanner_blocks(instruments: Mapping[str, Any]) -> dict[str, Array]:
    """Return the blocks of what the LiDARs among instruments, by name, err by."""
    return {
        scanner_block(name): scanner_covariance(instrument)
        for name, instrument in instruments.items()
        if isinstance(instrument, LidarInstrument)
    }


def most_of(state: ErrorState) -> Array:
    """Return deviations (head,) beyond which a doubt widens no error: thrice those at the start.

    Position, velocity and attitude of the lander, and a pose kept, at least 30 m, 3 m/s, 0.2 rad.
    """
    out = 3.0 * np.sqrt(state.covariance.diagonal()[: state.head])
    out[POSITION], out[VELOCITY], out[ATTITUDE] = 30.0, 3.0, 0.2
    if state.has(KEY):
        out[state.block(KEY)] = np.repeat([30.0, 0.2], 3)
    return np.asarray(out)


class Part(Protocol):
    """One of a navigator's ways of taking in measurements."""

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool) -> bool:
        """Take in a measurement; return whether what it says has been used.

        Parameters
        ----------
        sensor, measurement, time
            What was measured, s.
        used
            Whether an earlier part has used it: it must not count twice.
        """
        ...
