"""From a simulation's observation to fixed-size arrays."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.policies import Observation

FloatArray = NDArray[np.float32]

MAP_CELLS = 48  # cells along a side of the map that an agent sees
SITE_COLUMNS = ("east_m", "north_m", "up_m", "p_safe", "propellant_kg", "available")
FAR = 5000.0  # no distance (m), speed (m/s) or mass (kg) in a flight is larger


def observation_space(sites: int) -> spaces.Dict:
    """Return the space of observations with room for `sites` candidate sites."""
    low = np.array([-FAR, -FAR, -FAR, 0.0, 0.0, 0.0], np.float32)
    high = np.array([FAR, FAR, FAR, 1.0, FAR, 1.0], np.float32)
    return spaces.Dict(
        {
            "estimate": spaces.Box(
                np.array([-FAR] * 6 + [-1.0] * 4, np.float32),
                np.array([FAR] * 6 + [1.0] * 4, np.float32),
            ),
            "hazard_map": spaces.Box(0.0, 1.0, (2, MAP_CELLS, MAP_CELLS), np.float32),
            "sites": spaces.Box(np.tile(low, (sites, 1)), np.tile(high, (sites, 1))),
            "to_go": spaces.Box(
                np.zeros(3, np.float32), np.full(3, FAR, np.float32), dtype=np.float32
            ),
        }
    )


def shrink(hazard_map: HazardMap, cells: int = MAP_CELLS) -> FloatArray:
    """Return mean p_safe and share observed (2, cells, cells) of equal blocks of the map."""
    rows, cols = hazard_map.grid.shape
    row = (np.arange(rows) * cells) // rows
    col = (np.arange(cols) * cells) // cols
    out = np.zeros((2, cells, cells))
    count = np.zeros((cells, cells))
    index = (row[:, None], col[None, :])
    np.add.at(count, index, 1.0)
    np.add.at(out[0], index, hazard_map.p_safe.astype(np.float64))
    np.add.at(out[1], index, hazard_map.observed.astype(np.float64))
    return np.clip(out / np.maximum(count, 1.0), 0.0, 1.0).astype(np.float32)


def encode(observation: Observation, sites: int, shrunk: FloatArray) -> dict[str, FloatArray]:
    """Return the observation as arrays; offsets are from the site flown to now."""
    estimate = observation.estimate
    candidates = observation.candidates
    table = np.zeros((sites, len(SITE_COLUMNS)), np.float32)
    n = min(sites, len(candidates))
    if n:
        table[:n, :3] = np.clip(candidates.position[:n] - observation.site, -FAR, FAR)
        table[:n, 3] = np.clip(candidates.p_safe[:n], 0.0, 1.0)
        table[:n, 4] = np.where(candidates.reachable[:n], candidates.propellant[:n], FAR)
        table[:n, 5] = candidates.reachable[:n]
    pose = np.concatenate(
        (
            np.clip(estimate.position - observation.site, -FAR, FAR),
            np.clip(estimate.velocity, -FAR, FAR),
            np.clip(estimate.attitude, -1.0, 1.0),
        )
    )
    altitude = estimate.position[2] - observation.site[2]
    to_go = np.clip([observation.time_to_go, observation.propellant, altitude], 0.0, FAR)
    return {
        "estimate": pose.astype(np.float32),
        "hazard_map": shrunk,
        "sites": table,
        "to_go": to_go.astype(np.float32),
    }
