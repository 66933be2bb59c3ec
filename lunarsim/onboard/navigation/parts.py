"""What a navigator is made of: parts that share one error state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.navigation.aids import Aids
from lunarsim.onboard.navigation.error_state import POSE, ErrorState
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.inertial import ATTITUDE, POSITION, VELOCITY
from lunarsim.onboard.navigation.local_frame import LocalFrame
from lunarsim.onboard.navigation.seen_scan import LET_GO, SeenScan, scanner_block

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# The pose at the scan that odometry keeps, in the error state.
KEY = "key"


@dataclass(frozen=True)
class Shared:
    """What the parts of a navigator share.

    Attributes
    ----------
    state
        All that errs.
    frame
        Where the site frame lies in the local one.
    aids
        Takes in ranges, speeds and attitudes, and watches over every kind of measurement.
    events
        What is reported.
    most
        Deviations beyond which a doubt widens no error: see `most_of`.
    """

    state: ErrorState
    frame: LocalFrame
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
        """Return a scan as it is seen from where the lander is thought to be, local frame."""
        name = scanner_block(sensor)
        value = self.state.value(name) if self.state.has(name) else np.zeros(5)
        return SeenScan.of(scan, self.state.inertial, value)

    def local_errors(self, sensor: str) -> tuple[Index, Array]:
        """Return on what of the state (k,) a scan's errors depend, and how (11, k), local frame."""
        own = self.scanner(sensor)
        return np.concatenate((POSE, own)), np.eye(11, 6 + len(own))

    def site_errors(self, sensor: str) -> tuple[Index, Array]:
        """Return on what of the state (k,) a scan's errors depend, and how (11, k), site frame."""
        own = self.scanner(sensor)
        out = np.zeros((11, 10 + len(own)))
        out[:6, :10] = self.frame.pose_jacobian()
        out[6:, 10:] = np.eye(5, len(own))
        return np.concatenate((self.frame.pose_columns(), own)), out

    def judge(self, sensor: str, kind: str, outcome: Any, time: float) -> None:
        """Watch what came of a scan.

        Where it is doubted the whole state grows alike: what is wrong is in the pose, the pose at
        the scan kept, the map's place and all that errs with them, and what had not grown would
        draw the rest back. Where it drifts the scanner's errors are let go.
        """
        own, every = self.scanner(sensor), np.arange(self.state.head)
        self.aids.judge(
            sensor, kind, outcome, every, self.most, time, drifting=(own, LET_GO[: len(own)])
        )


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
