"""The upper bound: a policy that is told the truth, and so lives with the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.policies.contract import Decision, Observation
from lunarsim.parts.quantity import hidden, quantity
from lunarsim.world.truth import Truth

Array = NDArray[np.float64]

# Sites tried for reachability, nearest first.
_TRIES = 64
# Room in deviations of the expected miss: 0.95 of all misses are less.
_ROOM = 2.5


@dataclass(frozen=True)
class TruthOracle:
    """Flies to the nearest site that is exactly safe with room around it; it is told the truth.

    Attributes
    ----------
    room
        Distance to the nearest unsafe cell that is enough, m; more where the lander drifts.
    """

    room: float = quantity(1.0, "m", ge=0, help="to the nearest unsafe cell that is enough")
    name: str = hidden("truth-oracle")

    knows_truth: ClassVar[bool] = True

    def decide(self, observation: Observation) -> Decision:
        """Refuse: it has to be told the truth."""
        raise RuntimeError("the truth oracle decides by decide_by_truth: the loop tells it")

    def decide_by_truth(
        self,
        observation: Observation,
        truth: Truth,
        error: Array,
        cost_of: Callable[[Array], DivertCost],
    ) -> Decision:
        """Keep a site with room around it, else pick the nearest such site within reach.

        Parameters
        ----------
        observation
            As other policies are shown it.
        truth
            Exact safety of the true terrain.
        error
            Estimated minus true position now (3,), m.
        cost_of
            Returns what it costs to fly to sites (n, 3), local frame.
        """
        grid = truth.safety.grid
        clearance = truth.clearance
        here = observation.site - error
        room = max(self.room, _ROOM * observation.expected_miss)
        row, col = (int(v) for v in grid.cell(here[:2]))
        if 0 <= row < grid.rows and 0 <= col < grid.cols and clearance[row, col] >= room:
            return Decision.keep("truly safe")
        # Where no site has that much room, the roomiest will have to do.
        enough = min(room, 0.8 * float(clearance.max()))
        cells = np.argwhere(clearance >= max(enough, 1e-9))
        if len(cells) == 0:
            return Decision.keep("no truly safe site")
        xy = grid.centre_of(cells[:, 0], cells[:, 1])
        distance = np.hypot(xy[:, 0] - here[0], xy[:, 1] - here[1])
        order = np.argsort(distance, kind="stable")
        order = order[:: max(1, len(order) // _TRIES)]
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
