"""Divert policy that uses the true landing safety, as an upper bound for others.

It belongs to the simulation because no onboard part may use the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.policies.contract import Decision, Observation
from lunarsim.parts.quantity import hidden, quantity
from lunarsim.typing import Array
from lunarsim.world.truth import TerrainTruth

# If there are n times as many sites, only every n-th in order of distance is tested for
# reachability.
_MAX_TESTED_SITES = 64
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
        grid = truth.safety.grid
        clearance = truth.clearance
        here = observation.site - error
        required = max(self.min_clearance, _CLEARANCE_SIGMAS * observation.expected_miss)
        row, col = (int(v) for v in grid.cell(here[:2]))
        if 0 <= row < grid.rows and 0 <= col < grid.cols and clearance[row, col] >= required:
            return Decision.keep("truly safe")
        # If no site has this clearance, accept 0.8 of the maximum clearance.
        enough = min(required, 0.8 * float(clearance.max()))
        cells = np.argwhere(clearance >= max(enough, 1e-9))
        if len(cells) == 0:
            return Decision.keep("no truly safe site")
        xy = grid.centre_of(cells[:, 0], cells[:, 1])
        distance = np.hypot(xy[:, 0] - here[0], xy[:, 1] - here[1])
        order = np.argsort(distance, kind="stable")
        order = order[:: max(1, len(order) // _MAX_TESTED_SITES)]
        z = truth.elevation[cells[order, 0], cells[order, 1]].astype(np.float64)
        sites = np.column_stack((xy[order], z)) + error
        cost = cost_of(sites)
        reachable = np.flatnonzero(cost.feasible)
        if reachable.size == 0:
            return Decision.keep("no truly safe site within reach")
        first = int(reachable[0])
        return Decision(
            sites[first],
            "nearest truly safe site",
            {"propellant_kg": float(cost.propellant[first])},
        )
