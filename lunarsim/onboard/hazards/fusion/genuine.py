"""How many of the large rocks that a camera tracks are rocks.

Not only rocks throw shadows. On cratered ground the hollows do, day by day the same: a track of
one is as sure to exist as any, and reads as a large rock. Samples tell them apart, all tracks
together: of rocks they show so many, of other places as many as by chance. So a share s of those
that are told to be too high for the lander are taken for rocks, alike for all of them, with

    L(s) = s^(a-1) (1 - s)^(b-1) prod_i (s P(i shows or not | rock) + (1 - s) P(the same | any place))

Its mean over what is expected counts, if it is less: where samples are too few to show a rock, s is
what was expected, and rocks are as likely as the camera says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion.rises import highest_near, showing

Array = NDArray[np.float64]

# Before any sample: four rocks in five, as if by five tracks.
_ROCKS, _OTHERS = 4.0, 1.0
_SHARES = (np.arange(200) + 0.5) / 200.0


def genuine_share(
    xy: Array, height: Array, rises: NDArray[np.float32], density: Array, grid: Grid, ratio: float
) -> float:
    """Return the share of tracks that rocks are, over that expected; 1 at most, and without any.

    Parameters
    ----------
    xy
        Where they are (n, 2), local frame, m: those off the map do not count.
    height
        How high, m (n,).
    rises
        How far the samples of each cell stand above the ground about them (rows, cols), m; NaN
        where there are none.
    density
        Samples on a square metre (rows, cols).
    grid
        Cells of both.
    ratio
        Height over diameter of the rocks that the mission expects.
    """
    inside = np.asarray(grid.contains(xy))
    if not inside.any():
        return 1.0
    row, col = grid.cell(xy[inside])
    top = highest_near(rises, grid.posting)
    rock = showing(height[inside], density[row, col], top, ratio)
    seen = top[row, col] >= rock.least
    if_rock = np.where(seen, rock.shows + (1.0 - rock.shows) * rock.chance, 1.0 - rock.shows)
    if_not = np.where(seen, rock.chance, 1.0)
    # Both over the chance that any place shows nothing, where nothing shows.
    s = _SHARES[:, None]
    log = np.log(s * if_rock + (1.0 - s) * if_not).sum(axis=1)
    log += (_ROCKS - 1.0) * np.log(_SHARES) + (_OTHERS - 1.0) * np.log1p(-_SHARES)
    weight = np.exp(log - log.max())
    return min(float(weight @ _SHARES / weight.sum()) * (_ROCKS + _OTHERS) / _ROCKS, 1.0)
