"""Where the safest sites are out of reach kernels propose others in it, as the computer does."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim_envs.descent.batch import FLYING
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.sites.flights import observation_of_lane
from tests.envs.site_scene import SMALL, lanes, made_up

# It may lean little: much of the ground is out of reach.
SHORT = SMALL.changed(
    approach={"max_tilt_deg": 20.0}, mappers={"dem": {"size_m": 80.0}},
    decisions={"first_altitude_m": 100.0, "last_altitude_m": 40.0},
)  # fmt: skip


def proposed(many, lane, within):
    """Return the sites that the computer would propose on what a lane is shown."""
    seen, decisions, maps = observation_of_lane(many, lane), many.decisions, many.maps
    lander, approach, law = SHORT.vehicle.make(), SHORT.approach.make(), SHORT.guidance.make()

    def cost_of(sites):
        end = approach.end(sites, lander)
        return law.cost(seen.estimate, end, lander, 1.622, approach.limits)

    def miss_of(left):
        until = np.where(np.isfinite(left), left, seen.time_to_go)
        drift = maps.miss_params[1] * (
            seen.time - maps.map_time[lane] + until + maps.miss_params[2]
        )
        return np.hypot(decisions.touchdown_sigma, drift)

    reach = ReachabilityMap.over_map(seen.hazard_map, seen.site, cost_of) if within else None
    return seen.candidates, candidate_sites(
        seen.hazard_map, maps.averaged[lane].copy(), seen.site, cost_of, count=decisions.candidates,
        separation=decisions.separation, miss_of=miss_of, reach=reach,
    )  # fmt: skip


def rounded(sites):
    return {tuple(np.round(one, 5)) for one in sites.position}


@pytest.fixture(scope="module")
def compared():
    """Return of each decision how many sites there are: here, there and alike.

    Also whether they are others than would be proposed wherever they lie, and how many more can be
    reached here than there.
    """
    many, rows = lanes(8, scenario=SHORT), []
    rng = np.random.default_rng(5)
    while (many.ended == FLYING).any() and len(rows) < 60:
        goal = np.full((8, 3), np.nan)
        for i in np.flatnonzero(many.ended == FLYING):
            mine, theirs = proposed(many, i, within=True)
            _, anywhere = proposed(many, i, within=False)
            a, b = rounded(mine), rounded(theirs)
            other = b != rounded(anywhere)
            reached = mine.reachable.sum() - theirs.reachable.sum()
            rows.append((len(a), len(b), len(a & b), other, reached))
            good = np.flatnonzero(mine.reachable)
            if len(good):
                goal[i] = mine.position[rng.choice(good)]
        many.decide(goal, np.ones(8, bool))
    return np.array(rows)


def test_sites_in_reach_take_the_place_of_others(compared):
    mine, theirs, alike, other, reached = compared.T
    assert other.sum() >= 5 and (~other.astype(bool)).sum() >= 5
    assert (alike == mine).all() and (alike == theirs).all()
    assert not reached.any()


def test_sites_in_reach_are_the_same_in_any_company():
    found = []
    for count in (1, 5):
        some = lanes(count, scenario=SHORT)
        for _ in range(3):
            n = int(some.candidates.number[0])
            goal = np.full((count, 3), np.nan)
            goal[0] = some.candidates.position[0, n // 2]
            some.decide(goal, np.ones(count, bool))
            found.append((n, some.candidates.position[0].copy(), some.candidates.p_safe[0].copy()))
    for a, b in zip(found[:3], found[3:], strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_a_site_out_of_reach_is_masked_and_flying_there_keeps_the_site():
    """In one environment and in a batch, also where nothing or only some of it can be reached."""
    settings = {
        "scenario": SHORT, "worlds": 2, "world_seed": 5, "surrogate": made_up(SHORT),
        "perception": "surrogate",
    }  # fmt: skip
    many = RetargetVectorEnv(8, **settings)
    _, info = many.reset(seed=1)
    found, partly = many.lanes.candidates, 0
    for _ in range(3):
        n = found.number[:, None]
        reached = np.isfinite(found.propellant[:, :20]) & (np.arange(20) < n)
        assert np.array_equal(info["action_mask"][:, 1:], reached)
        assert np.array_equal(many.action_masks()[:, 1:], reached)
        assert info["action_mask"][:, 0].all()
        shut = (np.arange(20) < n) & ~reached
        partly += (shut.any(axis=1) & reached.any(axis=1)).sum()
        before, chosen = (
            many.lanes.guidance.site.copy(),
            np.where(shut.any(1), shut.argmax(1) + 1, 0),
        )
        _, _, _, _, info = many.step(chosen)
        assert np.array_equal(many.lanes.guidance.site, before)
        assert np.array_equal(info["reward_terms"]["invalid"] < 0.0, chosen > 0)
    assert partly > 0
    one = RetargetEnv(**settings)
    _, info = one.reset(seed=1)  # as lane 0: all is out of reach
    assert one.flight.inputs.count[0] > 0 and info["action_mask"].tolist() == [1] + [0] * 20
    *_, told = one.step(1)
    assert told["reward_terms"]["invalid"] < 0.0
