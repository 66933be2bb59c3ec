"""Collect the inputs of observations and actions of ``Retarget-v1`` as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.policies import Observation
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim_envs.sites import _map_kernels as m

SITES = 20  # number of candidate sites in observations and actions
# Cells per side of the downsampled map and of the crop around the site; spacing of the crop, m.
MAP_CELLS, CROP_CELLS, CROP_SPACING = 48, 33, 1.0


@dataclass(frozen=True)
class SiteInputs:
    """Onboard data of n landers from which observations and actions are computed.

    Positions are in the local frame of each lander; units are SI.

    Attributes
    ----------
    position, velocity, attitude
        Estimated states (n, 3), (n, 3), (n, 4).
    site
        Current site (n, 3).
    time_to_go, propellant
        Time to the end of the approach, s, and remaining propellant, kg (n,).
    position_of, p_safe, distance, cost
        Candidate sites (n, m, 3); their p_safe (probability of safe terrain), distance from the
        current site, and propellant to reach them, inf out of reach (n, m).
    count
        Number of candidates (n,).
    here
        Current site: p_safe (NaN if not observed), propellant to reach it, expected miss (n, 3).
    p, seen, corner, posting
        Maps of p_safe and of observed cells (n, rows, cols), centres of cells (0, 0) (n, 2), and
        cell size.
    small
        Maps downsampled to mean p_safe and observed fraction of equal blocks (n, 2, 48, 48).
    """

    position: Array
    velocity: Array
    attitude: Array
    site: Array
    time_to_go: Array
    propellant: Array
    position_of: Array
    p_safe: Array
    distance: Array
    cost: Array
    count: IntArray
    here: Array
    p: NDArray[np.float32]
    seen: BoolArray
    corner: Array
    posting: float
    small: NDArray[np.float32]

    @classmethod
    def of(cls, observation: Observation, small: NDArray[np.float32]) -> SiteInputs:
        """Convert the observation of an onboard policy (n = 1).

        `small` is its downsampled map (1, 2, 48, 48), from `downsample_maps`.
        """
        o, c, e = observation, observation.candidates, observation.estimate
        grid = o.hazard_map.grid

        def one(value: object) -> Array:
            return np.asarray(value, dtype=np.float64)[None]

        return cls(
            one(e.position), one(e.velocity), one(e.attitude), one(o.site), one(o.time_to_go),
            one(o.propellant), one(c.position), one(c.p_safe), one(c.distance), one(c.propellant),
            np.array([len(c)]), one((o.site_p_safe, o.site_propellant, o.expected_miss)),
            o.hazard_map.p_safe[None], o.hazard_map.observed[None], one((grid.x0, grid.y0)),
            grid.posting, small,
        )  # fmt: skip

    @property
    def crop(self) -> NDArray[np.float32]:
        """p_safe and observed mask around the current site, 1 m spacing (n, 2, 33, 33)."""
        out = np.empty((len(self.site), 2, CROP_CELLS, CROP_CELLS), np.float32)
        p = np.ascontiguousarray(self.p, dtype=np.float32)
        m.crop(p, self.seen, self.corner, self.posting, self.site, CROP_SPACING, out)
        return out


def downsample_maps(p: NDArray[np.float32], seen: BoolArray) -> NDArray[np.float32]:
    """Downsample maps to mean p_safe and observed fraction of blocks (n, 2, 48, 48).

    `p` and `seen` (n, rows, cols) are p_safe and the mask of observed cells.
    """
    out = np.zeros((len(p), 2, MAP_CELLS, MAP_CELLS))
    every = np.ones(len(p), np.bool_)
    given = every, np.ascontiguousarray(p, dtype=np.float32), seen, out
    if len(p) == 1:
        m.downsample_single(*given)
    else:
        m.downsample(*given)
    return out.astype(np.float32)
