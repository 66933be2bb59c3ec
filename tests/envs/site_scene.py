"""A small pool of worlds and landers over it, that tests of choosing sites share."""

from __future__ import annotations

import json
from functools import cache

import numpy as np

from lunarsim.scenario import Scenario
from lunarsim_envs.sites import hazard
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.field_of_view import fov_and_footprint
from lunarsim_envs.sites.pool import SiteWorldPool
from lunarsim_envs.sites.surrogate import (
    LENGTHS,
    MOST,
    NODES,
    Surrogate,
    exact_errors,
    surrogate_tables,
)

SMALL = Scenario.from_dict({
    "name": "sites",
    "terrain": {"kind": "fractal", "size_m": 90.0, "rms_slope_deg": 3.0},
    "rocks": {"cover": 0.1, "min_diameter_m": 0.3},
    "target": {"scatter_m": [8.0, 8.0]},
    "start": {
        "position_m": [-250.0, 40.0, 230.0], "velocity_m_s": [20.0, 0.0, -14.0],
        "position_sigma_m": 3.0,
    },
    "tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": [180.0, 110.0]}},
    "mappers": {"dem": {"kind": "gaussian-dem", "size_m": 50.0, "posting_m": 0.4}},
})  # fmt: skip


@cache
def pool():
    return SiteWorldPool.of(SMALL, 2, 5)


def made_up(scenario=SMALL, **changes):
    """Return a surrogate by hand: what is told falls with the size of the hazard."""
    size = hazard.size_class(np.arange(hazard.COUNT, dtype=np.uint8)) / len(hazard.SIZES)
    z = np.linspace(-MOST, MOST, NODES)
    told = 1.0 / (1.0 + np.exp(8.0 * (size[:, None] - 0.6) - z[None, :]))
    tables = np.stack([[told, told**0.5]] * 2)
    weights = np.zeros((2, 2, len(LENGTHS)))
    weights[..., 0], weights[..., 3] = 0.2, 0.8
    held = {
        "shares": np.array([0.2, 0.8]), "tables": tables, "common": np.full((2, 2), 0.3),
        "weights": weights, "stretch": np.full((2, 2), 1.2), "kept": 0.4,
        "drift": np.array([0.02, 0.05]), "reported_velocity_sigma": 0.03,
        "altitudes": np.array([180.0, 110.0]),
        "made_for": json.dumps(surrogate_tables(scenario)),
    }  # fmt: skip
    return Surrogate(**(held | changes))


def lanes(count=1, keys=range(1000), perception="surrogate", kind=SiteDescentBatch, scenario=SMALL):
    """Return lanes at their first decision, each flight of its key."""
    model = made_up()
    truth = perception == "truth"
    errors = exact_errors() if truth else model.errors(pool().shares, 0.4)
    many = kind(
        count, scenario, pool(), errors=errors, view=fov_and_footprint(scenario),
        drift_sigma=np.zeros(2) if truth else model.drift,
        reported_velocity_sigma=0.0 if truth else model.reported_velocity_sigma,
        posting=0.4,
    )  # fmt: skip
    every = np.ones(count, bool)
    many.seed(every, np.array(list(keys)[:count], np.uint64) * np.uint64(7919))
    many.begin(every)
    return many
