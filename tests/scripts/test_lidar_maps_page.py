"""Generated tables of the pages on LiDAR maps."""

from __future__ import annotations

import copy
import importlib
import json

import pytest

from tests.conftest import ROOT

HEADS = {
    "landings": "| world | map and policy | flights |",
    "maps": "| world | map | decision |",
    "strata": "| world | stratum | map |",
}


@pytest.fixture
def pages(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module("lidar_maps_page")


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


def _page(pages):
    out = [pages.mark("commands") + "\n\n- `x`\n  - old: none.\n"]
    for name, head in HEADS.items():
        out.append(f"{pages.mark(name)}\n\n{head}\n| --- |\n| kept | 1 |\n|  | 2 |\n| new | 3 |\n")
    return "Words.\n\n" + "\nMore.\n\n".join(out) + "\nEnd.\n"


def test_pages_match_the_stored_results(pages):
    kept = pages.load()
    assert kept
    parts = [part for names in pages.PAGES.values() for part in names]
    assert sorted(parts) == ["commands", *sorted(pages.ROWS)]
    for page, names in pages.PAGES.items():
        shown = page.read_text(encoding="utf-8")
        assert shown == pages.update_page(shown, kept, names)
        for world, file in kept.items():
            assert len(file["figures"]["landings"]) == 4
            if "commands" in names:
                assert f"- `{file['command']}`\n" in shown
                assert f"  - {world}: " in shown
            for rows in (pages.ROWS[name](file["figures"]) for name in names if name in HEADS):
                for row in rows:
                    assert " | ".join(row) in shown


def test_changed_metric_changes_the_page(pages):
    page, parts = next(iter(pages.PAGES.items()))
    shown = page.read_text(encoding="utf-8")
    kept = copy.deepcopy(pages.load())
    world = next(iter(kept.values()))["figures"]
    next(iter(world["landings"].values()))["landed"] -= 1
    assert pages.update_page(shown, kept, parts) != shown


def test_rows_contain_metrics_intervals_and_dashes(pages):
    world = pages.finite(_world())
    assert pages.ROWS["landings"](world) == [
        ["one", "10", "1.00 [0.50, 0.75]", "", "12.3", "40.1"],
        ["two", "10", "0.70 [0.50, 0.75]", "1, 4 (0.38)", "12.3", "40.1"],
    ]
    name = "Gaussian DEM, calibrated"
    assert pages.ROWS["maps"](world) == [
        [name, "first", "-", "0.300 [0.200, 0.400]", "0.13", "0.010", "+0.50", "1.23", "17.0"],
        ["", "last", "-", "0.300 [0.200, 0.400]", "0.13", "0.010", "+0.50", "", ""],
        # It had no map at the first decision.
        ["quadtree", "last", "0.900 [0.800, 1.000]", "0.300 [0.200, 0.400]", "0.13", "0.031",
         "-0.50", "2.00", "5.0"],
    ]  # fmt: skip
    first, second = pages.ROWS["strata"](world)
    assert first == ["level", name, "0.250", "0.500 [0.400, 0.600]", "0.100 [0.000, 0.200]", "-"]
    assert second[:3] == ["", "quadtree", ""]


def test_shortfalls_of_a_world_are_listed(pages):
    assert pages.shortfalls(pages.finite(_world())) == [
        "two: 3 of 10 not safe",
        "quadtree: ECE 0.031, Brier skill -0.50",
    ]
    fine = _world()
    fine["landings"].pop("two")
    fine["maps"].pop("quadtree")
    assert pages.shortfalls(fine) == []
    claims_nothing = {"landings": {}, "maps": {"quadtree": {"last": _quality(claimed=0.0)}}}
    assert pages.shortfalls(claims_nothing) == []


def test_new_results_replace_only_the_rows_of_their_world(pages, tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "STORED", tmp_path / "kept")
    file = tmp_path / "page.md"
    monkeypatch.setattr(pages, "PAGES", {file: ("commands", *HEADS)})
    file.write_text(_page(pages))
    (tmp_path / "figures.json").write_text(json.dumps({"new": _world()}))
    arguments = ["--store", str(tmp_path / "figures.json"), "--command", "python a.py"]
    pages.main(arguments, standalone_mode=False)
    page = file.read_text()
    assert "NaN" not in (tmp_path / "kept" / "new.json").read_text()
    assert page.count("| kept | 1 |\n|  | 2 |\n") == 3
    assert "| new | 3 |" not in page
    assert "| new | one | 10 |" in page
    assert "- `python a.py`\n  - new: two: 3 of 10 not safe; " in page
    assert "- old" not in page and "`x`" not in page
    assert page.startswith("Words.\n") and page.endswith("\nEnd.\n")
    pages.main([], standalone_mode=False)
    assert file.read_text() == page
