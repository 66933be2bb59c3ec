"""Results page, generated from the stored results."""

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


def test_page_is_generated_from_the_stored_files(results):
    shown = (ROOT / "docs" / "validation" / "results-by-seed.md").read_text(encoding="utf-8")
    assert shown == results.page()
    kept = sorted(results.STORED.glob("*.json"))
    assert len(kept) >= 2
    for path in kept:
        report = results.load(path)
        assert report.title in shown
        assert f"`{report.command}`" in shown
        assert all(f.values for f in report.figures)
        assert max(len(f.values) for f in report.figures) >= 2


def test_metric_on_the_wrong_side_of_the_paper_falls_short(results):
    figure = results.SeedMetric("recall", "", [0.4, 0.6], 0.55, "higher")
    assert figure.mean == 0.5
    assert figure.falls_short
    assert not replace(figure, better="lower").falls_short
    assert not replace(figure, paper=0.45).falls_short
    assert replace(figure, paper=0.45, better="lower").falls_short
    assert not replace(figure, paper=None).falls_short
    assert not replace(figure, better="").falls_short


def test_section_has_mean_range_and_shortfalls(results):
    figures = [
        results.SeedMetric("recall", "", [0.4, 0.6], 0.55, "higher"),
        results.SeedMetric("error", "m", [1.0, 3.0, 2.0]),
    ]
    text = results.section(results.StudyReport("A map", "python a.py", "a", figures))
    assert "## A map\n\n`python a.py`; [more](a.md).\n" in text
    assert "| recall | 0.5 | 0.4 to 0.6 | 2 | 0.55 |" in text
    assert "| error (m) | 2 | 1 to 3 | 3 |  |" in text
    assert "Worse than the paper: recall (0.5 for 0.55)." in text
    good = replace(figures[0], paper=0.5)
    text = results.section(results.StudyReport("A map", "python a.py", "a", [good]))
    assert "Worse than the paper: none." in text


def test_gaussian_dem_metrics_are_by_seed(results):
    table_3 = [
        {"table": "3", "number": k, "c": 0.5, "precision": 1.0 - 0.1 * k, "recall": 0.2 + 0.1 * k,
         "bounded": 0.8 - 0.1 * k, "paper": 0.28}
        for k in range(2)
    ]  # fmt: skip
    calls = [[[0.9, 0.5], [0.8, 0.6]], [[float("nan"), 0.7], [0.95, 0.4]]]  # two scans, two seeds
    table_6 = [
        {"table": "6", "number": k, "at_half": {"proposed slope": c, "proposed roughness": c}}
        for scan in calls for k, c in enumerate(scan)
    ]  # fmt: skip
    found = {"rows": [*table_3, {"table": "4", "number": 0}, *table_6]}
    report = results.extract_report("gaussian_dem", found, "python x.py")
    by = {f.label: f for f in report.figures}
    assert by["Table 3, c = 0.5: recall"].values == pytest.approx([0.2, 0.3])
    assert by["Table 3, c = 0.5: recall"].paper == 0.28
    assert by["Table 6, proposed slope, minimum precision of nine scans"].values == [0.9, 0.8]
    assert by["Table 6, proposed slope, minimum recall of nine scans"].values == [0.5, 0.4]


def _descent(path, fuel, recall=0.2):
    rates = {"clear_recall": recall, "clear_false": 0.0, "occupied_correct": 0.9}
    return {"path": path, "propellant": fuel, "duration": 60.0,
            "levels": {"50.0": {"rates": rates}}}  # fmt: skip


def test_shadow_metrics_are_paired(results):
    flights = [
        _descent("nominal", 40.0, 0.1), _descent("modified", 41.0),
        _descent("nominal", 50.0, 0.3), _descent("modified", 53.0),
    ]  # fmt: skip
    report = results.extract_report("shadows", {"rows": flights}, "")
    by = {f.label: f for f in report.figures}
    assert by["propellant, modified minus nominal"].values == [1.0, 3.0]
    assert by["propellant, modified minus nominal"].falls_short
    assert by["duration, modified minus nominal"].values == [0.0, 0.0]
    assert by["clear area classified as clear, nominal"].values == [0.1, 0.3]
    assert not by["clear area classified as clear, nominal"].falls_short
    assert by["clear area classified as clear, modified"].falls_short  # 0.2 for 0.29


def _evaluation(rms, missed, hazard, sites, slope=2.0, false=0.5):
    return {"map_error_rms": rms, "slope_error_max": slope, "missed_m2": missed,
            "hazard_m2": hazard, "false_m2": false,
            "sites": [{"exactly_safe": s, "hazard_m2": h} for s, h in sites]}  # fmt: skip


def test_quadtree_metrics_are_of_the_last_evaluation(results):
    first = _evaluation(9.0, 9.0, 9.0, [])
    flights = [
        {
            "lock": 7.5,
            "evaluations": [first, _evaluation(0.02, 1.0, 4.0, [(True, 0.0), (False, 0.3)])],
        },
        {
            "lock": None,
            "evaluations": [first, _evaluation(0.06, 3.0, 4.0, [(True, 0.0)], 7.0, 1.5)],
        },
    ]
    by = {f.label: f for f in results.extract_report("quadtree", {"rows": flights}, "").figures}
    assert {name: f.values for name, f in by.items()} == {
        "time of the lock": [7.5],
        "map error, RMS": [0.02, 0.06],
        "slope error, maximum": [2.0, 7.0],
        "missed fraction of the hazard area": [0.25, 0.75],
        "false hazard area": [0.5, 1.5],
        "ranked sites": [2.0, 1.0],
        "exactly safe sites": [1.0, 1.0],
        "landing zones with a true hazard": [1.0, 0.0],
    }
    assert {name: f.unit for name, f in by.items() if f.unit} == {
        "time of the lock": "s", "map error, RMS": "m",
        "slope error, maximum": "deg", "false hazard area": "m2",
    }  # fmt: skip
    papers = {name: f.paper for name, f in by.items() if f.paper is not None}
    assert papers == {"map error, RMS": 0.5, "slope error, maximum": 6.0,
                      "landing zones with a true hazard": 0.0}  # fmt: skip
    assert {name for name, f in by.items() if f.falls_short} == {"landing zones with a true hazard"}


def test_guidance_metrics_are_relative_to_the_optimum_of_each_start(results):
    row = {"law": "apollo", "optimum": 30.0, "descent": 10.0, "total": 50.0, "speed": 0.2}
    flown = [{**row, "safe": True}, {**row, "total": 44.0, "safe": False},
             {**row, "law": "optimal", "total": 38.0, "safe": True}]  # fmt: skip
    report = results.extract_report("guidance", {"rows": flown}, "python g.py")
    by = {f.label: f for f in report.figures}
    assert by["`apollo`: excess propellant to touchdown"].values == pytest.approx([25.0, 10.0])
    assert by["`optimal`: excess propellant to touchdown"].values == pytest.approx([-5.0])
    assert by["`apollo`: safe landings"].values == [1.0, 0.0]
    text = results.section(report)
    assert "| metric | mean | range | seeds | optimum |" in text
    assert "(%) | 17.5 | 10 to 25 | 2 | 0 |" in text and "Worse than" not in text


def test_navigation_metrics_are_by_flight(results):
    flight = {"nees": {"all nine": 0.8, "position": None}, "nis": {"stars": 1.1},
              "start_error": 40.0, "map_error": 3.0, "lost": False, "safe": True}  # fmt: skip
    other = {**flight, "nees": {"all nine": 1.4, "position": 2.0}, "nis": {}, "safe": False}
    report = results.extract_report("navigation", {"rows": [flight, other]}, "python n.py")
    assert {f.label: f.values for f in report.figures} == {
        "NEES / degrees of freedom, all nine (ideal 1)": [0.8, 1.4],
        "NEES / degrees of freedom, position (ideal 1)": [2.0],
        "NIS / degrees of freedom, stars (ideal 1)": [1.1],
        "initial position error": [40.0, 40.0],
        "position error at touchdown": [3.0, 3.0],
        "navigation lost at the end": [0.0, 0.0],
        "safe landings": [1.0, 0.0],
    }
    assert "Worse than" not in results.section(report)


def test_real_return_metrics_are_by_split(results):
    rows = [
        {
            "returns": returns, "map": name, "slope": slope, "rmse": k + more,
            "nees": k + more + 0.1, "beyond2": k + more + 0.2,
        }
        for k, name in enumerate(("as flights do", "field of Table 6"))
        for more in (0.1, 0.4)
        for returns, slope in (("terrain returns", "all"), ("terrain returns", "over 40"),
                               ("returns of every class", "all"))
    ]  # fmt: skip
    report = results.extract_report("real_returns", {"rows": [*rows, {"test": "safety"}]}, "")
    error, square, share = (
        "RMSE",
        "mean square of error / predicted sigma (ideal 1)",
        "fraction beyond 2",
    )
    values = {f.label: f.values for f in report.figures}
    assert {k: pytest.approx(v) for k, v in values.items()} == {
        f"as flights do: {error}": [0.1, 0.4],
        f"as flights do: {square}": [0.2, 0.5],
        f"as flights do: {share} sigma (ideal 0.046)": [0.3, 0.6],
        f"field of Table 6: {error}": [1.1, 1.4],
        f"field of Table 6: {square}": [1.2, 1.5],
        f"field of Table 6: {share} sigma (ideal 0.046)": [1.3, 1.6],
    }
    assert "Worse than" not in results.section(report)
    assert [f.unit for f in report.figures] == ["m", "", ""] * 2


def test_report_is_stored_completely(results, tmp_path, monkeypatch):
    monkeypatch.setattr(results, "STORED", tmp_path)
    found = {"rows": [_descent("nominal", 1.0), _descent("modified", 2.0)]}
    written = tmp_path / "raw"
    written.write_text(json.dumps(found))
    results.main(["--store", "shadows", str(written), "--command", "c"], standalone_mode=False)
    assert results.load(tmp_path / "shadows.json") == results.extract_report("shadows", found, "c")
    assert "## Shadow filter, two descents" in results.page()
