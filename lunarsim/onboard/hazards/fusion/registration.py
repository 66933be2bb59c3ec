"""Registration of tracked rocks to elevations of another sensor.

At long range all rocks of a camera share one position error: 1 mrad of pointing is 1.5 m on the
terrain from 1500 m. Relative to each other the rocks are placed to decimetres. The module estimates
the common shift that moves the rocks to rises in the elevations. Let h be the probability that
samples show a rock, and f the probability that any place looks like one
(`lunarsim.onboard.hazards.fusion.rises`). A rock with a rise contributes ``log((h + (1 - h) f) /
f)`` to the log likelihood of a shift, one without contributes ``log(1 - h)``. With the prior of the
shift this yields its mean and covariance. If the elevations are not informative, both equal the
prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.fusion.heights import LEAST_RADIUS
from lunarsim.onboard.hazards.fusion.rises import Samples
from lunarsim.onboard.hazards.published import RockTracks

Array = NDArray[np.float64]

# Search range of the shift in prior standard deviations, and its maximum, m.
_DEVIATIONS, _FARTHEST = 3.0, 4.0
# Minimum standard deviation of a shift, and of a rock relative to the others, m.
_LEAST, _APART = 0.1, 0.15
# Minimum number of rocks for an estimate.
_FEWEST = 3


@dataclass(frozen=True)
class Shift:
    """Estimated common position error of rocks.

    Attributes
    ----------
    by
        Correction to the east and north (2,), m.
    sigma
        Its standard deviation after the estimate, m, per axis.
    common
        Its standard deviation before the estimate, m, per axis.
    """

    by: Array
    sigma: float
    common: float


def registered(tracks: RockTracks, samples: Samples, scale: float) -> RockTracks:
    """Return the rocks moved to the elevations; unchanged if there are too few.

    Parameters
    ----------
    tracks
        Tracked rocks.
    samples
        Elevation samples.
    scale
        Height of the rocks over their radius.
    """
    shift = shift_of(tracks, samples, scale)
    if shift is None:
        return tracks
    own = np.sqrt(np.maximum(tracks.sigma**2 - shift.common**2, 0.0) + _APART**2)
    sigma = np.minimum(np.hypot(own, shift.sigma), np.maximum(tracks.sigma, _APART))
    return replace(tracks, xy=tracks.xy + shift.by, sigma=sigma)


def shift_of(tracks: RockTracks, samples: Samples, scale: float) -> Shift | None:
    """Estimate the common shift of the rocks; None if there are too few on the map.

    Parameters
    ----------
    tracks
        Tracked rocks.
    samples
        Elevation samples.
    scale
        Height of the rocks over their radius.
    """
    grid = samples.grid
    inside = np.asarray(grid.contains(tracks.xy)) & (tracks.existence > 0.5)
    if np.count_nonzero(inside) < _FEWEST:
        return None
    row, col = (np.asarray(v) for v in grid.cell(tracks.xy[inside]))
    height = scale * np.maximum(tracks.radius[inside], LEAST_RADIUS)
    common = float(np.median(tracks.sigma[inside]))
    rock = samples.showing(height, samples.density[row, col])
    hit, miss = np.log(rock.hit / rock.chance), np.log1p(-rock.shows)
    steps = _steps(min(_DEVIATIONS * common, _FARTHEST), grid.posting)
    far = grid.posting * steps
    log = -0.5 * (far[:, None] ** 2 + far**2) / max(common, _LEAST) ** 2
    # Cells beyond the edge of the map take the value at the edge.
    wide = np.pad(samples.top, len(steps) // 2, mode="edge")
    for r, c, h, yes, no in zip(row, col, rock.least, hit, miss, strict=True):
        near = wide[r : r + len(steps), c : c + len(steps)]
        log += np.where(near >= h, yes, no)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    by, variance = [], []
    for axis in (0, 1):
        along = weight.sum(axis=axis)
        by.append(float(along @ far))
        variance.append(float(along @ (far - by[-1]) ** 2))
    return Shift(np.array(by), max(float(np.sqrt(np.mean(variance))), _LEAST), common)


def _steps(far: float, posting: float) -> NDArray[np.int64]:
    """Return the whole numbers of cells up to a distance in both directions (n,)."""
    most = round(far / posting)
    return np.arange(-most, most + 1)
