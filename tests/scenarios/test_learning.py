"""Scripts that compare agents: output and rejected input."""

from __future__ import annotations

from io import StringIO

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from lunarsim.evaluation.comparisons import Difference
from lunarsim.studies import Report


def _between(low, high):
    return Difference("a", "b", 10, 0.5 * (low + high), low, high, 0.5)


def test_reference_scores_have_one_row_per_agent(script, monkeypatch, capsys):
    study = script("learning", "reference_scores")
    monkeypatch.setattr("sys.argv", ["x", "--episodes", "2", "--only", "Control-v1"])
    assert study.main() == 0
    rows = capsys.readouterr().out.strip().splitlines()[2:]
    assert [row.split("`")[1] for row in rows] == list(study.AGENTS["Control-v1"])
    # A guidance law and the trained agent land, and no other agent by chance.
    lands = ["| 1.000 [0.342, 1.000] |" in row for row in rows]
    assert lands == [name in ("apollo", "ppo-control") for name in study.AGENTS["Control-v1"]]
    for given, word in ((["--only", "Glide-v0"], "Guidance-v1"), (["--episodes", "0"], "episodes")):
        monkeypatch.setattr("sys.argv", ["x", *given])
        assert study.main() == 2
        assert word in capsys.readouterr().err


def test_every_environment_has_reference_scores(script):
    study = script("learning", "reference_scores")
    flown = {study.study_of(name, 1).env for name in study.AGENTS}
    assert flown == {"lunarsim/Guidance-v1", "lunarsim/Control-v1", "lunarsim/Retarget-v1"}
    told = {study.study_of(name, 1).arguments.get("perception") for name in study.AGENTS}
    assert told == {None, "surrogate", "truth"}


def test_rankings_contradict_if_both_intervals_exclude_zero(script):
    study = script("learning", "ranking")
    ahead, behind, unsure = _between(0.1, 0.3), _between(-0.3, -0.1), _between(-0.1, 0.2)
    assert [study.sign_of_difference(d) for d in (ahead, behind, unsure)] == [1, -1, 0]
    assert study.is_contradiction(ahead, behind) and study.is_contradiction(behind, ahead)
    assert not study.is_contradiction(ahead, ahead) and not study.is_contradiction(ahead, unsure)


def test_pairs_are_counted_by_both_perceptions(script):
    study = script("learning", "ranking")
    model, mapper = study.PERCEPTIONS
    rng = np.random.default_rng(3)
    good, bad = np.arange(100) < 95, np.arange(100) < 40
    cheap, dear = 30.0 + rng.random(100), 35.0 + rng.random(100)
    told = {
        ("one", model): study.AgentFlights(good, cheap),
        ("one", mapper): study.AgentFlights(bad, cheap),
        ("two", model): study.AgentFlights(bad, dear),
        ("two", mapper): study.AgentFlights(good, dear),
        ("three", model): study.AgentFlights(bad, dear),
        ("three", mapper): study.AgentFlights(bad, dear),
    }  # fmt: skip
    counts = study.count_contradictions(told, ("one", "two", "three"))
    # One and two swap in safety; one is ahead of three only on the model, two only on the mapper.
    assert counts["safe"] == [1, 0, 3]
    assert counts["propellant"] == [0, 3, 3]


def test_ranking_rejects_invalid_input(script, monkeypatch, capsys):
    study = script("learning", "ranking")
    for given, word in ((["--flights", "1"], "--flights"), (["--agent", "nobody"], "--agent"),
                        (["--scenario", "nowhere"], "nowhere")):  # fmt: skip
        monkeypatch.setattr("sys.argv", ["x", *given])
        assert study.main() == 2
        assert word in capsys.readouterr().err


@pytest.mark.slow
def test_ranking_is_printed(script, monkeypatch, capsys):
    study = script("learning", "ranking")
    given = ["--flights", "3", "--worlds", "1", "--agent", "no-divert", "--agent", "safest"]
    monkeypatch.setattr("sys.argv", ["x", *given])
    assert study.main() == 0
    out = capsys.readouterr().out
    assert "`no-divert`" in out and "`safest`" in out
    assert out.count(": 1 pairs of agents") == 2


def test_example_script_rejects_invalid_input(script, tmp_path):
    for words, says in (
        (["--episodes", "0"], "x>=1"), (["--seed", "-1"], "x>=0"),
        (["--scenario", "hardd"], "Did you mean 'hard'"),
        (["--video", str(tmp_path / "film.txt")], "ends in .mp4"),
    ):  # fmt: skip
        done = CliRunner().invoke(script("learning", "retarget_agents").main, words)
        assert done.exit_code == 2 and says in done.output, done.output


def test_surrogate_of_an_unknown_scenario_is_rejected(script, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["fit_surrogate.py", "--scenario", "hardd", "--check"])
    assert script("learning", "fit_surrogate").main() == 2
    assert "Did you mean 'hard'" in capsys.readouterr().err


def test_the_interval_of_a_learning_curve_covers_the_mean_of_seeds(script):
    """Student's interval of five seeds covers the true mean in 95 % of 4,000 studies."""
    curves = script("learning", "learning_curves")
    seeds = np.random.default_rng(1).normal(0.9, 0.03, (4000, 5))
    inside = sum(
        abs(mean - 0.9) <= half for mean, half in (curves.mean_interval(row) for row in seeds)
    )
    assert 0.94 < inside / 4000 < 0.96
    assert curves.mean_interval(np.array([0.7]))[0] == 0.7
    assert np.isnan(curves.mean_interval(np.array([0.7]))[1])


def test_learning_curves_are_drawn_and_their_test_flights_printed(script, tmp_path):
    """Two seeds of one environment: the table has the last rows, the figure the others."""
    curves = script("learning", "learning_curves")
    rows = [
        {
            "environment": "Control-v1", "number": seed, "steps": 1000 * k, "seconds": 60.0 * k,
            "split": "validation" if k < 3 else "test", "safe": 0.1 * k + 0.02 * seed,
            "on_target": 0.1, "propellant_kg": 40.0 + seed,
        }
        for seed in range(2)
        for k in (1, 2, 3)
    ]  # fmt: skip
    console = Console(file=StringIO(), width=200)
    report = Report(rows, ["environment"], "seeds", {}, False, {}, 0, console, tmp_path)
    curves.print_curves(report)
    text = console.file.getvalue()
    assert "0.310 [0.183, 0.437]" in text and "0.300 / 0.320" in text and "40.5" in text
    assert (tmp_path / "curves.png").stat().st_size > 5000
