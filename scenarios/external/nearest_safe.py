"""Policy in Python, in another process: the nearest cell that is safe with its neighbours.

    lunarsim fly golombek --set policy.kind=process --set policy.path=nearest_safe.py \
        --set policy.configuration=0.9 --allow-program nearest_safe.py

nearest_safe.cpp is the same policy in C++.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter

from lunarsim.interface import serve

KEEP, DIVERT = 0, 1
MAX_DISTANCE = 60.0


class NearestSafeCell:
    """Policy of one flight."""

    def __init__(self, briefing: Any) -> None:
        self.threshold = float(briefing.get("configuration") or 0.9)
        if not 0.0 < self.threshold < 1.0:
            raise ValueError("the threshold must be between 0 and 1")

    def step(self, given: Any, answer: Any) -> None:
        """Choose the landing site."""
        if given.get("site_p_safe") >= self.threshold:
            answer.set(action=KEEP, reason=b"the site is safe")
            return
        hazards = given.parts["map"]
        grid = hazards.parts["grid"]
        shape = int(grid.get("rows")), int(grid.get("cols"))
        # Cells at the edge do not count.
        safest = minimum_filter(hazards.arrays["p_safe"].reshape(shape), 3)
        is_safe = np.zeros(shape, dtype=bool)
        is_safe[1:-1, 1:-1] = (safest >= self.threshold)[1:-1, 1:-1]
        x = grid.get("x0") + np.arange(shape[1]) * grid.get("posting")
        y = grid.get("y0") + np.arange(shape[0]) * grid.get("posting")
        site = given.get("site")
        distance = (x - site[0]) ** 2 + ((y - site[1]) ** 2)[:, None]
        distance[~is_safe | (distance >= MAX_DISTANCE**2)] = np.inf
        row, col = np.unravel_index(int(distance.argmin()), shape)
        if not np.isfinite(distance[row, col]):
            answer.set(action=KEEP, reason=b"no safe cell")
            return
        height = site[2]
        if given.parts["map"].get("elevation_count"):
            known = hazards.arrays["elevation"].reshape(shape)[row, col]
            height = known if np.isfinite(known) else height
        # No divert if the site is in this cell or beside it.
        is_near = distance[row, col] < grid.get("posting") ** 2
        action = KEEP if is_near else DIVERT
        answer.set(action=action, site=[x[col], y[row], height], reason=b"nearest safe cell")


if __name__ == "__main__":
    serve(policy=NearestSafeCell)
