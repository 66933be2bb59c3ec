"""Rare failures by importance sampling, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import norm, truncnorm

from lunarsim.campaign.analysis import compare_campaigns, compute_arm_statistics, differences
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.plan import Work
from lunarsim.campaign.rare_failures import estimate_failure_shares, estimate_weighted_share
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.campaign.sensitivity import sensitivities
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.errors import InputError
from tests.worlds import TINY_FLIGHT

EAST, NORTH, UP = (f"start.position_m.{i}" for i in range(3))
LAWS = {
    EAST: {"kind": "normal", "mean": -600.0, "sigma": 10.0},
    NORTH: {"kind": "normal", "mean": 0.0, "sigma": 5.0},
}
# Fails where the sum of both scores, over the root of 2, is beyond this: once in 10,000.
BETA = float(norm.isf(1e-4))


def spec(flights: int = 1500, seed: int = 1, **more: object) -> CampaignSpec:
    given = {
        "name": "r", "flights": flights, "seed": seed, "scenario": TINY_FLIGHT,
        "method": "importance", "dispersions": LAWS,
        "importance": {"shifts": {EAST: 2.6, NORTH: 2.6}},
    }  # fmt: skip
    return CampaignSpec.from_dict(given | more)


def fall(study, group, arm, memory):
    """A linear limit state."""
    score = ((group.draws[EAST] + 600.0) / 10.0 + group.draws[NORTH] / 5.0) / np.sqrt(2.0)
    return {"safe": bool(score < BETA), "score": float(score), "policy": ""}


def flown(folder, flights: int = 1500, seed: int = 1, **more: object):
    columns = {"safe": "bool", "score": "float"}
    plan = build_plan(spec(flights, seed, **more))
    plan = replace(plan, work=Work("tests.campaign.test_rare:fall"), columns=columns)
    run(plan, InlineEngine(), folder)
    return load_results(folder)


@pytest.mark.parametrize("seed", [1, 2])
def test_one_in_ten_thousand_from_a_thousand_flights(tmp_path, seed):
    found = flown(tmp_path / "c", seed=seed)
    (made,) = estimate_failure_shares(found)
    assert made.low < 1e-4 < made.high
    assert made.high / made.low < 1.5 and made.failures > 300 and made.without_outcome == 0
    # Brute force would need so many flights for the same error.
    assert made.equivalent_flights > 5e5
    (same,) = estimate_failure_shares(found, "score", above=BETA)
    assert same == made
    (other,) = estimate_failure_shares(found, "score", below=0.0)
    assert other.low < 0.5 < other.high
    done = CliRunner().invoke(main, ["campaign", "rare", str(tmp_path / "c")])
    assert done.exit_code == 0 and f"{made.value:.3g}" in done.output


def test_intervals_hold_the_truth_as_often_as_they_say():
    """On draws of the same mixture, as arrays: 400 studies of 300 draws."""
    rng = np.random.default_rng(5)
    shift, share, studies, count = 2.6, 0.1, 400, 300
    lean = rng.random((studies, count)) >= share
    z = rng.standard_normal((studies, count, 2)) + shift * lean[..., None]
    ratio = np.exp(shift * z.sum(axis=-1) - shift**2)
    weights = 1.0 / (share + (1.0 - share) * ratio)
    hits = z.sum(axis=-1) / np.sqrt(2.0) > BETA
    made = [estimate_weighted_share(h, w, 1.0 / share) for h, w in zip(hits, weights, strict=True)]
    value, low, high, _ = np.array(made).T
    assert 0.92 < np.mean((low < 1e-4) & (high > 1e-4)) < 0.98
    assert abs(value.mean() - 1e-4) < 3.0 * value.std() / np.sqrt(studies)
    assert estimate_weighted_share(np.zeros(100, bool), np.ones(100), 10.0)[:2] == (0.0, 0.0)
    # None of 100, each with the greatest weight: 10 times what Clopper and Pearson say.
    assert estimate_weighted_share(np.zeros(100, bool), np.ones(100), 10.0)[2] == pytest.approx(
        10.0 * (1.0 - 0.05 ** (1.0 / 100.0))
    )


@pytest.mark.parametrize(
    ("keys", "beta", "shift", "scale", "flights"),
    [(1, 2.326, 8.0, 1.0, 300), (1, 2.326, 8.0, 1.0, 1500), (1, 2.326, 5.0, 1.0, 300),
     (1, 2.326, -3.0, 1.0, 1500), (1, 2.326, 6.0, 2.0, 300), (2, BETA, 4.0, 1.0, 1500),
     (2, BETA, 1.5, 1.0, 300), (2, BETA, 0.0, 3.0, 300)],
)  # fmt: skip
def test_intervals_hold_the_truth_where_draws_lean_badly_too(keys, beta, shift, scale, flights):
    """Shifts far beyond the limit, to the other side, short of it, and wide draws without any."""
    rng, share, studies = np.random.default_rng(3), 0.1, 300
    held = []
    for _ in range(studies):
        z = rng.standard_normal((flights, keys))
        lean = rng.random(flights) >= share
        z[lean] = shift + scale * z[lean]
        ratio = np.prod(norm.pdf(z, shift, scale) / norm.pdf(z), axis=1)
        weights = 1.0 / (share + (1.0 - share) * ratio)
        hits = z.sum(axis=1) / np.sqrt(keys) > beta
        _, low, high, _ = estimate_weighted_share(hits, weights, 1.0 / share)
        held.append(low < norm.sf(beta) < high)
    assert np.mean(held) > 0.92


def test_weights_give_back_the_declared_laws():
    """Whatever is shifted and scaled, weighted draws have the moments of the law as declared."""
    laws = LAWS | {
        UP: {"kind": "truncated-normal", "mean": 500.0, "sigma": 10.0, "low": 490.0},
        "rocks.cover": {"kind": "uniform", "low": 0.02, "high": 0.1},
    }
    made = spec(
        2500,
        dispersions=laws,
        importance={
            "shifts": {EAST: 1.0, UP: -0.7, "rocks.cover": 0.5},
            "scales": {NORTH: 1.4},
            "nominal_share": 0.3,
        },
        correlations=[{"keys": [EAST, UP], "matrix": [[1.0, 0.6], [0.6, 1.0]]}],
    )
    drawn = [made.dispersions.draws(i) for i in range(2500)]
    weights = np.array([made.dispersions.weight(i) for i in range(2500)])
    assert abs(weights.mean() - 1.0) < 0.04 and weights.max() <= 1.0 / 0.3
    up = truncnorm(-1.0, np.inf, 500.0, 10.0)
    for key, mean, sigma in (
        (EAST, -600.0, 10.0), (NORTH, 0.0, 5.0), (UP, up.mean(), up.std()),
        ("rocks.cover", 0.06, 0.08 / np.sqrt(12.0)),
    ):  # fmt: skip
        score = (np.array([d[key] for d in drawn]) - mean) / sigma
        for power, moment in ((1, 0.0), (2, 1.0)):
            each = weights * (score**power - moment)
            assert abs(each.mean()) < 4.0 * each.std() / np.sqrt(2500), (key, power)


def test_a_flight_depends_on_its_index_alone_and_more_can_be_asked_for(tmp_path):
    flown(tmp_path / "c", 10)
    flown(tmp_path / "c", 30)
    flown(tmp_path / "d", 30)
    name = Path("results") / "part-00000.parquet"
    assert (tmp_path / "c" / name).read_bytes() == (tmp_path / "d" / name).read_bytes()
    again = CampaignSpec.from_dict(spec().to_dict())
    assert again.dispersions == spec().dispersions
    assert again.dispersions.weight(7) == spec().dispersions.weight(7)


def test_flights_that_lean_are_never_taken_as_even(tmp_path):
    found = flown(tmp_path / "c", 60)
    for refused in (
        lambda: compute_arm_statistics(found),
        lambda: differences(found),
        lambda: compare_campaigns(found, found, 0.05),
        lambda: sensitivities(found, "score"),
    ):
        with pytest.raises(InputError, match="equal weights"):
            refused()
    done = CliRunner().invoke(main, ["campaign", "report", str(tmp_path / "c")])
    assert done.exit_code == 0, done.output
    page = (tmp_path / "c" / "report.html").read_text()
    (made,) = estimate_failure_shares(found)
    told = f'{made.value:.3g}<span class="range">[{made.low:.3g}, {made.high:.3g}]'
    assert told in page and "Importance sampling" in page
    even = flown(tmp_path / "e", 3, method="monte-carlo", importance=None)
    with pytest.raises(InputError, match="method importance"):
        estimate_failure_shares(even)
    for metric, limits in (("score", {}), ("safe", {"above": 1.0}), ("nothing", {})):
        with pytest.raises(InputError) as refused:
            estimate_failure_shares(found, metric, **limits)
        assert refused.value.field == "--metric"


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"importance": None}, "importance"),
        ({"method": "monte-carlo"}, "importance"),
        ({"importance": {"shifts": {EAST: 0.0}}}, "importance.shifts"),
        ({"importance": {"shifts": {EAST: 9.0}}}, "importance.shifts"),
        ({"importance": {"scales": {EAST: 0.0}}}, "importance.scales"),
        ({"importance": {"shifts": {EAST: 4.0}, "scales": {EAST: 0.3}}}, "importance.scales"),
        ({"importance": {"shifts": {UP: 1.0}}}, "importance.shifts"),
        ({"importance": {"shifts": {EAST: 1.0}, "nominal_share": 0.0}}, "importance.nominal_share"),
        ({"importance": {"shift": {EAST: 1.0}}}, "importance.shift"),
        ({"importance": 3}, "importance"),
        ({"stop": {"metric": "safe", "width": 0.1}}, "stop"),
    ],
    ids=str,
)
def test_bad_importance_is_refused(more, field):
    with pytest.raises(InputError) as refused:
        spec(**more)
    assert refused.value.field == field
