"""Detection and false-alarm probabilities of tracked rocks in elevation samples.

A rock that was hit by enough samples shows a residual height of half its own height with a known
probability. By chance, any other place of the map shows one with the false-alarm probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.typing import Array

# Share of samples that count as independent: samples of a cell are averaged, and neighbours share
# errors.
INDEPENDENT_SHARE = 0.5
# A rock is compared with the maximum residual height within this distance, m, if it exceeds this
# share of the rock height. A half ellipsoid is that high over this share of its area.
_SEARCH_DISTANCE_M, _VISIBLE_SHARE, _TOP_AREA_SHARE = 0.35, 0.5, 0.75
# Probability that a rock is where its track is.
_CORRECT_POSITION_PROBABILITY = 0.8
_MIN_FALSE_ALARM = 1e-3


@dataclass(frozen=True)
class RockDetectability:
    """Detection and false-alarm probabilities of each rock in elevation samples.

    A rock is detected if the residual height (above a plane fitted to the terrain) of a sample near
    it reaches `min_residual`.

    Attributes
    ----------
    min_residual
        Minimum residual height that counts as a detection of each rock (n,), m.
    detection_probability
        Probability that the samples show the rock, if there is a rock (n,).
    false_alarm_probability
        Probability that a residual height of at least `min_residual` occurs near an arbitrary place
        (n,).
    """

    min_residual: Array
    detection_probability: Array
    false_alarm_probability: Array

    @property
    def rise_probability(self) -> Array:
        """Probability that `min_residual` is reached at a true rock, also by chance (n,)."""
        return np.asarray(
            self.detection_probability
            + (1.0 - self.detection_probability) * self.false_alarm_probability
        )


@dataclass(frozen=True)
class ElevationSamples:
    """Residual heights and density of elevation samples, to test for tracked rocks.

    Attributes
    ----------
    residual_heights
        Height of the sample of each cell above a plane fitted to the terrain around it (rows,
        cols), m; NaN without a sample.
    density
        Samples per square metre (rows, cols).
    grid
        Cells of `residual_heights` and `density`.
    height_ratio
        Ratio of height to diameter of the rocks expected by the mission.
    """

    residual_heights: NDArray[np.float32]
    density: Array
    grid: Grid
    height_ratio: float

    @cached_property
    def max_residual(self) -> NDArray[np.float32]:
        """Maximum residual height within 0.35 m of each cell (rows, cols), m.

        It is -1e6 without a sample.
        """
        half = max(round(_SEARCH_DISTANCE_M / self.grid.posting), 1)
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        near = np.hypot(x, y) * self.grid.posting <= _SEARCH_DISTANCE_M
        known = np.where(
            np.isfinite(self.residual_heights), self.residual_heights, np.float32(-1e6)
        )
        return np.asarray(ndimage.maximum_filter(known, footprint=near, mode="constant", cval=-1e6))

    @cached_property
    def _sorted_max_residual(self) -> NDArray[np.float32]:
        """All values of `max_residual`, ascending (rows * cols,), m."""
        return np.sort(self.max_residual, axis=None)

    def detectability(self, height: Array, density: Array) -> RockDetectability:
        """Return detection and false-alarm probabilities for rocks of given heights.

        Parameters
        ----------
        height
            Heights of the rocks (n,), m.
        density
            Samples per square metre near each rock (n,).
        """
        min_residual = _VISIBLE_SHARE * height
        false_alarm_probability = (
            1.0 - np.searchsorted(self._sorted_max_residual, min_residual) / self.max_residual.size
        )
        area = _TOP_AREA_SHARE * np.pi * (height / (2.0 * self.height_ratio)) ** 2
        detection_probability = _CORRECT_POSITION_PROBABILITY * -np.expm1(
            -INDEPENDENT_SHARE * density * area
        )
        return RockDetectability(
            min_residual,
            detection_probability,
            np.clip(false_alarm_probability, _MIN_FALSE_ALARM, 1.0 - _MIN_FALSE_ALARM),
        )
