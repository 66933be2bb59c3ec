"""Registration of tracked rocks to elevations of another sensor.

At long range all rocks of a camera share one position error: 1 mrad of pointing is 1.5 m on the
terrain from 1500 m. Relative to each other the rocks are placed to decimetres. The module estimates
the common shift that moves the rocks to rises in the elevations. Let h be the probability that
samples show a rock, and f the probability that any place resembles one
(`lunarsim.onboard.hazards.fusion.elevation_samples`). A rock with a rise contributes ``log((h + (1
- h) f) / f)`` to the log likelihood of a shift, one without contributes ``log(1 - h)``. With the
prior of the shift this yields its mean and covariance. If the elevations are not informative, both
equal the prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.fusion.rock_heights import MIN_ROCK_RADIUS_M
from lunarsim.onboard.hazards.map_evidence import RockTracks
from lunarsim.typing import Array, IntArray

# Search range of the shift in prior standard deviations, and its maximum, m.
_SEARCH_SIGMAS, _MAX_SHIFT_M = 3.0, 4.0
# Minimum standard deviation of a shift, and of a rock relative to the others, m.
_MIN_SHIFT_SIGMA_M, _RELATIVE_SIGMA_M = 0.1, 0.15
# Minimum number of rocks for an estimate.
_MIN_ROCKS = 3


@dataclass(frozen=True)
class RockShift:
    """Position error common to all tracked rocks, estimated from elevation samples.

    Attributes
    ----------
    correction
        Shift to be added to the rock positions, east and north (2,), m.
    sigma
        Standard deviation of the shift after the estimate, m, per axis.
    prior_sigma
        Standard deviation of the shift before the estimate, m, per axis.
    """

    correction: Array
    sigma: float
    prior_sigma: float


def register_tracks(tracks: RockTracks, samples: ElevationSamples, scale: float) -> RockTracks:
    """Return the rock tracks moved by their common shift relative to the elevations.

    The standard deviation of the positions is updated. The tracks are returned unchanged if
    `estimate_shift` returns None.

    Parameters
    ----------
    tracks
        Tracked rocks.
    samples
        Elevation samples.
    scale
        Ratio of height to radius of the rocks.
    """
    shift = estimate_shift(tracks, samples, scale)
    if shift is None:
        return tracks
    own = np.sqrt(np.maximum(tracks.sigma**2 - shift.prior_sigma**2, 0.0) + _RELATIVE_SIGMA_M**2)
    sigma = np.minimum(np.hypot(own, shift.sigma), np.maximum(tracks.sigma, _RELATIVE_SIGMA_M))
    return replace(tracks, xy=tracks.xy + shift.correction, sigma=sigma)


def estimate_shift(tracks: RockTracks, samples: ElevationSamples, scale: float) -> RockShift | None:
    """Estimate the common position error of tracked rocks from elevation samples.

    The result is None if fewer than three tracks on the map have an existence above 0.5.

    Parameters
    ----------
    tracks
        Tracked rocks.
    samples
        Elevation samples.
    scale
        Ratio of height to radius of the rocks.
    """
    grid = samples.grid
    inside = np.asarray(grid.contains(tracks.xy)) & (tracks.existence > 0.5)
    if np.count_nonzero(inside) < _MIN_ROCKS:
        return None
    row, col = (np.asarray(v) for v in grid.cell(tracks.xy[inside]))
    height = scale * np.maximum(tracks.radius[inside], MIN_ROCK_RADIUS_M)
    prior_sigma = float(np.median(tracks.sigma[inside]))
    rock = samples.detectability(height, samples.density[row, col])
    hit, miss = (
        np.log(rock.rise_probability / rock.false_alarm_probability),
        np.log1p(-rock.detection_probability),
    )
    steps = _cell_offsets(min(_SEARCH_SIGMAS * prior_sigma, _MAX_SHIFT_M), grid.posting)
    far = grid.posting * steps
    log = -0.5 * (far[:, None] ** 2 + far**2) / max(prior_sigma, _MIN_SHIFT_SIGMA_M) ** 2
    # Cells beyond the edge of the map take the value at the edge.
    wide = np.pad(samples.max_residual, len(steps) // 2, mode="edge")
    for r, c, h, yes, no in zip(row, col, rock.min_residual, hit, miss, strict=True):
        near = wide[r : r + len(steps), c : c + len(steps)]
        log += np.where(near >= h, yes, no)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    correction, variance = [], []
    for axis in (0, 1):
        along = weight.sum(axis=axis)
        correction.append(float(along @ far))
        variance.append(float(along @ (far - correction[-1]) ** 2))
    return RockShift(
        np.array(correction),
        max(float(np.sqrt(np.mean(variance))), _MIN_SHIFT_SIGMA_M),
        prior_sigma,
    )


def _cell_offsets(max_distance: float, posting: float) -> IntArray:
    """Return the integers from -n to n for n = `max_distance` / `posting`, rounded.

    Both are in m; n is rounded to the nearest integer.
    """
    most = round(max_distance / posting)
    return np.arange(-most, most + 1)
