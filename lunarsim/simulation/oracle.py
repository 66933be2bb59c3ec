"""Divert policy that uses the true landing safety, as an upper bound for others.

It belongs to the simulation because no onboard part may use the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import ndimage

from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.policies.contract import Decision, Observation
from lunarsim.parts.quantity import hidden, quantity
from lunarsim.typing import Array, BoolArray
from lunarsim.world.truth import TerrainTruth

# If there are n times as many sites, only every n-th in order of distance is tested for
# reachability.
_MAX_TESTED_SITES = 64
# Squares around the landing site that are searched in turn: half of the side, m, and number of
# sites along a side.
_HALF_SIDES_M, _SITES_ALONG_SIDE = (25.0, 50.0, 100.0, 200.0, 400.0), 256
# Clearance in standard deviations of the expected miss; 0.95 of all misses are smaller.
_CLEARANCE_SIGMAS = 2.5


@dataclass(frozen=True)
class TruthOracle:
    """Divert policy that uses the truth: the nearest truly safe site with clearance.

    Attributes
    ----------
    min_clearance
        Required distance to the nearest unsafe cell, m. The policy uses a larger distance if the
        expected landing error requires it.
    """

    min_clearance: float = quantity(
        1.0,
        "m",
        ge=0,
        help="minimum distance between the landing site and the nearest unsafe cell of the true "
        "map",
    )
    name: str = hidden("truth-oracle")

    knows_truth: ClassVar[bool] = True

    def decide(self, observation: Observation) -> Decision:
        """Raise `RuntimeError`, because this policy needs the true landing safety."""
        raise RuntimeError(
            "this policy needs the true hazard map; call decide_by_truth instead of decide"
        )

    def decide_by_truth(
        self,
        observation: Observation,
        truth: TerrainTruth,
        error: Array,
        cost_of: Callable[[Array], DivertCost],
    ) -> Decision:
        """Keep a truly safe site with enough clearance; else divert to the nearest one.

        The clearance is the distance to the nearest unsafe cell. If no site has the required
        clearance, 0.8 of the maximum clearance is enough. Only a subset of many sites is tested for
        reachability. If no tested site is reachable, the current site is kept.

        Parameters
        ----------
        observation
            Observation that other policies receive.
        truth
            True landing safety of the terrain.
        error
            Estimated minus true position (3,), m.
        cost_of
            Function that returns the divert cost of sites (n, 3), local frame.
        """
        here = observation.site - error
        required = max(self.min_clearance, _CLEARANCE_SIGMAS * observation.expected_miss)
        for half_side in _HALF_SIDES_M:
            xy, z, clearance = _sites_around(truth, here[:2], half_side)
            distance = np.hypot(xy[:, 0] - here[0], xy[:, 1] - here[1])
            nearest = int(np.argmin(distance))
            if distance[nearest] <= 1.0 and clearance[nearest] >= required:
                return Decision.keep("truly safe")
            found = _nearest_reachable(xy, z, distance, clearance >= required, error, cost_of)
            if found is not None:
                return found
        # If no site has this clearance, accept 0.8 of the maximum clearance.
        enough = max(min(required, 0.8 * float(clearance.max())), 1e-9)
        found = _nearest_reachable(xy, z, distance, clearance >= enough, error, cost_of)
        return Decision.keep("no truly safe site within reach") if found is None else found


def _sites_around(
    truth: TerrainTruth, centre: Array, half_side: float
) -> tuple[Array, Array, Array]:
    """Return position, elevation and clearance of the sites in a square, m.

    The results are (n, 2), (n,) and (n,). `centre` (2,) is that of the square, `half_side` half of
    its side, m. The clearance is the distance to the nearest unsafe site; sites beyond the square
    count as unsafe.
    """
    (east, north), half = centre, half_side
    square = truth.within((east - half, east + half, north - half, north + half), _SITES_ALONG_SIDE)
    cells = ndimage.distance_transform_edt(np.pad(square.safe, 1))[1:-1, 1:-1]
    xy = square.grid.centres().reshape(-1, 2)
    return xy, square.elevation.ravel().astype(np.float64), cells.ravel() * square.grid.posting


def _nearest_reachable(
    xy: Array,
    z: Array,
    distance: Array,
    suitable: BoolArray,
    error: Array,
    cost_of: Callable[[Array], DivertCost],
) -> Decision | None:
    """Return a divert to the nearest suitable site in reach; None if there is none.

    Sites (n,) have positions `xy`, elevations `z` and a horizontal `distance`, m.
    """
    order = np.flatnonzero(suitable)
    order = order[np.argsort(distance[order], kind="stable")]
    order = order[:: max(1, len(order) // _MAX_TESTED_SITES)]
    if not len(order):
        return None
    sites = np.column_stack((xy[order], z[order])) + error
    cost = cost_of(sites)
    reachable = np.flatnonzero(cost.feasible)
    if reachable.size == 0:
        return None
    first = int(reachable[0])
    details = {"propellant_kg": float(cost.propellant[first])}
    return Decision(sites[first], "nearest truly safe site", details)
