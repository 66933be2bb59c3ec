"""Random touchdowns on rasters of rough terrain."""

from __future__ import annotations

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.vehicle.state import State

FRAME = np.array([-6.0, -7.0, 0.1])  # position of the first post and posting, m


def random_touchdown(seed):
    """Return lander, state and heights (141, 121) at the posts of `FRAME`."""
    rng = np.random.default_rng(seed)
    dry = np.random.default_rng([seed, 1]).uniform(1000.0, 1500.0, 3)  # either axis has the lesser
    wet = dry * np.random.default_rng([seed, 2]).uniform(1.0, 1.3, 3)
    lander = Lander(
        legs=int(rng.choice([3, 4])), leg_radius=float(rng.uniform(1.0, 3.0)),
        inertia_dry=tuple(dry), inertia_full=tuple(wet),
    )  # fmt: skip
    tilt = np.add.outer(*(np.arange(n) * rng.uniform(-0.02, 0.02) for n in (141, 121)))
    z = (tilt + rng.uniform(0.0, 0.15) * rng.standard_normal((141, 121))).astype(np.float32)
    if seed % 7 == 0:
        z[60:64, 58:70] = np.nan
    q = rng.normal(size=4) * [0.05, 0.05, 1.0, 1.0]
    state = State(
        np.array([*rng.uniform(-3.5, 3.5, 2), 1.6 + 0.3 * rng.normal()]),
        rng.normal(size=3) * 0.6 - [0.0, 0.0, 2.0], q / np.linalg.norm(q),
        0.04 * rng.normal(size=3), rng.uniform(1100.0, 1500.0), 0.0,
    )  # fmt: skip
    return lander, state, z
