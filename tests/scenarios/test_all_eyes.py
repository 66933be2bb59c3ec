"""The study of all eyes: its figures from made counts, and one flight of it."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest
from click.testing import CliRunner


@dataclass(frozen=True)
class Scan:
    """What of a scan matters to losing returns."""

    time: float
    range: np.ndarray


@pytest.fixture
def study(script):
    return script(".", "all_eyes")


def judged(study, p, safe):
    """Return the counts of a map that claims a frequency everywhere."""
    p, s = np.asarray(p), np.asarray(safe, float)
    curve = study.PrecisionRecall.of(p, s > 0.5)
    return {
        "unsafe": curve.unsafe.tolist(), "safe": curve.safe.tolist(),
        "table": study.reliability(p, s).tolist(),
        "squares": [float(p.size), float(s.sum()), float(((p - s) ** 2).sum())], "observed": 1.0,
    }  # fmt: skip


def test_figures_of_a_map(study):
    truth = [True] * 8 + [False] * 2
    good = judged(study, [0.9] * 8 + [0.6, 0.1], truth)
    f = study.figures_of([good, good])
    assert f["precision"] == pytest.approx(8 / 9)
    assert f["recall"] == 1.0
    assert f["recall_at_precision"] == 1.0
    assert f["missed_hazard"] == 0.5
    assert f["ece"] == pytest.approx((8 * 0.1 + 0.6 + 0.1) / 10)
    assert f["skill"] == pytest.approx(1.0 - (8 * 0.01 + 0.36 + 0.01) / 10 / 0.16)


def test_the_fused_map_is_set_against_the_best_other_field_by_field(study):
    truth = [True] * 5 + [False] * 5
    half = judged(study, [0.9, 0.9, 0.2, 0.2, 0.2] + [0.4] * 5, truth)
    whole = judged(study, [0.9] * 5 + [0.1] * 5, truth)
    none = judged(study, [0.1] * 5 + [0.9] * 5, truth)
    flights = [
        {"row": "made", "ms": dict.fromkeys(study.MAPS, 1.0), "maps": {
            "100": {"dem": none, "quadtree": none, "rocks": half, "fused": fused}}}
        for fused in (whole, half)
    ]  # fmt: skip
    assert study.best_single(flights, "100") == "rocks"
    assert study.gained(flights, "100", "rocks") == pytest.approx([0.6, 0.0])


def test_half_of_the_returns_are_lost_alike_for_all(study):
    taken = []
    lossy = study.dropping(lambda scan, estimate: taken.append(scan.range))
    scan = Scan(3.21, np.ones((100, 100)))
    lossy(scan, None)
    lossy(scan, None)
    assert np.isnan(taken[0]).mean() == pytest.approx(0.5, abs=0.03)
    assert np.array_equal(taken[0], taken[1], equal_nan=True)


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [("--rows", "the Moon", "not one of"), ("--altitudes", "10", "metres from 50")],
)
def test_mistakes_are_named(study, option, value, told):
    result = CliRunner().invoke(study.main, [option, value])
    assert result.exit_code == 2
    assert told in result.output


@pytest.mark.slow
def test_a_flight_is_judged_printed_and_drawn(study, tmp_path):
    file = tmp_path / "all.json"
    options = ["--fields", "1", "--rows", "camera dead from 400 m on", "--altitudes", "120"]
    result = CliRunner().invoke(study.main, [*options, "--json", str(file), "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    for words in study.MAPS.values():
        assert words in result.output
    (flight,) = json.loads(file.read_text())["flights"]
    maps = flight["maps"]["120"]
    # Nothing was seen above 400 m that could have been mapped: the LiDAR's map is what is left.
    assert maps["fused"] == maps["dem"]
    assert (tmp_path / "all_eyes.png").stat().st_size > 10_000
