"""Short descents from 25 m up, which tests of the environments share."""

from __future__ import annotations

import gymnasium

IDS = ("lunarsim/Guidance-v1", "lunarsim/Control-v1")
LOW = {
    "start.position_m": [-20.0, 5.0, 25.0], "start.velocity_m_s": [3.0, 0.0, -4.0],
    "start.position_sigma_m": 2.0, "start.velocity_sigma_m_s": 0.5, "terrain.size_m": 120.0,
    "simulation.max_time_s": 20.0,
}  # fmt: skip


def batch(name, count, **arguments):
    """Return so many of them in one batch."""
    return gymnasium.make_vec(
        f"lunarsim_envs:{name}", num_envs=count, vectorization_mode="vector_entry_point",
        changes=LOW, **arguments,
    )  # fmt: skip
