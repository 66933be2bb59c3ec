"""Model noise and delay of observations, and delay of actions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunarsim_envs.descent import _kernels as k
from lunarsim_envs.descent.batch import DescentBatch
from lunarsim_envs.descent.observations import ObservationLayout

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class DelayLine:
    """Delay the observation or command vectors of n landers by individual delays.

    Parameters
    ----------
    lanes, size
        Batch of n landers, and length of the vectors.
    place
        Column of `DescentBatch.drawn` that has the delays, s. Delays are rounded to multiples of
        the step.
    most, period
        Maximum delay and duration of a step, s.
    """

    def __init__(
        self, lanes: DescentBatch, size: int, place: int, most: float, period: float
    ) -> None:
        self._lanes, self._place, self._period = lanes, place, period
        self._kept = np.zeros((round(most / period) + 1, lanes.count, size))
        self._rows = np.arange(lanes.count)

    def begin(self, mask: Mask, row: Array) -> None:
        """Fill the delay line of landers `mask` (n,) with constant vectors (n, size)."""
        self._kept[:, mask] = row[mask]

    def put(self, mask: Mask, row: Array) -> None:
        """Insert the vectors (n, size) of this step for the landers of `mask` (n,)."""
        self._kept[1:, mask] = self._kept[:-1, mask]
        self._kept[0, mask] = row[mask]

    @property
    def rows(self) -> Array:
        """Delayed vectors of the current step (n, size)."""
        steps = np.round(self._lanes.drawn[:, self._place] / self._period).astype(int)
        return np.asarray(self._kept[steps, self._rows])


class SensingModel:
    """Add noise and delay to observations, and delay to actions.

    Parameters
    ----------
    lanes, shown
        Batch of landers whose `VehicleParams.domain_randomization` is set, and the observation
        components.
    period
        Duration of a step, s.
    idle
        Command that applies before the first delayed action (size,).
    """

    def __init__(
        self, lanes: DescentBatch, shown: ObservationLayout, period: float, idle: Array
    ) -> None:
        varied = lanes.craft.domain_randomization
        assert varied is not None
        self._lanes, self._shown = lanes, shown
        self._idle = np.tile(idle, (lanes.count, 1))
        width = shown.space.shape[0]
        self._seen = DelayLine(lanes, width, k.SEES_LATE, varied.sensing_delay, period)
        self._asked = DelayLine(lanes, len(idle), k.ACTS_LATE, varied.actuation_delay, period)
        self._noise = [
            (shown.places[name], sigma, name == "attitude")
            for name, sigma in varied.noise.items() if sigma > 0.0 and name in shown.places
        ]  # fmt: skip

    def begin(self, mask: Mask) -> None:
        """Take the first observations of the new flights of the landers of `mask` (n,)."""
        self._seen.begin(mask, self._look(mask))
        self._asked.begin(mask, self._idle)

    def look(self, mask: Mask) -> None:
        """Take a new noisy observation of the landers of `mask` (n,) into the delay line."""
        self._seen.put(mask, self._look(mask))

    def act(self, mask: Mask, physical: Array) -> Array:
        """Insert commands (n, size) of landers `mask` (n,); return the delayed commands."""
        self._asked.put(mask, physical)
        return self._asked.rows

    @property
    def seen(self) -> NDArray[np.float32]:
        """Delayed, noisy observations of all landers (n, size)."""
        return self._seen.rows.astype(np.float32)

    def _look(self, mask: Mask) -> Array:
        """Return the undelayed observations (n, size), with noise for landers `mask`."""
        found = self._shown.of(self._lanes).astype(np.float64)
        if not self._noise:
            return found
        drawn = self._lanes.normals(mask, 3 * len(self._noise))[mask]
        mine = found[mask]
        for i, (place, sigma, turned) in enumerate(self._noise):
            error = sigma * drawn[:, 3 * i : 3 * i + 3]
            if turned:
                mine[:, place] = _turned(mine[:, place], error)
            else:
                mine[:, place] += error
        found[mask] = np.clip(mine, self._shown.space.low, self._shown.space.high)
        return found


def _turned(attitude: Array, error: Array) -> Array:
    """Rotate attitudes (n, 4) by small rotation vectors (n, 3) in body axes, rad."""
    return np.asarray((Rotation.from_quat(attitude) * Rotation.from_rotvec(error)).as_quat())
