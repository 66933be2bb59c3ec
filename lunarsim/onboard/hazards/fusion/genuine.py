"""How many of the large rocks that a camera tracks are rocks.

Not only rocks throw shadows. Hollows do, in every picture the same: a track of one is as sure to
exist as any, and reads as a large rock. Samples tell them apart, all tracks together: rocks they
show so often, and any other place by chance. So of the tracks that are told to be too high for the
lander a share s is taken for rocks, with

    L(s) = s^3 prod_i (s P(i shows, or not | rock) + (1 - s) P(the same | any place))

For each track the product is over the others: what its own samples say of it counts by itself
(`lunarsim.onboard.hazards.fusion.heights`). The mean of s over what is expected of it counts, if it
is less than 1: where samples are too few to show a rock, tracks are as likely as the camera says.
Tracks count as independent of each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.fusion.rises import Samples

Array = NDArray[np.float64]

# Shares that are tried. Before any sample four tracks in five are rocks, as if by five tracks.
_SHARES = (np.arange(200) + 0.5) / 200.0
_BEFORE = _SHARES ** (4.0 - 1.0)
_EXPECTED = float(_BEFORE @ _SHARES / _BEFORE.sum())


def genuine_share(xy: Array, height: Array, tells: NDArray[np.bool_], samples: Samples) -> Array:
    """Return the share of rocks among the others of each track, over that expected, at most 1 (n,).

    Parameters
    ----------
    xy, height
        Of the tracks (n, 2), local frame, m, and (n,), m.
    tells
        Which of them count (n,); off the map none does.
    samples
        About them.
    """
    grid = samples.grid
    tells = tells & np.asarray(grid.contains(xy))
    if not tells.any():
        return np.ones(len(height))
    row, col = grid.cell(xy[tells])
    rock = samples.showing(height[tells], samples.density[row, col])
    seen = samples.top[row, col] >= rock.least
    # Over the chance that any place shows nothing, where nothing shows.
    if_rock = np.where(seen, rock.hit, 1.0 - rock.shows)
    if_not = np.where(seen, rock.chance, 1.0)
    own = np.zeros((len(height), len(_SHARES)))
    own[tells] = np.log(_SHARES * if_rock[:, None] + (1.0 - _SHARES) * if_not[:, None])
    log = own.sum(axis=0) - own
    weight = _BEFORE * np.exp(log - log.max(axis=1, keepdims=True))
    share = weight @ _SHARES / weight.sum(axis=1)
    return np.asarray(np.minimum(share / _EXPECTED, 1.0))
