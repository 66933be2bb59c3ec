"""Compiled rewards of descents against the same in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.core.touchdown import VALUES
from lunarsim.scenario import Scenario
from lunarsim_envs.descent.batch import (
    AWAY,
    FLYING,
    LANDED,
    LATE,
    LOST,
    DescentBatch,
    VehicleParams,
)
from lunarsim_envs.descent.rewards import DescentWeights, Rewards
from lunarsim_envs.descent.worlds import WorldPool
from tests.reference import descent_reward as plain

COUNT = 4000
MOTION = [VALUES.index(name) for name in ("vertical_speed", "horizontal_speed", "tilt", "rate")]
WEIGHTS = [
    DescentWeights(
        safe=7.0, crash=-2.0, no_landing=-9.0, propellant=0.003, miss=0.04, severity=0.7,
        excess=0.3, shaping=1.3,
    ),
    DescentWeights(),
    DescentWeights(safe=9, crash=-1, shaping=0),  # whole numbers
]  # fmt: skip


@pytest.fixture(scope="module")
def lanes():
    """Return landers at any place, of which some are near the target and some far away."""
    scenario = Scenario.from_dict({"terrain": {"size_m": 60.0}, "rocks": {"cover": 0.0}})
    lanes = DescentBatch(
        COUNT, VehicleParams.of(scenario), WorldPool.of(scenario, 1, 0), guided=True, rate=5.0
    )
    lander, rng = lanes.craft.dynamics.lander, np.random.default_rng(3)
    scale = 10.0 ** rng.uniform(-2.0, 3.5, (COUNT, 1))
    lanes.target[:] = rng.normal(0.0, 20.0, (COUNT, 3))
    lanes.y[:, :3] = lanes.target + scale * rng.normal(0.0, 1.0, (COUNT, 3))
    lanes.y[:, 3:6] = 0.1 * scale * rng.normal(0.0, 1.0, (COUNT, 3))
    lanes.y[:, 10:13] = rng.normal(0.0, 0.2, (COUNT, 3))
    lanes.y[:, 13] = rng.uniform(1000.0, 1500.0, COUNT)
    lanes.ended[:] = rng.choice([FLYING, LANDED, LOST, LATE, AWAY], COUNT)
    lanes.failed[:] = np.where(rng.random(COUNT) < 0.5, 0, rng.integers(1, 512, COUNT))
    # From well within the limits to far above the largest excess that counts, either sign.
    limits = np.array(
        [lander.vertical_speed_limit, lander.horizontal_speed_limit, lander.tilt_limit,
         lander.rate_limit]
    )  # fmt: skip
    ratio = np.exp(rng.uniform(-2.0, 5.0, (COUNT, 4))) * rng.choice([-1.0, 1.0], (COUNT, 4))
    odd = rng.random((COUNT, 4)) < 0.1
    ratio[odd] = rng.choice([1.0, 0.0, np.exp(3.0), np.inf, -np.inf, np.nan], odd.sum())
    lanes.touchdown_values[:] = np.nan
    lanes.touchdown_values[:, MOTION] = ratio * limits
    lanes.touchdown_values[lanes.ended == LOST] = np.nan
    return lanes


@pytest.mark.parametrize("weights", WEIGHTS)
def test_terms_are_those_of_numpy(lanes, weights):
    rewards, rng = Rewards(weights, lanes), np.random.default_rng(4)
    moved, started = rng.random(COUNT) < 0.8, rng.random(COUNT) < 0.9
    rewards.begin(started)
    mass = np.where(started, lanes.y[:, 13], 0.0)
    first = plain.potential(
        lanes.y, lanes.target, weights, lanes.craft.dynamics.lander, lanes.craft.dynamics.gravity
    )
    assert rewards.potential() == pytest.approx(first, rel=1e-14)
    before = mass, np.where(started, first, 0.0)
    landed, lost = (np.isin(lanes.ended, ends) for ends in ((LANDED, LOST), (LATE, AWAY)))
    safe = (lanes.ended == LANDED) & (lanes.failed == 0)
    arguments = (
        lanes.target, landed, lost, safe, lanes.touchdown_values[:, MOTION],
    )  # fmt: skip
    y = lanes.y.copy()
    for _ in range(2):  # the second step starts with what the first has stored
        lanes.y[:, 13] -= rng.uniform(0.0, 3.0, COUNT)
        lanes.y[:, 3:6] += rng.normal(0.0, 1.0, (COUNT, 3))
        found = rewards.terms(moved)
        wanted = plain.terms(moved, lanes.y, *arguments, before, weights, lanes.craft)
        assert tuple(found) == tuple(wanted) == Rewards.names
        for name, term in wanted.items():
            assert found[name] == pytest.approx(term, rel=1e-13, abs=1e-13), name
        over = landed | lost
        after = np.where(over, 0.0, rewards.potential())
        before = tuple(
            np.where(moved, new, old)
            for new, old in zip((lanes.y[:, 13], after), before, strict=True)
        )
    lanes.y[:] = y


def test_landers_do_not_depend_on_their_number(lanes):
    """Terms of one lander and of many are bitwise the same."""
    every = np.ones(COUNT, np.bool_)
    rewards = Rewards(WEIGHTS[0], lanes)
    rewards.begin(every)
    many = rewards.terms(every)
    one = DescentBatch(1, lanes.craft, lanes.worlds, guided=True, rate=5.0)
    for i in range(40):
        for name in ("y", "target", "ended", "failed", "touchdown_values"):
            getattr(one, name)[0] = getattr(lanes, name)[i]
        alone = Rewards(WEIGHTS[0], one)
        alone.begin(every[:1])
        for name, term in alone.terms(every[:1]).items():
            assert term[0] == many[name][i]
