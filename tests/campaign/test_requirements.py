"""Requirements of a campaign against exact sums, known numbers of flights and simulated truth."""

from __future__ import annotations

import json
from dataclasses import replace
from math import comb

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.requirements import (
    Requirement,
    load_requirements,
    needed_flights,
    tolerance_rank,
    verify,
    verify_values,
)
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.cli import main
from lunarsim.errors import InputError
from tests.campaign.surrogate import plan
from tests.chance import sample_sizes


def at_most_violations(violations: int, flights: int, fraction: float) -> float:
    """Return the probability of at most k violations if a `fraction` keeps the limit."""
    return sum(
        comb(flights, j) * (1.0 - fraction) ** j * fraction ** (flights - j)
        for j in range(violations + 1)
    )


@pytest.mark.parametrize(
    ("fraction", "level", "flights"), [(0.95, 0.95, 59), (0.99, 0.9, 230), (0.99, 0.95, 299)]
)
def test_without_violations_the_numbers_of_flights_are_those_of_wilks(fraction, level, flights):
    assert needed_flights(0, fraction, level) == flights
    assert tolerance_rank(flights, fraction, level) == flights
    assert tolerance_rank(flights - 1, fraction, level) is None


@pytest.mark.parametrize("violations", [0, 1, 3, 10])
@pytest.mark.parametrize(("fraction", "level"), [(0.9, 0.9), (0.95, 0.99)])
def test_a_requirement_passes_from_the_first_number_that_the_binomial_sum_allows(
    violations, fraction, level
):
    needed = needed_flights(violations, fraction, level)
    assert at_most_violations(violations, needed, fraction) <= 1.0 - level
    assert at_most_violations(violations, needed - 1, fraction) > 1.0 - level
    one = Requirement("A", "x", at_most=1.0, percentage=100 * fraction, confidence=100 * level)
    for flights, status in ((needed, "pass"), (needed - 1, "open")):
        values = np.repeat([2.0, 0.5], [violations, flights - violations])
        found = verify_values(one, "arm", values)
        assert (found.status, found.missing_flights) == (status, needed - flights)
        assert found.violations == violations
        # Bound and status agree: the order statistic keeps the limit exactly if it passes.
        assert (found.margin >= 0.0) == (status == "pass")


def test_a_violation_that_is_shown_fails():
    one = Requirement("A", "x", at_most=1.0, percentage=95.0, confidence=90.0)
    values = np.repeat([2.0, 0.5], [20, 80])
    # With 95 % of all flights within the limit, 20 violations of 100 are this unlikely:
    assert 1.0 - at_most_violations(19, 100, 0.95) < 0.1
    assert verify_values(one, "arm", values).status == "fail"
    values = np.repeat([2.0, 0.5], [7, 93])
    assert 1.0 - at_most_violations(6, 100, 0.95) > 0.1
    assert verify_values(one, "arm", values).status == "open"


@sample_sizes(500, 4_000)
def test_tolerance_bounds_cover_the_true_percentile_as_often_as_stated(count):
    """Campaigns of 100 normal values: the bound must exceed the true 95th percentile."""
    rng, covered = np.random.default_rng(5), 0
    one = Requirement("A", "x", at_most=0.0, percentage=95.0, confidence=90.0)
    for _ in range(count):
        covered += verify_values(one, "arm", rng.normal(size=100)).bound >= 1.6448536
    exact = sum(comb(100, j) * 0.95**j * 0.05 ** (100 - j) for j in range(99))
    assert exact >= 0.9
    assert covered / count == pytest.approx(exact, abs=4.0 * np.sqrt(exact * (1 - exact) / count))


def test_lower_limits_mirror_upper_limits():
    values = np.random.default_rng(1).normal(size=80)
    upper = verify_values(Requirement("A", "x", at_most=1.2, percentage=90.0), "arm", values)
    lower = verify_values(Requirement("A", "x", at_least=-1.2, percentage=90.0), "arm", -values)
    assert (lower.percentile, lower.bound) == (-upper.percentile, -upper.bound)
    assert lower.margin == pytest.approx(upper.margin)
    assert lower.violations == upper.violations > 0


def test_flights_without_a_value_violate_every_limit():
    one = Requirement("A", "x", at_most=1e9, percentage=50.0)
    found = verify_values(one, "arm", np.array([0.1, np.nan, np.nan, 0.2]))
    assert found.violations == 2
    assert verify_values(one, "arm", np.array([])).status == "open"


@pytest.mark.parametrize(
    ("percentage", "flights"), [(7.0, 100), (28.0, 100), (55.0, 100), (95.0, 20), (99.9, 1000)]
)
def test_the_percentile_is_the_value_that_the_percentage_of_flights_reaches(percentage, flights):
    one = Requirement("A", "x", at_most=1e9, percentage=percentage)
    values = np.random.default_rng(2).permutation(np.arange(1.0, flights + 1.0))
    found = verify_values(one, "arm", values)
    assert found.percentile == pytest.approx(percentage * flights / 100.0)


def test_a_number_of_flights_beyond_the_search_is_not_stated():
    fraction = 1.0 - 1e-9  # 2.3e9 flights without a violation
    assert needed_flights(0, fraction, 0.9) is None
    one = Requirement("A", "x", at_most=1.0, percentage=100.0 * fraction)
    assert verify_values(one, "arm", np.zeros(40)).missing_flights is None
    assert needed_flights(0, 1.0 - 1e-6, 0.9) == 2_302_584


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the results folder of a campaign of 40 flights of two arms, some of which crash."""
    folder = tmp_path_factory.mktemp("verified") / "c"
    run(plan(), InlineEngine(), folder)
    return folder


GOOD = '[[requirements]]\nname = "A"\nmetric = "safe"\npercentage = 1.0\n'


def test_the_command_prints_writes_and_judges(folder, tmp_path):
    (tmp_path / "easy.toml").write_text(GOOD)
    (tmp_path / "hard.toml").write_text(GOOD.replace("1.0", "99.9"))
    out = tmp_path / "found.json"
    runner = CliRunner()
    passed = runner.invoke(
        main, ["campaign", "verify", str(folder), str(tmp_path / "easy.toml"), "--out", str(out)]
    )
    assert passed.exit_code == 0, passed.output
    rows = json.loads(out.read_text())["rows"]
    assert [row["status"] for row in rows] == ["pass", "pass"]
    assert all(row["flights"] == 40 for row in rows)
    failed = runner.invoke(main, ["campaign", "verify", str(folder), str(tmp_path / "hard.toml")])
    assert failed.exit_code == 1
    assert "pass" not in failed.output


def test_a_campaign_with_flights_to_come_is_not_verified(folder, tmp_path, monkeypatch):
    (tmp_path / "easy.toml").write_text(GOOD)
    expected = property(lambda results: len(results.table) + 1)
    monkeypatch.setattr(type(load_results(folder)), "expected_rows", expected)
    words = ["campaign", "verify", str(folder), str(tmp_path / "easy.toml")]
    found = CliRunner().invoke(main, words)
    assert found.exit_code == 1 and "not complete: 80 of 81 flights" in found.output


def test_only_independent_flights_of_equal_weight_count(folder):
    results, stated = load_results(folder), [Requirement("A", "safe", percentage=1.0)]
    # In blocks of three flights, the second repeats the worlds of the others.
    saltelli = results.manifest | {"identity": {"method": "saltelli", "dispersions": {}}}
    for one in verify(replace(results, manifest=saltelli), stated):
        assert one.flights == sum(n % 3 != 1 for n in range(40))
    subset = results.manifest | {"identity": {"method": "subset"}}
    with pytest.raises(InputError, match="equal weights"):
        verify(replace(results, manifest=subset), stated)


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        ("requirement = 1\n", "requirement", "unknown table"),
        ("requirements = 1\n", "requirements", "tables [[requirements]]"),
        ("requirements = []\n", "requirements", "one or more tables"),
        (GOOD + "at_most = nan\n", "requirements[0].at_most", "finite"),
        (GOOD.replace("metric", "metrik"), "requirements[0].metrik", "unknown key"),
        (GOOD + GOOD, "requirements[1].name", "only once"),
        (GOOD + GOOD.replace('"A"', '"A "'), "requirements[1].name", "only once"),
        (GOOD.replace('"A"', '" \\t"'), "requirements[0].name", "a name used only once"),
        (GOOD.replace('"A"', '"A\\u001b[31m"'), "requirements[0].name", "printable characters"),
        (GOOD.replace('"A"', '"A\\nB"'), "requirements[0].name", "printable characters"),
        (GOOD + "at_most = 1\nat_least = 0\n", "requirements[0].at_least", "beside at_most"),
        (GOOD.replace("1.0", "100.0"), "requirements[0].percentage", "less than 100"),
    ],
)
def test_wrong_files_are_refused_with_the_field(tmp_path, text, field, words):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        load_requirements(path)
    assert refused.value.field == field
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"metric": "saef"}, "Did you mean 'safe'"),
        ({"metric": "failure_causes"}, "must be a column with numbers"),
        ({"metric": "safe", "at_most": 1.0}, "must have no limit"),
        ({"metric": "x"}, "must have a limit"),
    ],
)
def test_columns_that_do_not_fit_are_refused(folder, tmp_path, table, words):
    path = tmp_path / "r.toml"
    lines = [f"{k} = {json.dumps(v)}" for k, v in ({"name": "A"} | table).items()]
    path.write_text("[[requirements]]\n" + "\n".join(lines) + "\n")
    found = CliRunner().invoke(main, ["campaign", "verify", str(folder), str(path)])
    assert found.exit_code != 0
    assert words in str(found.exception or "") + found.output
