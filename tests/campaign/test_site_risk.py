"""Thresholds of p_safe of a campaign, and the command that prints them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.results import Results
from lunarsim.campaign.run import run
from lunarsim.campaign.site_risk import site_risk_thresholds
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.evaluation.risk_control import risk_threshold
from tests.campaign.surrogate import plan

COLUMNS = {"safe": "bool", "aborted": "bool", "p_safe": "float", "touchdown_exactly_safe": "bool"}


def campaign(p_safe, safe, aborted=(), outcome=(), method="monte-carlo"):
    """Results of one arm; flights in `aborted` abort, those in `outcome` have no outcome."""
    n = len(p_safe)
    table = pa.table({
        "flight": list(range(n)), "arm": ["A"] * n,
        "outcome": ["error" if i in outcome else FLOWN for i in range(n)],
        "p_safe": [None if i in outcome else float(p) for i, p in enumerate(p_safe)],
        "safe": [None if i in outcome else bool(s) for i, s in enumerate(safe)],
        "aborted": [i in aborted for i in range(n)],
        "touchdown_exactly_safe": [True] * n,
    })  # fmt: skip
    manifest = {"arms": [{"name": "A"}], "columns": COLUMNS, "inputs": {},
                "identity": {"method": method, "dispersions": {"x": 0}}}  # fmt: skip
    return Results(None, manifest, table, pa.table({}))


def test_the_threshold_is_that_of_the_last_sites_and_landings():
    rng = np.random.default_rng(1)
    p = rng.uniform(0.5, 1.0, 300)
    safe = rng.random(300) < p
    found = site_risk_thresholds(campaign(p, safe), max_risk=0.1, confidence=0.9)["A"]
    assert found == risk_threshold(p, ~safe, max_risk=0.1, confidence=0.9)
    assert 0.6 < found.threshold < 0.9
    other = site_risk_thresholds(campaign(p, safe), "touchdown_exactly_safe")["A"]
    assert (other.used, other.failed) == (300, 0)


def test_an_abort_is_no_failure_and_a_missing_outcome_is_one():
    p, safe = np.full(100, 0.9), np.ones(100, bool)
    safe[:8] = False
    assert site_risk_thresholds(campaign(p, safe))["A"].used == 0
    aborted = site_risk_thresholds(campaign(p, safe, aborted=range(8)))["A"]
    assert (aborted.used, aborted.failed) == (92, 0)
    without = site_risk_thresholds(campaign(p, safe, range(8), range(50, 52)), max_risk=0.08)["A"]
    assert (without.threshold, without.used, without.failed) == (0.9, 92, 2)
    assert site_risk_thresholds(campaign(p, safe, range(8), range(50, 52)))["A"].threshold == np.inf


def test_repeated_worlds_of_a_design_count_once_and_weights_are_refused():
    p, safe = np.full(120, 0.9), np.ones(120, bool)
    saltelli = campaign(p, safe, method="saltelli")
    # Of each block of four flights, the first and the last fly independent worlds.
    assert site_risk_thresholds(saltelli)["A"].worlds == 60
    with pytest.raises(InputError, match="equal weights"):
        site_risk_thresholds(
            replace(saltelli, manifest=saltelli.manifest | {"identity": {"method": "subset"}})
        )


def test_a_number_of_flights_that_depends_on_outcomes_is_refused():
    found = campaign(np.full(120, 0.9), np.ones(120, bool))
    found.manifest["identity"]["stop"] = {"metric": "safe", "width": 0.1}
    with pytest.raises(InputError, match="without \\[stop\\]"):
        site_risk_thresholds(found)


@pytest.mark.parametrize("method", ["latin-hypercube", "sobol"])
def test_designs_whose_flights_depend_on_each_other_are_refused(method):
    found = campaign(np.full(120, 0.9), np.ones(120, bool), method=method)
    with pytest.raises(InputError, match=f"independent flights.*{method}"):
        site_risk_thresholds(found)


def test_an_unknown_metric_is_refused_with_a_suggestion():
    with pytest.raises(InputError, match="Did you mean 'safe'"):
        site_risk_thresholds(campaign(np.ones(3), np.ones(3, bool)), "saef")


def test_the_command_prints_each_arm_and_exits_with_1_without_a_threshold(monkeypatch):
    p, safe = np.full(100, 0.9), np.ones(100, bool)
    monkeypatch.setattr("lunarsim.campaign.results.load_results", lambda _: campaign(p, safe))
    found = CliRunner().invoke(main, ["campaign", "threshold", "folder"])
    assert found.exit_code == 0, found.output
    assert "0.9000" in found.output and "0.0295" in found.output  # 1 - 0.05^(1/100)
    found = CliRunner().invoke(main, ["campaign", "threshold", "folder", "--max-risk", "0.02"])
    assert found.exit_code == 1
    assert "none" in found.output and "149" in found.output
    assert math.ceil(math.log(0.05) / math.log(0.98)) == 149


def test_a_campaign_without_the_columns_is_refused(tmp_path):
    run(plan(flights=4), InlineEngine(), tmp_path / "c")
    found = CliRunner().invoke(main, ["campaign", "threshold", str(tmp_path / "c")])
    assert found.exit_code == 2
    assert "p_safe" in found.output and "result column" in found.output
