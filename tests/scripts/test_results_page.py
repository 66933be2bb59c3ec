"""The page of results: made of what studies wrote, and of nothing else."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace

import pytest

from tests.conftest import ROOT


@pytest.fixture
def results(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module("results_page")


def test_the_page_is_made_of_the_kept_files(results):
    shown = (ROOT / "docs" / "results-by-seed.md").read_text(encoding="utf-8")
    assert shown == results.page()
    kept = sorted(results.KEPT.glob("*.json"))
    assert len(kept) >= 2
    for path in kept:
        report = results.load(path)
        assert report.title in shown
        assert f"`{report.command}`" in shown
        assert all(f.values for f in report.figures)
        assert max(len(f.values) for f in report.figures) >= 2


def test_a_figure_falls_short_on_the_wrong_side_of_the_papers(results):
    figure = results.Figure("recall", "", [0.4, 0.6], 0.55, "higher")
    assert figure.mean == 0.5
    assert figure.falls_short
    assert not replace(figure, better="lower").falls_short
    assert not replace(figure, paper=0.45).falls_short
    assert replace(figure, paper=0.45, better="lower").falls_short
    assert not replace(figure, paper=None).falls_short
    assert not replace(figure, better="").falls_short


def test_a_section_tells_mean_spread_and_where_it_is_short(results):
    figures = [
        results.Figure("recall", "", [0.4, 0.6], 0.55, "higher"),
        results.Figure("error", "m", [1.0, 3.0, 2.0]),
    ]
    text = results.section(results.Report("A map", "python a.py", "a", figures))
    assert "## A map\n\n`python a.py`; [more](a.md).\n" in text
    assert "| recall | 0.5 | 0.4 to 0.6 | 2 | 0.55 |" in text
    assert "| error (m) | 2 | 1 to 3 | 3 |  |" in text
    assert "Short of the paper: recall (0.5 for 0.55)." in text
    good = replace(figures[0], paper=0.5)
    text = results.section(results.Report("A map", "python a.py", "a", [good]))
    assert "Short of the paper: nothing here." in text


def test_what_is_taken_of_the_tables_is_by_seed(results):
    row = {
        "c": 0.5,
        "precision": [1.0, 0.9],
        "recall": [0.2, 0.3],
        "bounded": [0.8, 0.7],
        "paper": 0.28,
    }
    calls = [[[0.9, 0.5], [0.8, 0.6]], [[float("nan"), 0.7], [0.95, 0.4]]]  # two scans, two seeds
    found = {
        "3": {"rows": [row]},
        "6": {"at_half": {"proposed slope": calls, "proposed roughness": calls}},
    }
    report = results.take("gaussian_dem", found, "python x.py")
    by = {f.label: f for f in report.figures}
    assert by["Table 3, c = 0.5: recall"].values == [0.2, 0.3]
    assert by["Table 3, c = 0.5: recall"].paper == 0.28
    assert by["Table 6, proposed slope, least precision of nine scans"].values == [0.9, 0.8]
    assert by["Table 6, proposed slope, least recall of nine scans"].values == [0.5, 0.4]


def _descent(path, fuel, recall=0.2):
    rates = {"clear_recall": recall, "clear_false": 0.0, "occupied_correct": 0.9}
    return {"path": path, "propellant": fuel, "duration": 60.0,
            "levels": {"50.0": {"rates": rates}}}  # fmt: skip


def test_what_is_taken_of_two_descents_is_paired(results):
    flights = [
        _descent("nominal", 40.0, 0.1), _descent("modified", 41.0),
        _descent("nominal", 50.0, 0.3), _descent("modified", 53.0),
    ]  # fmt: skip
    report = results.take("shadows", {"flights": flights}, "")
    by = {f.label: f for f in report.figures}
    assert by["propellant, modified less nominal"].values == [1.0, 3.0]
    assert by["propellant, modified less nominal"].falls_short
    assert by["duration, modified less nominal"].values == [0.0, 0.0]
    assert by["clear ground called clear, nominal"].values == [0.1, 0.3]
    assert not by["clear ground called clear, nominal"].falls_short
    assert by["clear ground called clear, modified"].falls_short  # 0.2 for 0.29


def test_a_report_is_kept_whole(results, tmp_path, monkeypatch):
    monkeypatch.setattr(results, "KEPT", tmp_path)
    found = {"flights": [_descent("nominal", 1.0), _descent("modified", 2.0)]}
    written = tmp_path / "raw"
    written.write_text(json.dumps(found))
    results.main(["--take", "shadows", str(written), "--command", "c"], standalone_mode=False)
    assert results.load(tmp_path / "shadows.json") == results.take("shadows", found, "c")
    assert "## Rocks by their shadows" in results.page()
