"""Ground that one eye has measured to be level and another has seen to be clear of rocks.

A map of elevations doubts ground between its samples: what they have not met may be there. Where a
camera has looked sharply enough, what may be there are the rocks that it misses, and of the ground
only slope and roughness as measured are asked for:

    p = prior x P(no untracked rock reaches in) x P(no tracked one does) x level.

`level` falls from 1 where slope and roughness are well within the limits to 0 at either limit, and
so does p with every one of its factors. As for ground that was not measured, the prior counts,
which is less than surely safe, and no frequency is claimed.

A camera that finds far fewer rocks than it should is not believed (`lunarsim.onboard.hazards.
shadows.plausible`), unless that is because it reads them too small: here they count by the scale
that the samples tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.fusion.heights import Heights
from lunarsim.onboard.hazards.fusion.resampling import on_grid
from lunarsim.onboard.hazards.published import ReliefEvidence, RockEvidence, RockTracks
from lunarsim.onboard.hazards.shadows.plausible import too_few

Array = NDArray[np.float64]

# Slope and roughness are well within their limits up to these shares of them short of 1.
_SLOPE, _ROUGHNESS = 0.3, 0.5


def clear_ground(
    relief: ReliefEvidence, rocks: RockEvidence, clear: Array, prior: float
) -> NDArray[np.float32]:
    """Return the probability of safe ground (rows, cols), on the cells of the elevations.

    0 where either eye has not seen, or does not tell.

    Parameters
    ----------
    relief, rocks
        Evidence of both.
    clear
        Probability that no tracked rock matters (rows, cols).
    prior
        That slope and relief of ground that was not measured are within the limits.
    """
    drawn, own = relief.surface, rocks.drawn
    if relief.judged is None or rocks.unseen is None:
        return np.zeros(drawn.grid.shape, np.float32)
    seen = drawn.observed & on_grid(own.observed, own.grid, drawn.grid, False, "least")
    unseen = on_grid(rocks.unseen, own.grid, drawn.grid, 1.0, "greatest")
    with np.errstate(invalid="ignore"):
        level = np.clip((1.0 - relief.judged.slope) / _SLOPE, 0.0, 1.0)
        level *= np.clip((1.0 - relief.judged.roughness) / _ROUGHNESS, 0.0, 1.0)
    return np.where(seen, prior * (1.0 - unseen) * clear * level, 0.0).astype(np.float32)


def believed(rocks: RockEvidence, placed: RockTracks, heights: Heights, limit: float) -> bool:
    """Return whether the eye for rocks finds as many as it should, by their heights.

    Parameters
    ----------
    rocks
        Its evidence.
    placed, heights
        Its rocks, as both eyes have them.
    limit
        Height from which on a rock matters, m.
    """
    domain = rocks.drawn.in_domain
    if domain is None or domain.any():
        return True
    inside = np.asarray(rocks.drawn.grid.contains(placed.xy)) & (placed.existence > 0.5)
    high = heights.scale * placed.radius >= limit
    return not too_few(int(np.count_nonzero(inside & high)), rocks.expected)
