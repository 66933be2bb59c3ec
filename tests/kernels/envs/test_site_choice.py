"""Proofs that sites are out of reach, against diverts to many sites."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim_envs.sites import _beyond_kernels as b
from lunarsim_envs.sites import _flight_kernels as f
from lunarsim_envs.sites import reachable_candidates as stead
from tests.envs.site_scene import lanes
from tests.reference.divert import reachable


@pytest.fixture(scope="module")
def boxes():
    """Return boxes of targets about landers in flight: lander, box, and whether it is proven lost.

    The last is what `reach` says of targets all over it.
    """
    many, rng, told = lanes(3), np.random.default_rng(7), []
    law, lander = many.law, many.craft.dynamics.lander
    for _ in range(5):
        for i in range(3):
            state = np.empty((2, 3))
            f.estimate_state(many.y[i], many.guidance.drift_velocity[i], many.time[i], state)
            state[1, :2] += rng.normal(0.0, 8.0, 2)
            state[1, 2] = -rng.uniform(1.0, 25.0)
            how = stead.reach_lander(state, float(rng.uniform(1150.0, 1500.0)), law)
            for _ in range(40):
                side = rng.choice([1.0, 4.0, 16.0]) * np.array([1.0, 1.0, 0.2])
                low = state[0] * [1, 1, 0] + rng.normal(0.0, 200.0, 3) * [1, 1, 0.02]
                proven = b.is_unreachable(
                    how.paths,
                    state,
                    low,
                    low + side,
                    how.speed,
                    how.max_acceleration,
                    law,
                    how.params,
                )
                sites = low + side * rng.random((64, 3)) - law.end_offset
                out = np.empty((64, 4))
                f.compute_divert_costs(state, how.mass, sites, law, out)
                told.append((state, how.mass, sites, proven, np.isfinite(out[:, 0]).any()))
        many.decide(np.full((3, 3), np.nan), np.ones(3, bool))
    return law, lander, told


def test_nothing_in_reach_is_proven_to_be_out_of_it(boxes):
    law, lander, told = boxes
    proven = np.array([one[3] for one in told])
    reached = np.array([one[4] for one in told])
    assert proven.sum() > 100 and reached.sum() > 100
    assert not (proven & reached).any()
    # And most of what is out of reach is proven to be, else it were no use.
    assert proven[~reached].mean() > 0.8
    some = [one for one in told if one[3]][::5]
    g, _, exhaust, least, most, tilt, glide, _ = law.paths.params
    for state, mass, sites, _, _ in some:
        for site in sites[:3]:
            burnt = reachable(
                state[0], state[1], site + law.end_offset, *law.paths.final, g, mass, exhaust,
                least, most, tilt, glide, lander.dry_mass, times=300, samples=32,
            )  # fmt: skip
            assert burnt == np.inf


def test_nothing_is_proven_of_paths_that_end_in_an_acceleration_or_without_a_cone(boxes):
    law, _, told = boxes
    state, mass, sites, _, _ = next(one for one in told if one[3])
    low, high = sites.min(axis=0), sites.max(axis=0)
    for other in (
        law._replace(paths=law.paths._replace(final=law.paths.final + [[0.0], [0.1]])),
        law._replace(paths=law.paths._replace(params=np.append(law.paths.params[:6], 0.0))),
    ):
        how = stead.reach_lander(state, mass, other)
        assert not b.is_unreachable(
            how.paths, state, low, high, how.speed, how.max_acceleration, other, how.params
        )  # fmt: skip
