"""The study of random worlds: its counts, and the test of its worlds."""

from __future__ import annotations

import json

import numpy as np
import pytest
from rich.console import Console

from lunarsim.studies import Case
from lunarsim.studies.library import load_study

ROCKY = {"rocks.shape": "cube", "rocks.cover": 0.1, "terrain.rms_slope_deg": 0.5,
         "scan.range_m": 90.0, "sensors.flash.half_fov_tangent": 0.2}  # fmt: skip

# Rocks that hardly exceed the roughness limit, of which the map misses some.
LOW_ROCKS = {
    "terrain.rms_slope_deg": 0.33, "rocks.shape": "ellipsoid", "rocks.height_ratio.0": 0.85,
    "rocks.burial.1": 0.24, "rocks.axis_ratio.0": 0.78, "rocks.cover": 0.01,
    "rocks.min_diameter_m": 0.205, "vehicle.leg_radius_m": 3.4, "vehicle.roughness_limit_m": 0.175,
    "scan.pixels": 192, "sensors.flash.half_fov_tangent": 0.198, "scan.range_m": 129.0,
    "scan.angle_deg": 57.0,
}  # fmt: skip


@pytest.fixture
def script(monkeypatch):
    """Maps of 18 m on terrain of 30 m, which take a fraction of the time."""
    load_study("random_worlds")
    import random_worlds  # found after the study is loaded
    import worst_case_maps

    monkeypatch.setattr(worst_case_maps, "MAP_SIDE_M", 18.0)
    monkeypatch.setitem(worst_case_maps.BASE["terrain"], "size_m", 30.0)
    monkeypatch.setitem(worst_case_maps.BASE["mappers"]["dem"], "size_m", 18.0)
    return random_worlds


def test_counts_of_a_world_are_consistent(script, tmp_path):
    file = tmp_path / "worlds.json"
    file.write_text(json.dumps([{}, ROCKY, LOW_ROCKS]))
    plain, rocky, low = (script.measure(Case({"file": str(file)}, k, 3)) for k in (0, 1, 8))
    for row in (plain, rocky, low):
        claimed, right = np.array(row["claimed_0.95"]), np.array(row["right_0.95"])
        assert (right <= claimed).all() and (claimed <= script.BLOCK_CELLS**2 // 2 + 13).all()
        assert claimed.sum() == row["in_bin"][-1] and right.sum() == row["safe_in_bin"][-1]
        # All bins but the last are below 0.95: sums of p lie between their edges.
        assert (np.array(row["sum_in_bin"]) <= script.BINS[1:] * row["in_bin"] + 1e-6).all()
        assert sum(row["claimed_0.99"]) <= claimed.sum() <= row["sites"]
    assert sum(plain["right_0.95"]) > 0.98 * sum(plain["claimed_0.95"]) > 500
    assert rocky["safe"] < 0.5 * rocky["sites"]
    assert 100 < sum(low["right_0.95"]) < 0.95 * sum(low["claimed_0.95"])


def test_only_worlds_below_the_required_precision_contradict_it(script):
    def world(number, right):
        return {"number": number, "range_m": 100.0, "claimed_0.95": [50] * 40, "right_0.95": right}

    class Printed:
        console = Console(record=True, width=120)

        def print(self, text):
            self.console.print(text)

    rng, printed = np.random.default_rng(1), Printed()
    # Low precision in one square out of forty is chance; in every second square it is not.
    rows = [world(0, [50] * 40), world(1, [0] + [50] * 39), world(2, [30, 50] * 20)]
    script.print_worlds(printed, rows, rng)
    text = printed.console.export_text()
    assert "1 of 3" in text
    lines = [line for line in text.splitlines() if "│" in line]
    assert lines[0].split("│")[1:5:3] == ["     2 ", "    0.8000 "]
    assert float(lines[0].split("│")[6]) < 0.001 < 0.5 < float(lines[1].split("│")[6])


def test_lower_bound_accounts_for_worlds_and_squares(script):
    rng = np.random.default_rng(2)
    equal = [{"claimed_0.95": [100] * 20, "right_0.95": [98] * 20}] * 10
    assert script.pooled_bound(equal, 0.95, rng) == pytest.approx(0.98)
    one_bad = [*equal[:9], {"claimed_0.95": [100] * 20, "right_0.95": [50] * 20}]
    # The share of the bad world among ten drawn worlds exceeds 0.3 in 1 of 15 draws.
    assert script.pooled_bound(one_bad, 0.95, rng) == pytest.approx(0.98 - 0.48 * 0.3, abs=0.05)
