"""Pages with blocks of stored results."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

from tests.conftest import ROOT


@pytest.fixture
def results(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module("results_pages")


@pytest.fixture
def docs(results, tmp_path, monkeypatch):
    """Empty folder of pages with the stored results of a study."""
    monkeypatch.setattr(results, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(results, "STORED", tmp_path / "docs" / "results")
    results.STORED.mkdir(parents=True)
    (results.STORED / "slosh.json").write_text(json.dumps(SLOSH))
    return results.DOCS


SLOSH = {
    "study": "landers/slosh", "command": "lunarsim study run landers/slosh", "n": 10,
    "repeats": "flights", "combinations": 2, "commit": "abc", "script": "0", "machine": "linux",
    "seed": 3,
    "tables": [{"title": "A", "columns": ["control", "safe", "firings"],
                "rows": [["ideal", "1.0", "0"], ["phase-plane", "0.9", "758"]]}],
}  # fmt: skip
ORIGIN = (
    "Source: command `lunarsim study run landers/slosh`; made at commit `abc`; the study's "
    "code has changed since; machine linux; n = 10 flights for each of 2 combinations of factors; "
    "seed 3."
)


def _page(head, old=""):
    return f"Words.\n\n<!-- results: {head} -->\n{old}<!-- end results -->\n\nEnd.\n"


def test_pages_are_current():
    command = [sys.executable, "scripts/results_pages.py", "--check"]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr


def test_every_stored_result_is_shown(results):
    shown = set()
    for page in results.DOCS.rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        for head, old in results.BLOCK.findall(text):
            names = [word for word in head.split() if "=" not in word]
            shown |= set(names)
            for name in names:
                assert results.source_line(results.read_stored(name)) in old
    stored = {str(p.relative_to(results.STORED).with_suffix(""))
              for p in results.STORED.rglob("*.json")}  # fmt: skip
    # Rows of complete flights, and the data of a network: no page shows them as a table.
    others = {name for name in stored if name.endswith("/results")} | {"learning/neural_optimal"}
    assert len(shown) > 10 and shown == stored - others


def test_block_is_filled_and_stays_equal(results, docs):
    page = results.update_page(_page("slosh"))
    assert page == _page(
        "slosh",
        "\n| control | safe | firings |\n| --- | --- | --- |\n| ideal | 1.0 | 0 |\n"
        f"| phase-plane | 0.9 | 758 |\n\n{ORIGIN}\n\n",
    )
    assert results.update_page(page) == page


def test_block_selects_rows_and_columns_and_keeps_its_headings(results, docs):
    head = "slosh table=1 columns=1,3 rows=2"
    page = results.update_page(
        _page(head, "| Control | Firings of 10 |\n| --- | --- |\n| x | y |\n")
    )
    assert "\n| Control | Firings of 10 |\n| --- | --- |\n| phase-plane | 758 |\n\nSource" in page
    assert "ideal" not in page and "| x |" not in page


@pytest.mark.parametrize(
    ("page", "problem"),
    [(_page("none"), "file: must be a JSON file"),
     (_page("slosh table=2"), "table: must be numbers from 1 to 1, separated by commas, got '2'"),
     (_page("slosh columns=0"), "columns: must be numbers from 1 to 3"),
     (_page("slosh rows=x"), "rows: must be numbers from 1 to 2"),
     (_page("slosh", "| a | b |\n"), "heading row of slosh: must have 3 columns, got '| a | b |'"),
     ("<!-- results: slosh -->\n", "blocks: must each end with <!-- end results -->, got 1.")],
)  # fmt: skip
def test_wrong_block_is_an_error_with_page_and_remedy(results, docs, page, problem, capsys):
    (docs / "a.md").write_text(page)
    with pytest.raises(SystemExit) as stop:
        results.main([])
    assert stop.value.code == 2
    printed = capsys.readouterr().err
    assert f"docs/a.md: {problem}" in printed


def test_check_prints_pages_that_differ_and_changes_nothing(results, docs, capsys):
    (docs / "a.md").write_text(_page("slosh"))
    (docs / "b.md").write_text("No block.\n")
    with pytest.raises(SystemExit) as stop:
        results.main(["--check"])
    assert (stop.value.code, capsys.readouterr().out) == (1, "docs/a.md\n")
    assert (docs / "a.md").read_text() == _page("slosh")
    results.main([], standalone_mode=False)
    results.main(["--check"], standalone_mode=False)
    assert ORIGIN in (docs / "a.md").read_text()


def test_source_has_what_is_recorded(results):
    path = results.study_files()["landers/slosh"]
    current = {**SLOSH, "script": results.script_digest(path), "date": "2026-01-02"}
    line = results.source_line(current)
    assert "; made at commit `abc`; date 2026-01-02; machine linux;" in line
    removed = results.source_line({**current, "study": "landers/removed"})
    assert "code has changed since" in removed
    old = {"study": "landers/slosh", "command": "c", "n": 2, "repeats": "fields"}
    assert results.source_line(old) == (
        "Source: command `c`; n = 2 fields; not recorded: commit, machine."
    )


def _written(tmp_path, **changes):
    rows = [
        {"control": "ideal", "tanks": "none", "number": k, "safe": True, "firings": 10.0 * k}
        for k in range(3)
    ]
    columns = ("error_deg", "rate_deg_s", "end_error_deg", "end_rate_deg_s", "thruster_kg",
               "slosh_deg", "lateral_m_s")  # fmt: skip
    found = {
        "study": "landers/slosh", "command": "slosh.py --flights 3", "commit": "abc",
        "script": "0", "machine": {"platform": "linux", "processor": "p", "cores": "2"},
        "options": {"flights": 3, "seed": 0, "levels": {"control": ["ideal"], "tanks": ["none"]}},
        "complete": True, "rows": [row | dict.fromkeys(columns, 0.5) for row in rows],
    }  # fmt: skip
    path = tmp_path / "results.json"
    path.write_text(json.dumps(found | changes))
    return path


def test_tables_of_a_report_are_stored_with_their_origin(results, docs, tmp_path):
    (docs / "a.md").write_text(_page("landers/few columns=1,3,4"))
    results.main(["--store", "landers/few", str(_written(tmp_path))], standalone_mode=False)
    page = (docs / "a.md").read_text()
    assert "| control | flights | safe landings |" in page
    assert "| ideal | 3 | 1.000 [0.439, 1.000] |" in page
    assert "command `python scenarios/landers/slosh.py --flights 3`" in page
    assert "machine linux, p, 2 cores; n = 3 flights; seed 0." in page


@pytest.mark.parametrize("changes", [{"complete": False}, {"study": "no/such"}])
def test_unusable_file_is_not_stored(results, docs, tmp_path, changes):
    with pytest.raises(SystemExit) as stop:
        results.main(["--store", "few", str(_written(tmp_path, **changes))])
    assert stop.value.code == 2
    assert not (results.STORED / "few.json").exists()


def test_metrics_by_seed_are_stored_completely(results, docs, tmp_path):
    flights = [_descent("nominal", 1.0), _descent("modified", 2.5)]
    path = _written(tmp_path, study="shadows/nominal_vs_modified", rows=flights,
                    options={"fields": 1, "seed": 1, "levels": {}})  # fmt: skip
    (docs / "a.md").write_text(_page("by_seed/shadows"))
    results.main(["--store", "by_seed/shadows", str(path)], standalone_mode=False)
    page = (docs / "a.md").read_text()
    assert "| metric | mean | range | seeds | paper |" in page
    assert "| propellant, modified minus nominal (kg) | *1.5* | 1.5 to 1.5 | 1 | 1 |" in page
    stored = results.read_stored("by_seed/shadows")
    assert stored["metrics"] == list(results.shadows(flights))


def test_mean_on_the_wrong_side_of_the_paper_is_in_italics(results):
    for paper, better, text in (
        (0.55, "higher", "*0.5*"), (0.55, "lower", "0.5"), (0.45, "higher", "0.5"),
        (0.45, "lower", "*0.5*"), (None, "higher", "0.5"), (0.55, "", "0.5"),
    ):  # fmt: skip
        one = results.metric("recall", [0.4, 0.6, None, float("nan")], "m", paper, better)
        shown = "" if paper is None else str(paper)
        rows = results.table_of({"metrics": [one]}, "1")[1]
        assert rows == [["recall (m)", text, "0.4 to 0.6", "2", shown]]


def _by_label(metrics):
    return {one["label"]: one for one in metrics}


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
    rows = [*table_3, {"table": "4", "number": 0}, *table_6]
    by = _by_label(results.gaussian_dem(rows))
    assert by["Table 3, c = 0.5: recall"]["values"] == pytest.approx([0.2, 0.3])
    assert by["Table 3, c = 0.5: recall"]["paper"] == 0.28
    assert by["Table 6, proposed slope, minimum precision of nine scans"]["values"] == [0.9, 0.8]
    assert by["Table 6, proposed slope, minimum recall of nine scans"]["values"] == [0.5, 0.4]


def _descent(path, fuel, recall=0.2):
    rates = {"clear_recall": recall, "clear_false": 0.0, "occupied_correct": 0.9}
    return {"path": path, "propellant": fuel, "duration": 60.0,
            "levels": {"50.0": {"rates": rates}}}  # fmt: skip


def test_shadow_metrics_are_paired(results):
    flights = [
        _descent("nominal", 40.0, 0.1), _descent("modified", 41.0),
        _descent("nominal", 50.0, 0.3), _descent("modified", 53.0),
    ]  # fmt: skip
    by = _by_label(results.shadows(flights))
    assert by["propellant, modified minus nominal"]["values"] == [1.0, 3.0]
    assert by["duration, modified minus nominal"]["values"] == [0.0, 0.0]
    assert by["clear area classified as clear, nominal"]["values"] == [0.1, 0.3]


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
    by = _by_label(results.quadtree(flights))
    assert {name: f["values"] for name, f in by.items()} == {
        "time of the lock": [7.5],
        "map error, RMS": [0.02, 0.06],
        "slope error, maximum": [2.0, 7.0],
        "missed fraction of the hazard area": [0.25, 0.75],
        "false hazard area": [0.5, 1.5],
        "ranked sites": [2.0, 1.0],
        "exactly safe sites": [1.0, 1.0],
        "landing zones with a true hazard": [1.0, 0.0],
    }
    assert {name: f["unit"] for name, f in by.items() if f["unit"]} == {
        "time of the lock": "s", "map error, RMS": "m",
        "slope error, maximum": "deg", "false hazard area": "m2",
    }  # fmt: skip
    papers = {name: f["paper"] for name, f in by.items() if f["paper"] is not None}
    assert papers == {"map error, RMS": 0.5, "slope error, maximum": 6.0,
                      "landing zones with a true hazard": 0.0}  # fmt: skip


def test_guidance_metrics_are_relative_to_the_optimum_of_each_start(results):
    row = {"law": "apollo", "optimum": 30.0, "descent": 10.0, "total": 50.0, "speed": 0.2}
    flown = [{**row, "safe": True}, {**row, "total": 44.0, "safe": False},
             {**row, "law": "optimal", "total": 38.0, "safe": True}]  # fmt: skip
    by = _by_label(results.guidance(flown))
    assert by["`apollo`: excess propellant to touchdown"]["values"] == pytest.approx([25.0, 10.0])
    assert by["`optimal`: excess propellant to touchdown"]["values"] == pytest.approx([-5.0])
    assert by["`apollo`: safe landings"]["values"] == [1.0, 0.0]


def test_navigation_metrics_are_by_flight(results):
    flight = {"nees": {"all nine": 0.8, "position": None}, "nis": {"stars": 1.1},
              "start_error": 40.0, "map_error": 3.0, "lost": False, "safe": True}  # fmt: skip
    other = {**flight, "nees": {"all nine": 1.4, "position": 2.0}, "nis": {}, "safe": False}
    by = _by_label(results.navigation([flight, other]))
    assert {name: f["values"] for name, f in by.items()} == {
        "NEES / degrees of freedom, all nine (ideal 1)": [0.8, 1.4],
        "NEES / degrees of freedom, position (ideal 1)": [2.0],
        "NIS / degrees of freedom, stars (ideal 1)": [1.1],
        "initial position error": [40.0, 40.0],
        "position error at touchdown": [3.0, 3.0],
        "navigation lost at the end": [0.0, 0.0],
        "safe landings": [1.0, 0.0],
    }


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
    by = _by_label(results.real_returns([*rows, {"test": "safety"}]))
    error, square, share = (
        "RMSE",
        "mean square of error / predicted sigma (ideal 1)",
        "fraction beyond 2",
    )
    values = {name: f["values"] for name, f in by.items()}
    assert {k: pytest.approx(v) for k, v in values.items()} == {
        f"as flights do: {error}": [0.1, 0.4],
        f"as flights do: {square}": [0.2, 0.5],
        f"as flights do: {share} sigma (ideal 0.046)": [0.3, 0.6],
        f"field of Table 6: {error}": [1.1, 1.4],
        f"field of Table 6: {square}": [1.2, 1.5],
        f"field of Table 6: {share} sigma (ideal 0.046)": [1.3, 1.6],
    }
    assert [f["unit"] for f in by.values()] == ["m", "", ""] * 2


def _landing(landed):
    return {
        "flights": 10, "landed": landed, "interval": [0.5, 0.75], "won": 1, "lost": 4,
        "p_value": 0.375, "divert_median_m": 12.34, "propellant_median_kg": 40.06,
    }  # fmt: skip


def _quality(**more):
    stratum = {"cells": 5.0, "safe": 0.25, "precision": [0.5, 0.4, 0.6], "recall": [0.1, 0.0, 0.2],
               "skill": float("nan")}  # fmt: skip
    empty = stratum | {"cells": 0.0}
    return {"precision": [0.9, 0.8, 1.0], "recall": [0.3, 0.2, 0.4], "claimed": 0.126,
            "ece": 0.0312, "skill": -0.5, "strata": {"level": stratum, "steep": empty},
            **more}  # fmt: skip


def _world():
    good = _quality(ece=0.01, skill=0.5, precision=[float("nan")] * 3)
    return {
        "landings": {"one": _landing(10), "two": _landing(7)},
        "maps": {
            "calibrated": {"first": good, "last": good, "seconds": 1.234, "megabytes": 17.04},
            "quadtree": {"first": {}, "last": _quality(), "seconds": 2.0, "megabytes": 5.0},
        },
    }


def test_rows_contain_metrics_intervals_and_dashes(results):
    world = results.finite(_world())
    assert results.comparison.ROWS["landings"](world) == [
        ["one", "10", "1.00 [0.50, 0.75]", "", "12.3", "40.1"],
        ["two", "10", "0.70 [0.50, 0.75]", "1, 4 (0.38)", "12.3", "40.1"],
    ]
    name = "Gaussian DEM, calibrated"
    assert results.comparison.ROWS["maps"](world) == [
        [name, "first", "-", "0.300 [0.200, 0.400]", "0.13", "0.010", "+0.50", "1.23", "17.0"],
        ["", "last", "-", "0.300 [0.200, 0.400]", "0.13", "0.010", "+0.50", "", ""],
        # It had no map at the first decision.
        ["quadtree", "last", "0.900 [0.800, 1.000]", "0.300 [0.200, 0.400]", "0.13", "0.031",
         "-0.50", "2.00", "5.0"],
    ]  # fmt: skip
    first, second = results.comparison.ROWS["strata"](world)
    assert first == ["level", name, "0.250", "0.500 [0.400, 0.600]", "0.100 [0.000, 0.200]", "-"]
    assert second[:3] == ["", "quadtree", ""]


def test_shortfalls_of_a_world_are_listed(results):
    assert results.shortfalls(results.finite(_world())) == [
        "two: 3 of 10 not safe",
        "quadtree: ECE 0.031, Brier skill -0.50",
    ]
    fine = _world()
    fine["landings"].pop("two")
    fine["maps"].pop("quadtree")
    assert results.shortfalls(fine) == []
    claims_nothing = {"landings": {}, "maps": {"quadtree": {"last": _quality(claimed=0.0)}}}
    assert results.shortfalls(claims_nothing) == []


def test_worlds_are_stored_one_by_one_and_shown_in_the_order_of_the_block(results, docs, tmp_path):
    path = _written(tmp_path, study="lidar_maps/compare_mappers")
    (tmp_path / "figures.json").write_text(json.dumps({"new, a": _world(), "old": _world()}))
    (docs / "a.md").write_text(_page("lidar_maps/old lidar_maps/new_a table=landings"))
    (docs / "b.md").write_text(_page("lidar_maps/new_a table=shortfalls"))
    results.main(["--store", "lidar_maps", str(path)], standalone_mode=False)
    page = (docs / "a.md").read_text()
    assert page.index("| old | one | 10 |") < page.index("| new, a | one | 10 |")
    assert page.count("Source: ") == 1 and "n = 3 flights; seed 0." in page
    assert "NaN" not in (results.STORED / "lidar_maps" / "new_a.json").read_text()
    assert "| new, a | two: 3 of 10 not safe; quadtree: ECE" in (docs / "b.md").read_text()
