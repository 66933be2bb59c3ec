"""Check the pixels of a LiDAR scan for spikes and excess noise.

Neighbouring pixels see neighbouring terrain. A single range far from all its neighbours is a spike,
for instance by dust. If all ranges scatter far more than the scanner specifies, the noise hides the
terrain slopes, and a registration would take noise for terrain features.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.measurements import LidarScan
from lunarsim.typing import Array

# A range is a spike if it differs from three of its four neighbours, in the same direction, by more
# than this distance (m) plus a number of standard deviations.
_MIN_SPIKE_M, _SPIKE_SIGMAS, _MIN_NEIGHBOURS = 1.0, 6.0, 3
# Maximum noise of a scan: multiple of the specified noise, plus the effect of rough terrain, m.
_MAX_NOISE_RATIO, _ROUGH_TERRAIN_NOISE_M = 3.0, 0.25
# Maximum specified noise, m: registrations neglect the range noise in the slopes.
_MAX_SPECIFIED_NOISE_M = 0.15
# Ratio of standard deviation to median absolute value of a normal variable with zero mean.
_SIGMA_PER_MEDIAN = 1.4826


def remove_spikes(scan: LidarScan) -> LidarScan:
    """Return a scan without ranges that differ strongly from neighbouring pixels.

    A range is removed (NaN) if it is larger than three of its four neighbours, or smaller than
    three of them, by more than 1 m plus 6 standard deviations. Scans with fewer than three rows or
    columns are returned unchanged.

    Raises
    ------
    InputError
        If the shape of the scan does not match its number of pixels.
    """
    r = _range_image(scan)
    if min(r.shape) < 3:
        return scan
    far = _MIN_SPIKE_M + _SPIKE_SIGMAS * np.where(np.isfinite(scan.sigma), scan.sigma, 0.0).reshape(
        r.shape
    )
    beyond, short = (np.zeros(r.shape, np.int8) for _ in range(2))
    with np.errstate(invalid="ignore"):
        for here, there in _neighbour_slices():
            gap = r[here] - r[there]
            beyond[here] += gap > far[here]
            short[here] += gap < -far[here]
    spike = (np.maximum(beyond, short) >= _MIN_NEIGHBOURS).ravel()
    return replace(scan, range=np.where(spike, np.nan, scan.range)) if spike.any() else scan


def range_noise(scan: LidarScan) -> float:
    """Estimate the range noise of a scan, 1 sigma, m; NaN with too few pixels.

    At least 100 pixels are needed. The estimate is the scaled median of the differences between a
    range and the mean of its two neighbours in the row. These differences are 0 on a uniform slope.
    """
    r = _range_image(scan)
    second_difference = r[:, 1:-1] - 0.5 * (r[:, :-2] + r[:, 2:])
    second_difference = second_difference[np.isfinite(second_difference)]
    if len(second_difference) < 100:
        return float("nan")
    return _SIGMA_PER_MEDIAN * float(np.median(np.abs(second_difference))) / float(np.sqrt(1.5))


def is_noisy(scan: LidarScan) -> bool:
    """Return whether a scan's range noise is too large for registration.

    This is the case if the noise exceeds 3 times the scanner's specification plus 0.25 m (for
    rough terrain), or if the specified noise exceeds 0.15 m. The result is False for a scan
    without ranges.
    """
    specified = scan.sigma[np.isfinite(scan.range) & np.isfinite(scan.sigma)]
    if len(specified) == 0:
        return False
    typical = float(np.median(specified))
    return typical > _MAX_SPECIFIED_NOISE_M or bool(
        range_noise(scan) > _MAX_NOISE_RATIO * typical + _ROUGH_TERRAIN_NOISE_M
    )


def _range_image(scan: LidarScan) -> Array:
    """Return the ranges of a scan as an image (rows, cols), m.

    An `InputError` is raised if the scan does not have rows times cols ranges.
    """
    if int(np.prod(scan.shape)) != np.size(scan.range):
        raise InputError(
            "scan.shape", scan.shape,
            f"rows times columns must be {np.size(scan.range)}, the number of ranges",
        )  # fmt: skip
    return np.reshape(scan.range, scan.shape)


def _neighbour_slices() -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Return pairs of image slices: pixels and their neighbours, one pair per side.

    For each of the four pairs (a, b), `image[b]` are the neighbours of the pixels `image[a]` on
    one side. Pixels without a neighbour on that side are not in `image[a]`.
    """
    every, first, last = slice(None), slice(None, -1), slice(1, None)
    return [
        ((first, every), (last, every)), ((last, every), (first, every)),
        ((every, first), (every, last)), ((every, last), (every, first)),
    ]  # fmt: skip
