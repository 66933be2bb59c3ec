"""Navigation studies: output on small cases, and (slow) their claims."""

from __future__ import annotations

import json

import click
import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.scenario import Scenario
from lunarsim.studies import Case, report_study, run_study
from tests.conftest import SCENARIOS


def run(command, *arguments):
    done = CliRunner().invoke(command, [str(a) for a in arguments])
    assert done.exit_code == 0, done.output
    return done.output


def test_consistency_is_printed_and_written_by_epoch(script, tmp_path, capsys):
    study, out = script("navigation", "consistency").study, tmp_path / "flown"
    changes = (
        "initial_uncertainty.position_m=1e-4", "terrain.size_m=300",
        "start.position_m=[-300,0,250]", "start.velocity_m_s=[18,0,-12]", "simulation.cycle_s=0.2",
    )  # fmt: skip
    report_study(study, run_study(study, count=2, seed=3, options={"changes": changes}, out=out))
    text = capsys.readouterr().out
    assert "NEES / degrees of freedom" in text
    assert "stars attitude" in text
    flights = json.loads((out / "results.json").read_text())["rows"]
    assert len(flights) == 2
    for flight in flights:
        assert len(flight["error"]) == len(flight["sigma"]) == len(flight["nis_at"])
        # The sums between epochs add up to the total before the last epoch.
        speeds = [at["velocimeter speed of beam 1"] for at in flight["nis_at"][1:]]
        assert all(degrees > 0 and total >= 0.0 for total, degrees in speeds)
        first = np.array(flight["error"][0]) / flight["sigma"][0]
        assert flight["nees"]["all nine"] is not None
        assert np.all(np.abs(first) < 6.0)
        # The settings of the command line were used.
        assert flight["start_error"] < 1e-3


def drawn(study, rng, *, scale=1.0, lost=False, nis=1.0):
    """Return a flight with errors scaled by `scale` and innovations by `nis`."""
    root = rng.standard_normal((9, 9)) + 3.0 * np.eye(9)
    covariance = np.array([root @ root.T] * len(study.EPOCHS))
    error = scale * rng.standard_normal((len(covariance), 9)) @ root.T
    latest = [{"beam range": [nis * rng.chisquare(40), 40]} for _ in study.EPOCHS]
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return {
        "variant": "the scenario's", "error": error, "covariance": covariance, "sigma": sigma,
        "nis_last": latest, "nis_at": latest, "rejected": {}, "inflated": 0, "lost": lost,
        "ever_lost": lost, "start_error": 0.0, "map_error": 0.0, "safe": True,
    }  # fmt: skip


def test_consistent_and_inconsistent_flights_are_distinguished(script):
    study, rng = script("navigation", "consistency"), np.random.default_rng(4)
    right = [drawn(study, rng) for _ in range(50)]
    assert study.inconsistencies(right, 1.0) == []
    assert study.inconsistencies([drawn(study, rng, lost=n == 0) for n in range(50)], 1.0) == []
    (line,) = study.inconsistencies([drawn(study, rng, lost=n < 2) for n in range(50)], 1.0)
    assert "2 of 50 flights ended lost" in line
    bold = study.inconsistencies([drawn(study, rng, scale=1.3) for _ in range(50)], 1.0)
    assert sum("NEES of all nine" in line for line in bold) == len(study.EPOCHS)
    timid = [drawn(study, rng, scale=0.8) for _ in range(50)]
    assert any("NEES" in line for line in study.inconsistencies(timid, 1.0))
    assert not any("NEES" in line for line in study.inconsistencies(timid, 0.5))
    # One flight with a large undeclared error among many consistent ones.
    sigma = np.sqrt(np.diag(right[7]["covariance"][2]))
    for lost in (False, True):
        right[7]["error"][2] = 0.0
        right[7]["error"][2, 3] = 5.2 * sigma[3]
        right[7]["lost"] = lost
        assert any("flight 7" in line for line in study.inconsistencies(right, 0.01)) is not lost
    for nis in (0.8, 1.25):
        off = study.inconsistencies([drawn(study, rng, nis=nis) for _ in range(50)], 1.0)
        assert sum("NIS of beam range" in line for line in off) == len(study.EPOCHS)


def test_monitored_quantities_are_no_measurements(script):
    study = script("navigation", "consistency")
    kinds = ["rocks' places", "flash map", "flash scans", "stars attitude", "speed of beam 1"]
    assert all(study.corrects_state(kind) for kind in kinds)
    assert not any(
        study.corrects_state(k) for k in ("rocks' expected", "rocks' shadows", "flash fits")
    )


def test_check_exits_with_1_if_errors_are_inconsistent(script, capsys):
    study, rng = script("navigation", "consistency"), np.random.default_rng(5)
    check = {"lower_factor": 1.0}
    report_study(study.study, [drawn(study, rng) for _ in range(20)], options=check)
    assert "NEES of all nine at 0.15: " not in capsys.readouterr().out
    with pytest.raises(click.exceptions.Exit) as stopped:
        report_study(study.study, [drawn(study, rng, scale=2.0) for _ in range(20)], options=check)
    assert stopped.value.exit_code == 1
    assert "NEES of all nine at 0.15: " in capsys.readouterr().out


@pytest.mark.slow
def test_flights_with_faults_are_written_and_summed(script, tmp_path, monkeypatch, capsys):
    faults, out = script("navigation", "faults"), tmp_path / "faults"
    # Smaller terrain, smaller initial error and a shorter descent.
    Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"size_m": 300.0}, initial_uncertainty={"position_m": 5.0},
        start={"position_m": [-300.0, 0.0, 250.0], "velocity_m_s": [18.0, 0.0, -12.0]},
    ).save(tmp_path / "instruments.toml")  # fmt: skip
    monkeypatch.setattr(faults, "SCENARIOS", tmp_path)
    levels = {"fault": ["none", "velocimeter dead"], "relief": [4.0]}
    rows = run_study(faults.study, count=1, levels=levels, out=out)
    report_study(faults.study, rows)
    assert "velocimeter dead" in capsys.readouterr().out
    flown = json.loads((out / "results.json").read_text())["rows"]
    assert [f["fault"] for f in flown] == ["none", "velocimeter dead"]
    more = tmp_path / "rocks"
    wrong = [
        {"fault": "none", "far": 0, "lost": 1, "inflated": 0, "safe": 1},
        {"fault": "Sun 45 deg off", "far": 1, "lost": 1, "inflated": 0, "safe": 0},
        {"fault": "Sun 45 deg off", "far": 1, "lost": 0, "inflated": 0, "safe": 0},
    ]
    more.mkdir()
    (more / "results.json").write_text(json.dumps({"rows": wrong}))
    text = run(script("navigation", "undeclared_failures").main, out, more)
    lines = [line.split("│") for line in text.splitlines() if line.startswith("│")]
    cells = {line[1].strip(): [cell.split(" [")[0].strip() for cell in line[2:5]] for line in lines}
    assert cells["rocks"] == ["1 of 3", "1 of 1", "1 of 3"]
    assert cells["all"][:2] == ["1 of 5", "1 of 2"]


def test_fits_with_the_assumed_error_are_correct_and_errors_are_detected(script, monkeypatch):
    study = script("navigation", "scan_fits")
    levels = (("objects", 0.5, 0.0), ("craters", 1.0, 0.2))
    cases = [
        Case({"terrain": terrain, "posting": posting, "outdated": outdated}, 0, 11)
        for terrain, posting, outdated in levels
    ]
    tried = [f for case in cases for f in study.simulate_fits(case)]
    assert sum(f["accepted"] for f in tried) > 10
    assert not any(f["wrong"] for f in tried)

    def blind(seen, features, covariance):
        return np.zeros(len(covariance)), False, np.zeros((2, 2))

    monkeypatch.setattr("lunarsim.onboard.navigation.registration._initial_error", blind)
    assert any(f["wrong"] for case in cases for f in study.simulate_fits(case))


def test_flight_on_an_outdated_map_is_evaluated(script, tmp_path):
    study = script("navigation", "prior_map")
    for name, row in study.ROWS.items():
        changed = row.map_changes.keys() - {"posting_m", "sigma_m"} or row.scanner_changes
        assert name.startswith("none") == (not changed and row.is_delivered is None)
    is_delivered = study.ROWS["no flashes for 4 s"].is_delivered
    rng = np.random.default_rng(0)
    assert [is_delivered(t, rng) for t in (5.9, 6.0, 9.9, 10.0)] == [True, False, False, True]


# --- slow tests ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["instruments", "camera_and_lidar", "shadow_nominal", "morpheus"])
def test_errors_of_fifty_flights_are_consistent(script, name):
    study = script("navigation", "consistency")
    modest, changes = script("navigation", "consistency_bounds").SETS[name]
    options = {"scenario": str(SCENARIOS / f"{name}.toml"), "changes": changes}
    rows = run_study(study.study, count=50, seed=1201, options=options)
    assert study.inconsistencies(rows, modest) == []


@pytest.mark.slow
def test_fewer_than_one_accepted_fit_in_a_thousand_is_wrong(script, capsys):
    study = script("navigation", "scan_fits").study
    report_study(study, run_study(study, count=50, seed=11))
    text = capsys.readouterr().out
    last = next(line for line in text.splitlines() if line.startswith("│ all"))
    fits, believed, _, wrong = (cell.strip() for cell in last.split("│")[2:6])
    assert int(fits) >= 8000
    assert int(believed) > 4000
    assert int(wrong.split()[0]) / int(believed) < 1e-3
