"""Shadow scripts on small cases."""

from __future__ import annotations

import json
import re
from itertools import combinations

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import OBSERVATION_SIGMA, SMALL_PATCH_SIGMA
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.policies.contract import Decision
from lunarsim.rocks.field import RockModel
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.studies import Case, report_study, run_study
from lunarsim.studies.command import study_command
from tests.worlds import SMALL_SHADOW_FLIGHT


def test_measurement_noise_is_constant_in_pixels(script, monkeypatch, capsys):
    study = script("shadows", "rock_measurements")
    monkeypatch.setattr(study, "FAR", 45.0)
    monkeypatch.setattr(study, "LAG", 5)
    report_study(study.study, run_study(study.study, count=1))
    output = capsys.readouterr().out
    rows = [line.split("│")[1:-1] for line in output.splitlines() if line.startswith("│")]
    classes = [row for row in rows if len(row) == 6]
    assert len(classes) >= 3
    for row in classes:
        along, across, over, over_across = (float(cell) for cell in row[2:])
        assert 0.1 < along < 1.5 and 0.05 < across < 0.5
        # The reported noise depends only on pixels: constant for large patches, larger below.
        edges = np.array([float(edge) for edge in row[0].split("-")])
        for found, ratio, base, small in zip(
            (along, across),
            (over, over_across),
            OBSERVATION_SIGMA,
            SMALL_PATCH_SIGMA,
            strict=True,
        ):
            least, most = np.sort(np.hypot(base, small / edges))
            assert least / 1.2 < found / ratio < 1.2 * most
    assert "nan" not in output
    left = re.search(r"radius ([\d.]+) \(relative\), center ([\d.]+) radii", output)
    assert left is not None
    radius, centre = _outline_sigmas()
    assert float(left[1]) == pytest.approx(radius, abs=0.08)
    assert float(left[2]) == pytest.approx(centre, abs=0.1)


def test_first_measurement_is_biased_towards_the_sun_by_selection(script, monkeypatch, capsys):
    study = script("shadows", "rock_measurements")
    monkeypatch.setattr(study, "FAR", 150.0)
    monkeypatch.setattr(study, "NEAR", 125.0)
    monkeypatch.setattr(study, "LAG", 5)
    report_study(study.study, run_study(study.study, count=1))
    output = capsys.readouterr().out
    rows = [line.split("│")[1:-1] for line in output.splitlines() if line.startswith("│")]
    first, second, *_ = (float(row[1].split("±")[0]) for row in rows if len(row) == 3)
    assert first > 0.2 > 0.1 > abs(second)


def _outline_sigmas() -> tuple[float, float]:
    """Return the errors of the model that averaging does not remove, in radii."""
    model = ShadowModel(np.radians(20.0), RockModel("cube"))
    return model.radius_sigma, model.centre_sigma


def test_rates_fall_with_size(script, tmp_path):
    rates = script("shadows", "detection_rates")
    options = {"shape": "cube"}
    rows = run_study(rates.study, count=1, options=options, out=tmp_path)
    report_study(rates.study, rows, options=options, out=tmp_path)
    data = rates.pooled_rates(rows)
    rocks, missed = data["rocks"], data["missed"]
    assert missed[rocks > 50][0] > 0.4
    assert missed[(rocks > 50)][-1] < 0.2
    assert (tmp_path / "rates_cube.png").exists()


def test_real_image_prints_precision_and_recall(script, tmp_path):
    real_image = script("shadows", "real_image")
    arguments = ["--out", str(tmp_path), "--json", str(tmp_path / "nac.json")]
    done = CliRunner().invoke(real_image.main, arguments)
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "nac.json").read_text())
    assert figures["precision"] >= 0.9
    assert abs(figures["direction_deg"] - figures["stated_deg"]) < 10.0
    assert (tmp_path / "nac.png").stat().st_size > 20_000


@pytest.fixture
def small(script, tmp_path, monkeypatch):
    """Two short descents instead of the paper's."""
    experiment = script("shadows", "nominal_vs_modified")
    for path, speed in (("nominal", 9.0), ("modified", 11.0)):
        short = Scenario.from_dict(SMALL_SHADOW_FLIGHT).changed(
            start={"velocity_m_s": [speed, 4.0, -9.0]}
        )
        short.save(tmp_path / f"shadow_{path}.toml")
    monkeypatch.setattr(experiment, "SCENARIOS", tmp_path)
    monkeypatch.setattr(experiment, "ALTITUDES", (80.0, 50.0))
    return experiment


def test_experiment_compares_two_paths(small, tmp_path, capsys):
    results = run_study(small.study, count=1, out=tmp_path / "out")
    assert [r["path"] for r in results] == list(small.PATHS)
    assert all(r["landed"] for r in results)
    summary = small.summarise(results)
    low = summary["altitudes"][50.0]["clear_recall"]
    # Seen from the side of the Sun, little terrain is visibly free of shadows.
    assert 0.02 < low["nominal"].mean <= 1.0
    difference = low["modified"].mean - low["nominal"].mean
    assert low["difference"].mean == pytest.approx(difference)
    report_study(small.study, results, out=tmp_path / "out")
    assert "clear area classified as clear" in capsys.readouterr().out
    assert len(list((tmp_path / "out").glob("*.png"))) == 6
    assert results[0]["levels"]["50.0"]["counts"]["cells"] == 14_400


def test_invalid_requests_are_rejected(script):
    experiment = script("shadows", "nominal_vs_modified")
    for arguments in (["--fields", "0"], ["--shapes", "pyramid"], ["--jobs", "x"]):
        done = CliRunner().invoke(study_command(experiment.study), arguments)
        assert done.exit_code == 2
        assert "Error" in done.output


@pytest.mark.slow
def test_default_rates_are_those_printed_by_the_script(script):
    rates = script("shadows", "detection_rates")
    for name, line in rates.pooled_rates(run_study(rates.study))["lines"].items():
        assert getattr(DetectionRates(), name) == pytest.approx(line, abs=6e-4), name


def test_orthogonal_array_has_every_pair_of_levels_once(script):
    cells = script("shadows", "cells")
    runs = [c for c in cells.CELLS if c.name.startswith("array") and c.pixels == 1]
    columns = np.array(
        [
            (
                c.cover, cells.SHAPES.index(c.shape),
                (cells.SHAPES.index(c.expected_shape) - cells.SHAPES.index(c.shape)) % 5,
                c.elevation, c.turn, c.relief,
            )
            for c in runs
        ]
    )  # fmt: skip
    assert columns.shape == (25, 6)
    for a, b in combinations(range(6), 2):
        assert len({tuple(row) for row in columns[:, [a, b]]}) == 25
    assert len({c.name for c in cells.CELLS}) == len(cells.CELLS) == 79
    for cell in cells.CELLS:
        scenario = cell.scenario()
        assert (scenario.rocks.cover, scenario.expected_rocks.shape) == (
            cell.cover,
            cell.expected_shape,
        )
        assert scenario.sensors["camera"].width == 640 * cell.pixels
        rocks = scenario.rocks
        assert rocks.min_diameter_m == cell.min_diameter
        assert cell.height in (None, rocks.height_ratio[0])
        assert cell.slenderness in (None, pytest.approx(np.mean(rocks.axis_ratio)))
        assert getattr(scenario.terrain.table, "crater_density", None) == (cell.craters or None)


@pytest.fixture
def matrix(script, monkeypatch):
    """The matrix with one short descent for all cells."""
    module = script("shadows", "matrix")
    short = Scenario.from_dict(SMALL_SHADOW_FLIGHT)
    monkeypatch.setattr(module.ShadowCell, "scenario", lambda self, path: short)
    return module


def test_matrix_evaluates_maps_and_touchdowns(matrix, capsys):
    rows = run_study(matrix.study, count=1, levels={"cell": ["home", "hirise"]})
    assert [row["cell"] for row in rows] == ["home", "hirise"]
    counts, table = rows[0]["classes"], np.array(rows[0]["reliability"])
    assert table[:, 0].sum() == counts["cells"] and table[:, 2].sum() == counts["occupied"]
    assert rows[0]["landed"] and rows[0]["objects"] >= rows[0]["objects_clear"]
    report_study(matrix.study, rows)
    assert "of 2 cells miss a goal" in capsys.readouterr().out


@pytest.mark.parametrize("off", [0.0, 3.0])
def test_chosen_site_is_evaluated_at_its_true_position(matrix, monkeypatch, off):
    """On the largest rock and, by a navigation error, next to it; staying is a choice too."""
    simulation = Simulation(Scenario.from_dict(SMALL_SHADOW_FLIGHT), 1)
    rocks = simulation.world.terrain.rocks
    largest = int(np.argmax(rocks.a))
    rock = np.array([rocks.x[largest], rocks.y[largest], 0.0])
    error = np.array([5.0, -2.0, 0.0])
    monkeypatch.setattr(Simulation, "navigation_error", error)
    decision = Decision(site=rock + error + [off, 0.0, 0.0], reason="told")
    monkeypatch.setattr(Simulation, "ask", lambda self, policy, shown: decision)
    monkeypatch.setattr(
        matrix, "has_hazard_in_footprint", lambda s, xy: np.hypot(*(xy - rock[:2]).T) < 1.0
    )
    found = matrix.evaluate_safest_site(simulation)
    assert found["diverts"] and found["site_on_hazard"] is (off == 0.0)
    monkeypatch.setattr(Simulation, "ask", lambda self, policy, shown: Decision.keep("safe"))
    simulation.computer.site = rock + error
    found = matrix.evaluate_safest_site(simulation)
    assert not found["diverts"] and found["site_on_hazard"]


def test_matrix_names_missed_goals(matrix):
    good = {"clear_false": 0.001, "objects_clear": 0.0, "clear_recall": 0.7}
    cell = matrix.ShadowCell("x")
    assert matrix.missed_requirements(cell, good) == ""
    bad = {"clear_false": 0.003, "objects_clear": 0.05, "clear_recall": 0.5}
    assert matrix.missed_requirements(cell, bad) == "area, objects, recall"
    far = matrix.ShadowCell("x", relief=8.0)
    assert matrix.missed_requirements(far, bad | {"clear_false": float("nan")}) == "objects"


def test_faulty_images_are_rejected_and_most_good_ones_accepted(script):
    health = script("shadows", "image_check")
    rows = health.check_images(Case({"cover": 0.05, "slope": 2.0}, 0, 11, {"faults": True}))
    by = {}
    for row in rows:
        by.setdefault(row["fault"], []).append(row["result"])
    assert len(by) == 20 and len(by["none"]) == 15
    # A smear of 4 pixels and a blur of 1 pixel are close to those of the camera.
    mild = {"none", health.SEEN, "defocus 1.0 px", "smear 4 px"}
    assert not {name for name in by if name not in mild and "counts" in by[name]}
    assert by[health.SEEN].count("counts") >= 11
    assert "FAINT" in by["black"] and "SUN_ELSEWHERE" in by["Sun +30 deg"]
