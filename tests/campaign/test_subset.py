"""Rare failures by subset simulation, against closed forms and brute force."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import norm

from lunarsim.campaign.analysis import compute_arm_statistics
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.outcomes import attempt, import_function
from lunarsim.campaign.rare_failures import (
    estimate_failure_probability,
    estimate_failure_shares,
    level_variance,
    load_chains,
)
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.campaign.subset import SubsetLevel
from lunarsim.cli import main
from lunarsim.errors import InputError
from tests.campaign.limit_states import BETA, EAST
from tests.campaign.subset_surrogate import planned, spec


def in_memory(function: str, seed: int, flights: int, **more: object):
    """Return what a campaign that keeps nothing finds."""
    plan = planned(function, flights, seed, **more)
    for group in plan.chains.groups(lambda flight, arm: False):
        done = attempt(import_function(plan.work), plan.work, group, 0, {})
        plan.chains.add(group.flight, done.metrics or {})
    return estimate_failure_probability(plan.chains.levels)


def test_one_in_ten_thousand_from_a_thousand_flights(whole_subset):
    found = load_results(whole_subset)
    (made,) = estimate_failure_shares(found)
    assert made.low < 1e-4 < made.high and not made.is_approximate
    assert made.high / made.low < 50.0 and made.equivalent_flights > 3.0 * len(found.table)
    levels = load_chains(found).levels
    assert len(found.table) == 300 + 270 * (len(levels) - 1) < 1500
    # Thresholds are what a linear limit state must have at 0.1, 0.01, ... of the flights.
    for k, level in enumerate(levels[:-1]):
        assert BETA - level.threshold == pytest.approx(norm.isf(0.1 ** (k + 1)), abs=0.35)
        assert level.share == pytest.approx(0.1, abs=0.02)  # a state may be there twice
    table = found.table.to_pandas()
    assert list(table["level"].unique()) == list(range(len(levels)))
    assert (table["world"] <= table["flight"]).all()
    assert set(table.loc[table["level"] > 0, "chain"]) == set(range(30))
    kept = (table["world"] < table["flight"])[table["level"] > 0].mean()
    assert 0.35 < kept < 0.65


def test_what_is_even_is_never_taken_from_it(whole_subset, tmp_path):
    found = load_results(whole_subset)
    with pytest.raises(InputError, match="equal weights"):
        compute_arm_statistics(found)
    with pytest.raises(InputError, match="the spec defines the failure"):
        estimate_failure_shares(found, "slope_deg", above=1.0)
    done = CliRunner().invoke(main, ["campaign", "rare", str(whole_subset)])
    (made,) = estimate_failure_shares(found)
    assert done.exit_code == 0 and f"{made.value:.3g}" in done.output
    assert "acceptance rate" in done.output
    done = CliRunner().invoke(
        main, ["campaign", "report", str(whole_subset), "--out", str(tmp_path / "r.html")]
    )
    assert done.exit_code == 0, done.output
    page = (tmp_path / "r.html").read_text()
    assert "Subset simulation" in page and "Distance from failure" in page
    assert f'{made.value:.3g}<span class="range">[{made.low:.3g}, {made.high:.3g}]' in page


@pytest.mark.parametrize("all_taken", [True, False])
def test_steps_grow_where_many_are_taken_and_shrink_where_few_are(all_taken):
    """Of 0.44 taken they stay as they are; scores show by what scale a level was flown."""
    chains = planned("linear").chains
    steps = []
    for group in chains.groups(lambda flight, arm: False):
        flight, level = group.flight, group.draws["level"]
        if level == 3:
            break
        if level:
            now = chains.scores[chains.states[group.draws["chain"]][-1]]
            fresh = norm.ppf(chains.laws.uniforms(flight))
            steps.append((level, now, fresh, chains.scores[flight]))
        near = level == 0 or all_taken or flight % 5 == 0
        value = float(norm.isf((flight + 0.5) / 400)) if level == 0 else 2.5 + 1e-3 * flight
        chains.add(flight, {"slope_deg": value if near else -9.0})
    acceptance_rate = chains.levels[1].acceptance_rate
    assert acceptance_rate == 1.0 if all_taken else 0.1 < acceptance_rate < 0.3
    scales = {1: 0.6, 2: min(1.0, 0.6 * np.exp(acceptance_rate - 0.44))}
    for level, now, fresh, drawn in steps:
        s = scales[level]
        assert drawn == pytest.approx(np.sqrt(1.0 - s * s) * now + s * fresh, abs=1e-9)
    assert {level for level, *_ in steps} == {1, 2}


def test_what_chains_and_worlds_share_widens_and_errors_of_levels_add():
    """By hand: 100 flights of which 10 are near, then chains that are near from end to end."""
    apart = np.arange(100).reshape(100, 1)
    first = SubsetLevel(np.where(apart < 10, 1.0, 2.0), apart, 1.0, 0.1, np.nan, 0)
    assert level_variance(first) == pytest.approx(0.9 / (0.1 * 100))
    chains = np.repeat(np.arange(10)[:, None], 10, axis=1)
    # Ten states of a chain are worth one, whether its world is the same all along or not.
    for worlds in (chains, np.arange(100).reshape(10, 10)):
        last = SubsetLevel(np.where(chains < 1, -1.0, 1.0), worlds, 0.0, 0.1, 0.3, 0)
        assert level_variance(last) == pytest.approx(0.9 / (0.1 * 10))
        made = estimate_failure_probability([first, last])
        assert made.value == pytest.approx(0.01)
        assert made.variation == pytest.approx(0.3 + np.sqrt(0.9))
        wide, first_wide = (
            np.exp(norm.ppf(0.975) * np.sqrt(np.log(1.0 + v**2))) for v in (made.variation, 0.3)
        )
        # Ten worlds do not tell how often one fails: up to what comes as far as the last level.
        high = 0.1 * first_wide if worlds is chains else 0.01 * wide
        assert (made.low, made.high) == pytest.approx((0.01 / wide, high))
    assert estimate_failure_probability([first, replace(last, worlds=chains)]).worlds == 10
    # Two chains of one world, both near: their 20 states are worth less than two chains.
    of_one = SubsetLevel(np.where(chains < 2, -1.0, 1.0), np.maximum(chains, 1), 0.0, 0.2, 0.3, 0)
    assert level_variance(of_one) == pytest.approx((16.0**2 + 8 * 2.0**2) / 20.0**2)


def test_what_chance_decides_is_in_the_share():
    """Rocks and noise as a third of the spread, which no dispersion tells: worlds are drawn too."""
    made = [in_memory("noisy", seed, 300) for seed in range(6)]
    held = [m.low < 1e-4 < m.high for m in made]
    assert sum(held) >= 5
    middle = float(np.exp(np.mean(np.log([m.value for m in made]))))
    assert 0.2e-4 < middle < 5e-4
    # Were worlds never drawn anew, those of the last level would be few.
    kept = in_memory("noisy", 1, 300, subset={"metric": "slope_deg", "above": BETA,
                                              "same_world": 1.0})  # fmt: skip
    assert kept.worlds < min(m.worlds for m in made)


def test_two_sides_of_a_curved_limit_against_brute_force():
    limit = 4.3
    rng = np.random.default_rng(7)
    hits = count = 0
    for _ in range(20):
        a, b = rng.standard_normal((2, 500_000))
        hits += int((np.abs(a) + 0.2 * b * b >= limit).sum())
        count += len(a)
    brute, error = hits / count, np.sqrt(hits) / count
    assert 0.5e-4 < brute < 5e-4
    made = [
        in_memory("curved", seed, 300, subset={"metric": "slope_deg", "above": limit})
        for seed in (1, 2, 3)
    ]
    for m in made:
        assert m.low < brute + 2.0 * error and m.high > brute - 2.0 * error
    assert np.mean([m.value for m in made]) == pytest.approx(brute, rel=0.8)


def test_below_a_limit_is_as_above_the_other_way(tmp_path):
    plan = planned("linear", subset={"metric": "slope_deg", "below": -2.0, "levels": 3})
    run(plan, InlineEngine(), tmp_path / "c")
    (made,) = estimate_failure_shares(load_results(tmp_path / "c"))
    assert made.low < norm.cdf(-2.0) < made.high
    assert made.value == pytest.approx(norm.cdf(-2.0), rel=0.5)


def test_a_metric_with_steps_is_reported(tmp_path):
    ran = run(planned("stepped"), InlineEngine(), tmp_path / "c")
    assert (ran.state, ran.flown) == ("complete", 300)
    (made,) = estimate_failure_shares(load_results(tmp_path / "c"))
    # Of 300 flights none has failed: what Clopper and Pearson say of the 300.
    assert made.value == 0.0 and 0.001 < made.high < 0.2
    done = CliRunner().invoke(main, ["campaign", "rare", str(tmp_path / "c")])
    assert "does not measure the distance from failure" in done.output


def test_flights_without_the_metric_are_counted_and_taken_as_far_from_failure(tmp_path):
    ran = run(planned("patchy"), InlineEngine(), tmp_path / "c")
    (made,) = estimate_failure_shares(load_results(tmp_path / "c"))
    assert made.without_outcome == pytest.approx(0.2 * (ran.flown), rel=0.1)
    assert ran.failed == pytest.approx(0.1 * ran.flown, rel=0.1)
    # Eight in ten of those that would have failed.
    assert made.low < 0.8e-4 < made.high


@pytest.mark.slow
def test_intervals_hold_the_truth_at_least_as_often_as_they_say():
    for function, least in (("linear", 0.95), ("noisy", 0.9)):
        made = [in_memory(function, seed, 300) for seed in range(100)]
        held = np.mean([m.low < 1e-4 < m.high for m in made])
        values = np.array([m.value for m in made])
        told = np.median([m.variation for m in made])
        print(
            f"{function}: intervals of 95 % hold p in {held:.2f}, mean {values.mean():.2e}, "
            f"variation {values.std() / 1e-4:.2f}, told {told:.2f}"
        )
        assert held >= least
        assert abs(values.mean() - 1e-4) < 3.0 * values.std() / 10.0 + 0.25e-4


def test_the_plan_is_of_the_first_level(tmp_path):
    (tmp_path / "s.toml").write_text(spec().to_toml())
    done = CliRunner().invoke(main, ["campaign", "plan", str(tmp_path / "s.toml")])
    assert done.exit_code == 0 and len(done.output.splitlines()) == 301
    assert done.output.splitlines()[1].startswith("0-0,0,all,1,0,,0,")
    again = CampaignSpec.load(tmp_path / "s.toml")
    assert again.dispersions == spec().dispersions
    assert json.dumps(again.identity) == json.dumps(spec().identity)


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"subset": None}, "subset"),
        ({"method": "monte-carlo"}, "subset"),
        ({"subset": {"metric": "slope_deg"}}, "subset.below"),
        ({"subset": {"metric": "slope_deg", "above": 1.0, "below": 0.0}}, "subset.below"),
        ({"subset": {"metric": "safe", "below": 0.0}}, "subset.metric"),
        ({"subset": {"metric": "slope_deg", "above": 1.0, "keep": 0.3}}, "subset.keep"),
        ({"subset": {"metric": "slope_deg", "above": 1.0, "keep": 0.6}}, "subset.keep"),
        ({"subset": {"metric": "slope_deg", "above": 1.0, "levels": 0}}, "subset.levels"),
        ({"subset": {"metric": "slope_deg", "above": 1.0, "p0": 0.1}}, "subset.p0"),
        ({"subset": 3}, "subset"),
        ({"flights": 305}, "flights"),
        ({"flights": 90}, "flights"),
        ({"dispersions": {}}, "method"),
        ({"factors": {"policy": ["safest", "no-divert"]}}, "factors"),
        ({"arms": [{"name": "a"}, {"name": "b", "set": {"policy": "safest"}}]}, "arms"),
        ({"stop": {"metric": "safe", "width": 0.1}}, "stop"),
        ({"importance": {"shifts": {EAST: 1.0}}}, "importance"),
    ],
    ids=str,
)
def test_bad_subsets_are_refused(more, field):
    with pytest.raises(InputError) as refused:
        spec(**more)
    assert refused.value.field == field


def test_at_the_limit_is_not_beyond_it_and_a_plain_share_has_a_plain_interval():
    made = in_memory("clipped", 1, 300, subset={"metric": "slope_deg", "above": 0.0})
    assert made.low < 0.5 < made.high < 0.6
    all_of_them = in_memory("certain", 1, 300, subset={"metric": "slope_deg", "above": 0.0})
    assert (all_of_them.value, all_of_them.high) == (1.0, 1.0) and 0.98 < all_of_them.low < 0.995


def test_half_of_each_level_may_be_kept():
    """States that are there twice make it more than half: that is no metric with steps."""
    subset = {"metric": "slope_deg", "above": BETA, "keep": 0.5, "levels": 20}
    made = in_memory("linear", 1, 200, subset=subset)
    assert 0.0 < made.low < 1e-4 < made.high


def test_of_flights_equally_near_those_that_go_on_are_drawn():
    """Ten are nearer than a hundred others: were all ten to go on, 0.09 would count as a third."""
    chains = planned("linear").chains
    for group in chains.groups(lambda flight, arm: False):
        if group.flight == 300:
            break
        value = 2.0 if group.flight < 10 else 1.0 if group.flight < 110 else 0.0
        chains.add(group.flight, {"slope_deg": value})
    begin = [states[0] for states in chains.states]
    assert len(set(begin)) == 30 and max(begin) < 110
    assert sum(flight < 10 for flight in begin) < 8
    assert chains.levels[0].share == pytest.approx(110 / 300)


def test_as_near_as_the_threshold_is_near_enough():
    """Of a metric with steps whole levels lie on it."""
    chains = planned("linear").chains
    for group in chains.groups(lambda flight, arm: False):
        if group.draws["level"] == 2:
            break
        value = 2.0 if group.flight < 10 else 1.0 if group.flight < 110 else 0.0
        chains.add(group.flight, {"slope_deg": value if group.flight < 300 else 1.0})
    assert chains.levels[1].acceptance_rate == 1.0


def test_where_worlds_decide_and_few_are_left_the_interval_says_so():
    """Nine tenths of the variance are the world's: the value lies far under p, the interval not."""
    made = [in_memory("rugged", seed, 200) for seed in range(12)]
    assert sum(m.low <= 1e-4 <= m.high for m in made) >= 11
    assert all(m.worlds < 20 for m in made)
    # By the levels' own errors most would end too low.
    assert sum(m.value < 5e-5 for m in made) >= 6
