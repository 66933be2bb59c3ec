"""The upper bound: a policy that is told the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.divert import DivertLimits, divert_cost
from lunarsim.onboard.policies.contract import Decision, Observation
from lunarsim.safety import SafetyMap

Array = NDArray[np.float64]

# Sites tried for reachability, nearest first.
_TRIES = 64


@dataclass(frozen=True)
class TruthOracle:
    """Flies to the nearest site that is exactly safe with room around it.

    Attributes
    ----------
    truth
        The exact safety map of the true terrain.
    elevation
        True elevation on its grid (rows, cols), m.
    navigation_error
        Returns estimated minus true position now (3,), m: the oracle knows it too.
    lander, gravity, approach_height, limits
        For the cost of the divert.
    room
        Distance to the nearest unsafe cell that is enough, m.
    """

    truth: SafetyMap
    elevation: NDArray[np.float32]
    navigation_error: Callable[[], Array]
    lander: Lander
    gravity: float
    approach_height: float
    limits: DivertLimits
    room: float = 1.0
    name: str = "truth-oracle"

    def decide(self, observation: Observation) -> Decision:
        """Keep a site with room around it, else pick the nearest such site within reach."""
        error = self.navigation_error()
        grid = self.truth.grid
        clearance = ndimage.distance_transform_edt(self.truth.safe) * grid.posting
        here = observation.site - error
        row, col = (int(v) for v in grid.cell(here[:2]))
        if 0 <= row < grid.rows and 0 <= col < grid.cols and clearance[row, col] >= self.room:
            return Decision.keep("truly safe")
        # Where no site has that much room, the roomiest will have to do.
        enough = min(self.room, 0.8 * float(clearance.max()))
        cells = np.argwhere(clearance >= max(enough, 1e-9))
        if len(cells) == 0:
            return Decision.keep("no truly safe site")
        xy = grid.centre_of(cells[:, 0], cells[:, 1])
        distance = np.hypot(xy[:, 0] - here[0], xy[:, 1] - here[1])
        order = np.argsort(distance, kind="stable")
        order = order[:: max(1, len(order) // _TRIES)]
        z = self.elevation[cells[order, 0], cells[order, 1]].astype(np.float64)
        sites = np.column_stack((xy[order], z)) + error
        cost = divert_cost(
            observation.estimate,
            sites + np.array([0.0, 0.0, self.approach_height]),
            self.lander,
            self.gravity,
            limits=self.limits,
        )
        reachable = np.flatnonzero(cost.feasible)
        if reachable.size == 0:
            return Decision.keep("no truly safe site within reach")
        first = int(reachable[0])
        return Decision(
            sites[first],
            "nearest truly safe site",
            {"propellant_kg": float(cost.propellant[first])},
        )
