"""Precision of large rock tracks: the share of them that are rocks.

Not only rocks cast shadows. Hollows do too, in the same way in every image: a track of a hollow has
a high probability of existence and looks like a large rock. Samples of elevation distinguish them
statistically, over all tracks together: the samples show a rise at a rock with a known probability,
and at any other place with the false-alarm probability. Among the tracks that would be too high for
the lander, the share s of rocks has the posterior

    L(s) = s^3 prod_i (s P(i shows, or not | rock) + (1 - s) P(the same | any place))

For each track the product is over the other tracks, because its own samples are used separately
(`lunarsim.onboard.hazards.fusion.heights`). The mean of s relative to its prior mean is applied if
it is less than 1. If samples are too sparse to show a rock, tracks thus keep their probability from
the camera. Tracks are treated as independent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.fusion.rises import Samples

Array = NDArray[np.float64]

# Grid of shares, and its prior: mean 4/5 with the weight of five tracks.
_SHARES = (np.arange(200) + 0.5) / 200.0
_BEFORE = _SHARES ** (4.0 - 1.0)
_EXPECTED = float(_BEFORE @ _SHARES / _BEFORE.sum())


def genuine_share(xy: Array, height: Array, tells: NDArray[np.bool_], samples: Samples) -> Array:
    """Return the share of rocks among the other tracks over its prior mean (n,).

    It is at most 1.

    Parameters
    ----------
    xy, height
        Positions (n, 2), local frame, m, and heights (n,), m, of the tracks.
    tells
        Which tracks are used (n,); tracks off the map are not.
    samples
        Elevation samples.
    """
    grid = samples.grid
    tells = tells & np.asarray(grid.contains(xy))
    if not tells.any():
        return np.ones(len(height))
    row, col = grid.cell(xy[tells])
    rock = samples.showing(height[tells], samples.density[row, col])
    seen = samples.top[row, col] >= rock.least
    # Where nothing shows, both likelihoods are relative to that of no rise at any place.
    if_rock = np.where(seen, rock.hit, 1.0 - rock.shows)
    if_not = np.where(seen, rock.chance, 1.0)
    own = np.zeros((len(height), len(_SHARES)))
    own[tells] = np.log(_SHARES * if_rock[:, None] + (1.0 - _SHARES) * if_not[:, None])
    log = own.sum(axis=0) - own
    weight = _BEFORE * np.exp(log - log.max(axis=1, keepdims=True))
    share = weight @ _SHARES / weight.sum(axis=1)
    return np.asarray(np.minimum(share / _EXPECTED, 1.0))
