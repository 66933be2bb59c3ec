"""Guidance studies on small cases."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.parts.registry import kinds
from lunarsim.studies import report_study, run_study
from lunarsim.studies.command import study_command


def test_propellant_of_laws_is_compared_with_the_optimum(script, capsys):
    study = script("guidance", "propellant").study
    flown = run_study(study, count=1)
    report_study(study, flown)
    printed = capsys.readouterr().out
    assert "relative to the optimum" in printed
    rows = {row["law"]: row for row in flown}
    assert set(rows) == set(kinds("guidance", with_files=False))
    assert len({row["optimum"] for row in rows.values()}) == 1
    apollo, optimal, neural = (rows[law] for law in ("apollo", "optimal", "neural-optimal"))
    assert apollo["safe"] and optimal["safe"] and rows["information-seeking"]["safe"]
    assert optimal["approach"] < 1.02 * optimal["optimum"] < 0.95 * apollo["approach"]
    assert optimal["plans"] > 15
    assert optimal["fallbacks"] == apollo["plans"] == apollo["network_evaluations"] == 0
    assert (
        neural["network_evaluations"] > 100
        and f"{neural['infeasible']} of {neural['network_evaluations']}" in printed
    )


def test_infeasible_starts_are_rejected(script, monkeypatch):
    module = script("guidance", "propellant")
    problem = module.optimal_descent_problem

    def short_of_fuel(flight):
        d = problem(flight)
        return replace(d, dry_mass=d.mass - 0.5)

    monkeypatch.setattr(module, "optimal_descent_problem", short_of_fuel)
    done = CliRunner().invoke(study_command(module.study), ["--flights", "1", "--law", "optimal"])
    assert done.exit_code == 2, done.output
    message = "must give every flight a feasible descent, but flight 0 has none"
    assert message in " ".join(done.output.split())


def test_spherical_and_flat_moon_are_compared(script, capsys):
    study = script("guidance", "spherical_and_flat_moon")
    report_study(study.study, run_study(study.study, count=1))
    printed = capsys.readouterr().out
    assert "55418.29" in printed
    assert "1 flights from a distance of 600 m" in printed
    # Close to the site both models give the same fall.
    r, v = np.array([-300.0, 0.0, 900.0]), np.array([20.0, 0.0, -20.0])
    fell = study.free_fall_position(None, r, v)
    assert fell == pytest.approx(r + 30.0 * v - [0.0, 0.0, 0.5 * 1.622 * 900.0], abs=1e-6)


def test_reach_shrinks_on_the_way_down(script, tmp_path):
    study = script("guidance", "reach").study
    options = {"law": "e-guidance", "height": (450.0, 200.0)}
    rows = run_study(study, options=options)
    report_study(study, rows, options=options, out=tmp_path)
    areas = [row["area_km2"] for row in rows]
    assert areas[0] > 2.0 * areas[1] > 0.0
    # Area of the surveyed square, 6.5 heights wide, km^2.
    assert all(0.05 * (6.5 * up) ** 2 < 1e6 * a < (6.5 * up) ** 2
               for up, a in zip((450.0, 200.0), areas, strict=True))  # fmt: skip
    assert cv2.imread(str(tmp_path / "reach.png")).std() > 20
