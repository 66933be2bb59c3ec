"""What of a scan is worth comparing: by its own pixels, before any ground is looked for.

Neighbouring pixels meet neighbouring ground. One that lies far off all those about it has met a
fleck of dust or was counted wrong; where all of them scatter far beyond what the scanner states,
the slopes of the ground drown, and a fit would take noise for ground that tells where it lies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.measurements import LidarScan

Array = NDArray[np.float64]

# A return farther than this off three of its four neighbours, to the same side, is none of the
# ground's, m: besides what it may err by, so many deviations.
_OFF, _DEVIATIONS, _FEWEST = 1.0, 6.0, 3
# Noise that a scan may have: so many times what is stated, and what rough ground looks like, m.
_STATED, _ROUGH = 3.0, 0.25
# Noise that may be stated, m: fits take ranges as exact, and the slopes that weigh them with them.
_MOST_STATED = 0.15
# Of a standard normal variable, deviation over median of its size.
_BY_MEDIAN = 1.4826


def without_spikes(scan: LidarScan) -> LidarScan:
    """Return a scan without returns that lie far off those about them.

    Raises
    ------
    InputError
        If its rows and columns do not make up its pixels.
    """
    r = _image(scan)
    if min(r.shape) < 3:
        return scan
    far = _OFF + _DEVIATIONS * np.where(np.isfinite(scan.sigma), scan.sigma, 0.0).reshape(r.shape)
    beyond, short = (np.zeros(r.shape, np.int8) for _ in range(2))
    with np.errstate(invalid="ignore"):
        for here, there in _pairs():
            gap = r[here] - r[there]
            beyond[here] += gap > far[here]
            short[here] += gap < -far[here]
    spike = (np.maximum(beyond, short) >= _FEWEST).ravel()
    return replace(scan, range=np.where(spike, np.nan, scan.range)) if spike.any() else scan


def noise_of(scan: LidarScan) -> float:
    """Return the noise of a range, 1 sigma, m, by neighbours along the rows; NaN of too few.

    The median size of how ranges differ from the mean of those on either side, which is 0 on
    a slope.
    """
    r = _image(scan)
    bend = r[:, 1:-1] - 0.5 * (r[:, :-2] + r[:, 2:])
    bend = bend[np.isfinite(bend)]
    if len(bend) < 100:
        return float("nan")
    return _BY_MEDIAN * float(np.median(np.abs(bend))) / float(np.sqrt(1.5))


def is_noisy(scan: LidarScan) -> bool:
    """Tell whether ranges scatter far beyond what the scanner states, or by that alone too far."""
    stated = scan.sigma[np.isfinite(scan.range) & np.isfinite(scan.sigma)]
    if len(stated) == 0:
        return False
    usual = float(np.median(stated))
    return usual > _MOST_STATED or bool(noise_of(scan) > _STATED * usual + _ROUGH)


def _image(scan: LidarScan) -> Array:
    """Return the ranges by row and column."""
    if int(np.prod(scan.shape)) != np.size(scan.range):
        raise InputError("scan.shape", scan.shape, f"rows and columns of {np.size(scan.range)}")
    return np.reshape(scan.range, scan.shape)


def _pairs() -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Return pixels and their neighbours, on each of four sides."""
    every, first, last = slice(None), slice(None, -1), slice(1, None)
    return [
        ((first, every), (last, every)), ((last, every), (first, every)),
        ((every, first), (every, last)), ((every, last), (every, first)),
    ]  # fmt: skip
