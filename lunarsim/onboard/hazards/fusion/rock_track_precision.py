"""Precision of large rock tracks: the share of them that are rocks.

Not only rocks cast shadows. Hollows do too, in the same way in every image: a track of a hollow has
a high probability of existence and resembles a large rock. Samples of elevation distinguish them
statistically, over all tracks together: the samples show a rise at a rock with a known probability,
and at any other place with the false-alarm probability. Among the tracks that would be too high for
the lander, the share s of rocks has the posterior

    L(s) = s^3 prod_i (s P(i shows, or not | rock) + (1 - s) P(the same | any place))

For each track the product is over the other tracks, because its own samples are used separately
(`lunarsim.onboard.hazards.fusion.rock_heights`). The mean of s relative to its prior mean is
applied if it is less than 1. If samples are too sparse to show a rock, tracks thus keep their
probability from the camera. Tracks are treated as independent.
"""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.typing import Array, BoolArray

# Grid of shares, and its prior: mean 4/5 with the weight of five tracks.
_SHARE_GRID = (np.arange(200) + 0.5) / 200.0
_SHARE_PRIOR = _SHARE_GRID ** (4.0 - 1.0)
_PRIOR_MEAN = float(_SHARE_PRIOR @ _SHARE_GRID / _SHARE_PRIOR.sum())


def rock_track_precision(
    xy: Array, height: Array, is_large: BoolArray, samples: ElevationSamples
) -> Array:
    """Return the factor that reduces the existence of tracks that may be hollows.

    The factor (n,) is the estimated fraction of large tracks that are rocks, divided by its prior
    mean, and at most 1. For each track it is estimated from the samples at all other tracks.

    Parameters
    ----------
    xy, height
        Positions (n, 2), local frame, m, and heights (n,), m, of the tracks.
    is_large
        Which tracks are higher than the limit of the lander and enter the estimate (n,); tracks off
        the map are ignored.
    samples
        Elevation samples.
    """
    grid = samples.grid
    is_large = is_large & np.asarray(grid.contains(xy))
    if not is_large.any():
        return np.ones(len(height))
    row, col = grid.cell(xy[is_large])
    rock = samples.detectability(height[is_large], samples.density[row, col])
    seen = samples.max_residual[row, col] >= rock.min_residual
    # Without a rise, both likelihoods are divided by the probability of no rise at any place.
    rock_likelihood = np.where(seen, rock.rise_probability, 1.0 - rock.detection_probability)
    other_likelihood = np.where(seen, rock.false_alarm_probability, 1.0)
    own = np.zeros((len(height), len(_SHARE_GRID)))
    own[is_large] = np.log(
        _SHARE_GRID * rock_likelihood[:, None] + (1.0 - _SHARE_GRID) * other_likelihood[:, None]
    )
    log = own.sum(axis=0) - own
    weight = _SHARE_PRIOR * np.exp(log - log.max(axis=1, keepdims=True))
    share = weight @ _SHARE_GRID / weight.sum(axis=1)
    return np.asarray(np.minimum(share / _PRIOR_MEAN, 1.0))
