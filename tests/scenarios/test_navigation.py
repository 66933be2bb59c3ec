"""Studies of navigation: what they write and add up, small, and their claims, at length."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.evaluation.consistency import Consistency
from tests.conftest import SCENARIOS


def run(command, *arguments):
    done = CliRunner().invoke(command, [str(a) for a in arguments])
    assert done.exit_code == 0, done.output
    return done.output


def test_consistency_is_printed_and_written_by_epoch(script, tmp_path):
    study, out = script("navigation", "consistency"), tmp_path / "flown.json"
    words = [
        "--flights",
        2,
        "--seed",
        3,
        "--json",
        out,
        "--set",
        "start_knowledge.position_m=1e-4",
    ]
    text = run(study.main, *words)
    assert "NEES over degrees of freedom" in text
    assert "stars attitude" in text
    (flights,) = json.loads(out.read_text()).values()
    assert len(flights) == 2
    for flight in flights:
        assert len(flight["error"]) == len(flight["sigma"]) == len(flight["nis_at"])
        # What was taken in between epochs adds up to what was taken in before the last.
        speeds = [at["velocimeter speed of beam 1"] for at in flight["nis_at"][1:]]
        assert all(degrees > 0 and total >= 0.0 for total, degrees in speeds)
        first = np.array(flight["error"][0]) / flight["sigma"][0]
        assert flight["nees"]["all nine"] is not None
        assert np.all(np.abs(first) < 6.0)
        # What was set on the command line was flown.
        assert flight["start_error"] < 1e-3


def test_flights_with_faults_are_written_and_added_up(script, tmp_path, monkeypatch):
    faults, out = script("navigation", "faults"), tmp_path / "faults.json"
    monkeypatch.setattr(faults, "RELIEFS", (4.0,))
    words = ["--flights", 1, "--only", "none", "--only", "velocimeter dead", "--json", out]
    assert "velocimeter dead" in run(faults.main, *words)
    flown = json.loads(out.read_text())
    assert [f["row"] for f in flown] == ["none", "velocimeter dead"]
    more = tmp_path / "rocks.json"
    wrong = [
        {"row": "none", "far": 0, "lost": 1, "doubted": 0, "safe": 1},
        {"row": "Sun 45 deg off", "far": 1, "lost": 1, "doubted": 0, "safe": 0},
        {"row": "Sun 45 deg off", "far": 1, "lost": 0, "doubted": 0, "safe": 0},
    ]
    more.write_text(json.dumps(wrong))
    text = run(script("navigation", "undeclared").main, out, more)
    lines = [line.split("│") for line in text.splitlines() if line.startswith("│")]
    cells = {line[1].strip(): [cell.split(" [")[0].strip() for cell in line[2:5]] for line in lines}
    assert cells["rocks"] == ["1 of 3", "1 of 1", "1 of 3"]
    assert cells["all"][:2] == ["1 of 5", "1 of 2"]


def test_fits_begun_at_the_stated_error_are_not_wrong_and_would_be_seen(script, monkeypatch):
    study = script("navigation", "fits")
    tasks = [study.Task(*row, 0, 11) for row in (("objects", 0.5, 0.0), ("craters", 1.0, 0.2))]
    tried = [f for task in tasks for f in study.fits(task)]
    assert sum(f.believed for f in tried) > 10
    assert not any(f.wrong for f in tried)

    def blind(seen, features, covariance):
        return np.zeros(len(covariance)), False, np.zeros((2, 2))

    monkeypatch.setattr("lunarsim.onboard.navigation.registration._begin", blind)
    assert any(f.wrong for task in tasks for f in study.fits(task))


def test_a_flight_on_a_map_out_of_date_is_judged(script, tmp_path):
    study = script("navigation", "prior_map")
    assert all(row.startswith("none") == (not r.prior.keys() - {"posting_m", "sigma_m"}
               and not r.scanner and r.kept is None) for row, r in study.ROWS.items())  # fmt: skip
    kept = study.ROWS["no flashes for 4 s"].kept
    rng = np.random.default_rng(0)
    assert [kept(t, rng) for t in (5.9, 6.0, 9.9, 10.0)] == [True, False, False, True]


# --- at length ----------------------------------------------------------------------------------

# Scenario, and how modest it may be: what a map's post tells counts less where it is used again,
# and scans are taken to differ by more than they do on level grass.
SETS = {"instruments": 1.0, "two_eyes": 0.9, "shadow_nominal": 1.0, "morpheus": 0.5}
# Innovations may be smaller than said, by kind: what is left out of a rock's tails, what a map
# that is used again makes of scans and of fits.
MODEST = {"places": 0.4, "scans": 0.2, "map": 0.0}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_errors_of_fifty_flights_are_what_is_said(script, name):
    study = script("navigation", "consistency")
    path = str(SCENARIOS / f"{name}.toml")
    flown = [study.fly(study.Task(path, None, n, 1001, "safest", None)) for n in range(50)]
    assert sum(f.lost[0] for f in flown) <= 1
    for f in flown:
        # A mean over fifty hides one that is far off and does not know.
        sigma = np.sqrt(np.diagonal(f.covariance, axis1=1, axis2=2))
        assert f.lost[0] or (np.abs(f.error) < 5.0 * sigma).all()
    for k in range(len(study.EPOCHS)):
        for part, keep in study.PARTS.items():
            found = study.nees_of(flown, k, keep)
            low, high = found.bounds(study.LEVEL)
            assert SETS[name] * low <= found.ratio <= high, (part, study.EPOCHS[k])
        for kind in {kind for f in flown if len(f.latest) > k for kind in f.latest[k]}:
            found = [f.latest[k][kind] for f in flown if len(f.latest) > k and kind in f.latest[k]]
            total = Consistency(sum(c.total for c in found), sum(c.degrees for c in found))
            low, high = total.bounds(study.LEVEL)
            modest = next((share for end, share in MODEST.items() if kind.endswith(end)), 1.0)
            # Rocks of a pixel a radius scatter by more than is said.
            bold = 1.7 if kind.endswith("places") else 1.0
            assert modest * low <= total.ratio <= bold * high, (kind, study.EPOCHS[k])


@pytest.mark.slow
def test_fewer_than_one_believed_fit_in_a_thousand_is_wrong(script):
    text = run(script("navigation", "fits").main, "--fits", 1000, "--seed", 11)
    last = next(line for line in text.splitlines() if line.startswith("│ all"))
    fits, believed, _, wrong = (cell.strip() for cell in last.split("│")[2:6])
    assert int(fits) >= 8000
    assert int(believed) > 4000
    assert int(wrong.split()[0]) / int(believed) < 1e-3
