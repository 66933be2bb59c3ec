"""Model noise and delay of observations, and delay of actions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunarsim.typing import Array, BoolArray
from lunarsim_envs.descent import _kernels as k
from lunarsim_envs.descent.batch import DescentBatch
from lunarsim_envs.descent.observations import ObservationLayout


class DelayLine:
    """Delay the observation or command vectors of n landers by individual delays.

    Parameters
    ----------
    lanes, size
        Batch of n landers, and length of the vectors.
    delay_column
        Column of `DescentBatch.randomized` that has the delays, s, which are rounded to steps.
    max_delay, period
        Maximum delay and duration of a step, s.
    """

    def __init__(
        self, lanes: DescentBatch, size: int, delay_column: int, max_delay: float, period: float
    ) -> None:
        self._lanes, self._place, self._period = lanes, delay_column, period
        self._kept = np.zeros((round(max_delay / period) + 1, lanes.count, size))
        self._rows = np.arange(lanes.count)

    def begin(self, mask: BoolArray, vectors: Array) -> None:
        """Fill the delay lines of landers `mask` (n,) with constant vectors (n, size)."""
        self._kept[:, mask] = vectors[mask]

    def insert(self, mask: BoolArray, vectors: Array) -> None:
        """Insert the vectors (n, size) of this step for the landers of `mask` (n,)."""
        self._kept[1:, mask] = self._kept[:-1, mask]
        self._kept[0, mask] = vectors[mask]

    @property
    def delayed(self) -> Array:
        """Delayed vectors of the current step (n, size)."""
        steps = np.round(self._lanes.randomized[:, self._place] / self._period).astype(int)
        return np.asarray(self._kept[steps, self._rows])


class SensingModel:
    """Add noise and delay to observations, and delay to actions.

    Parameters
    ----------
    lanes, layout
        Batch of landers whose `VehicleParams.domain_randomization` is set, and the observation
        components.
    period
        Duration of a step, s.
    initial_command
        Command that applies before the first delayed action (size,).
    """

    def __init__(
        self, lanes: DescentBatch, layout: ObservationLayout, period: float, initial_command: Array
    ) -> None:
        varied = lanes.craft.domain_randomization
        assert varied is not None
        self._lanes, self._shown = lanes, layout
        self._idle = np.tile(initial_command, (lanes.count, 1))
        width = layout.space.shape[0]
        self._seen = DelayLine(lanes, width, k.SEES_LATE, varied.sensing_delay, period)
        self._asked = DelayLine(
            lanes, len(initial_command), k.ACTS_LATE, varied.actuation_delay, period
        )
        self._noise = [
            (layout.places[name], sigma, name == "attitude")
            for name, sigma in varied.noise.items() if sigma > 0.0 and name in layout.places
        ]  # fmt: skip

    def begin(self, mask: BoolArray) -> None:
        """Reset the delay lines of landers `mask` (n,), whose flights have just started."""
        self._seen.begin(mask, self._noisy_observations(mask))
        self._asked.begin(mask, self._idle)

    def observe(self, mask: BoolArray) -> None:
        """Insert new noisy observations of landers `mask` (n,) in their delay lines."""
        self._seen.insert(mask, self._noisy_observations(mask))

    def act(self, mask: BoolArray, physical: Array) -> Array:
        """Insert commands (n, size) of landers `mask` (n,); return the delayed commands."""
        self._asked.insert(mask, physical)
        return self._asked.delayed

    @property
    def delayed_observations(self) -> NDArray[np.float32]:
        """Delayed, noisy observations of all landers (n, size)."""
        return self._seen.delayed.astype(np.float32)

    def _noisy_observations(self, mask: BoolArray) -> Array:
        """Return the undelayed observations (n, size), with noise for landers `mask`."""
        found = self._shown.of(self._lanes).astype(np.float64)
        if not self._noise:
            return found
        samples = self._lanes.normals(mask, 3 * len(self._noise))[mask]
        noisy = found[mask]
        for i, (place, sigma, turned) in enumerate(self._noise):
            error = sigma * samples[:, 3 * i : 3 * i + 3]
            if turned:
                noisy[:, place] = _rotated(noisy[:, place], error)
            else:
                noisy[:, place] += error
        found[mask] = np.clip(noisy, self._shown.space.low, self._shown.space.high)
        return found


def _rotated(attitude: Array, error: Array) -> Array:
    """Rotate attitudes (n, 4) by small rotation vectors (n, 3) in body axes, rad."""
    return np.asarray((Rotation.from_quat(attitude) * Rotation.from_rotvec(error)).as_quat())
