from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.parts import CONTRACTS, resolve, settings_of
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight
from tests.worlds import SCENARIOS, TINY_FLIGHT


def run(*args: str):
    return CliRunner().invoke(main, list(args))


@pytest.mark.parametrize(
    "command",
    [(), ("fly",), ("compare",), ("calibrate",), ("render",)],
    ids=str,
)
def test_help(command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert "Usage:" in result.output
    assert len(result.output) > 300


def test_version():
    assert "lunarsim, version" in run("--version").output


@pytest.fixture
def small(small_scenario, tmp_path):
    path = tmp_path / "small.toml"
    small_scenario.save(path)
    return path


def test_fly_prints_the_outcome_and_writes_the_record(small, tmp_path):
    out = tmp_path / "flight"
    result = run("fly", str(small), "--seed", "3", "--out", str(out))
    assert result.exit_code == 0, result.output
    printed = dict(re.findall(r"^ +(\S.*?)  +(\S.*?) *$", result.stdout, re.MULTILINE))
    assert printed.pop("map 'dem'") == "is outside its calibrated domain"
    diverts = [printed.pop(name) for name in list(printed) if re.fullmatch(r"[\d.]+ s", name)]
    flight = Flight.load(out)
    changes = np.any(np.diff(flight.sites[:, :2], axis=0) != 0.0, axis=1)
    assert len(diverts) == np.count_nonzero(changes)
    assert all(line.endswith("safest site") for line in diverts)
    touchdown, degrees = flight.outcome.touchdown, np.rad2deg
    assert printed == {
        "time of flight": f"{flight.trajectory['time'][-1]:.1f} s",
        "propellant": f"{flight.trajectory['mass'][0] - flight.trajectory['mass'][-1]:.1f} kg",
        "divert": f"{flight.divert_distance:.1f} m",
        "touchdown": "({:.1f}, {:.1f}) m (east, north; true frame)".format(
            *flight.positions[-1, :2]
        ),
        "vertical speed": f"{touchdown.vertical_speed:.2f} m/s",
        "horizontal speed": f"{touchdown.horizontal_speed:.2f} m/s",
        "tilt at contact": f"{degrees(touchdown.tilt):.1f} deg",
        "slope under the legs": f"{degrees(touchdown.slope):.1f} deg",
        "roughness under the belly": f"{touchdown.roughness:.2f} m",
        "tip-over margin": f"{touchdown.tip_margin:.2f}",
    }
    assert {p.name for p in out.iterdir()} >= {"flight.json", "descent.png", "maps.png"}
    again = Scenario.load(out / "scenario.toml")
    assert again == Scenario.load(small)


def test_compare_prints_a_row_a_policy(tmp_path):
    """Also of a scenario and in a folder whose names look like markup."""
    tiny, out = tmp_path / "tiny.toml", tmp_path / "out [/x]"
    Scenario.from_dict(TINY_FLIGHT | {"name": "mare [/low sun]"}).save(tiny)
    result = run(
        "compare", str(tiny), "--policies", "no-divert,safest", "--flights", "1", "--jobs", "1",
        "--out", str(out), "--no-figures", "--cache", str(tmp_path / "cache"),
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "mare [/low sun]" in result.stderr
    assert f"results, flight records and figures are in {out}" in result.stdout
    # As of `campaign run`: its engine, its cache, kernels first.
    assert json.loads((out / "manifest.json").read_text())["engine"] == "local"
    assert list((tmp_path / "cache").rglob("*.npz")) and "Kernels are ready" in result.output
    assert "truly safe fraction" in result.output
    rows = {row["policy"]: row for row in pq.read_table(out / "results.parquet").to_pylist()}
    for policy in ("no-divert", "safest"):
        (told,) = [line for line in result.output.splitlines() if line.startswith(f"│ {policy}")]
        cells, row = [cell.strip() for cell in told.strip("│").split("│")], rows[policy]
        burnt = f"{row['propellant_kg']:.1f}"
        assert cells[4] == f"{burnt} / {burnt}"
        named = row["map_true_safe"] + row["map_false_safe"]
        true = row["map_true_safe"] + row["map_false_unsafe"]
        assert cells[8:10] == [
            f"{row['map_true_safe'] / named:.4f}",
            f"{row['map_true_safe'] / true:.3f}",
        ]


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        ("[terrain]\nposting_km = 1", ["terrain.posting_km", "Did you mean"]),
        ('[vehicle]\ndry_mass_kg = "1 t"', ["vehicle.dry_mass_kg", "1 t", "plain number in kg"]),
        ("[vehicle]\nthrust_max_n = 1000", ["vehicle.thrust_max_n", "cannot hover"]),
        ("[lidar]\nrows = 64", ["lidar", "[sensors.NAME]", "flash-lidar"]),
        ("[tasking.camera]\nkind = 'periodic'", ["tasking.camera", "the name of a sensor"]),
        ('[terrain]\nkind = "dtm"\npath = "gone.tif"', ["terrain.path", "gone.tif", "existing"]),
        ('[terrain]\nkind = "dtm"\npath = "bad.toml"', ["terrain.path", "GTiff"]),
        ("[start]\nposition_m = [0, 0, -10]", ["start.position_m[2]", "starts inside the terrain"]),
        ("[target]\nposition_m = [900, 0]", ["target.position_m", "is on the terrain"]),
    ],
)
def test_mistakes_end_with_code_2_and_write_nothing(tmp_path, edit, words):
    path = tmp_path / "bad.toml"
    path.write_text(edit)
    out = tmp_path / "out"
    for arguments in (["fly", str(path)], ["compare", str(path), "--flights", "1"]):
        result = run(*arguments, "--out", str(out))
        assert result.exit_code == 2, result.output
        assert "Traceback" not in result.output
        for word in words:
            assert word in result.output.replace("\n", "")
    assert not out.exists()


def test_a_folder_with_other_files_is_refused(small, tmp_path):
    result = run("fly", str(small), "--out", str(tmp_path))
    assert result.exit_code == 2
    assert "new or empty folder" in result.output


def test_unwritable_output_is_a_clean_error(small, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("x")
    result = run("fly", str(small), "--out", str(blocked / "sub"))
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_command_is_installed():
    done = subprocess.run(
        [sys.executable, "-m", "lunarsim.cli", "fly", str(SCENARIOS / "none.toml")],
        capture_output=True, text=True, env=os.environ | {"COLUMNS": "120"}, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("error: scenario")


def test_render_writes_the_image_and_its_truth(tmp_path):
    scenario = SCENARIOS / "hirise.toml"
    out, truth = tmp_path / "x.png", tmp_path / "x.npz"
    options = ["--altitude", "40", "--sun-elevation", "12", "--out", str(out)]
    done = run("render", str(scenario), *options, "--truth", str(truth))
    assert done.exit_code == 0, done.output
    picture = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (480, 640)
    assert picture.std() > 5
    with np.load(truth) as arrays:
        assert arrays["range"].shape == (480, 640)
        assert np.nanmin(arrays["range"]) > 20.0
    again = tmp_path / "y.png"
    assert run("render", str(scenario), *options[:-1], str(again)).exit_code == 0
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--altitude", "-5"], "altitude"),
        (["--off-nadir", "89"], "off-nadir"),
        (["--sun-elevation", "95"], "sun.elevation_deg"),
        (["--exposure", "0"], "--exposure"),
    ],
)
def test_render_refuses_bad_values_and_writes_nothing(tmp_path, options, says):
    out = tmp_path / "x.png"
    done = run("render", str(SCENARIOS / "hirise.toml"), *options, "--out", str(out))
    assert done.exit_code == 2
    assert says in done.output
    assert not out.exists()


def test_terrain_info_and_preview(tmp_path):
    data = SCENARIOS / "data" / "moon_apollo15_nac_dtm_2m.tif"
    done = run("terrain", "info", str(data))
    assert done.exit_code == 0
    assert "257 x 257" in done.output
    assert "dtm_posting_m" in done.output
    out = tmp_path / "p.png"
    done = run("terrain", "preview", str(SCENARIOS / "golombek.toml"), "--out", str(out))
    assert done.exit_code == 0, done.output
    assert out.stat().st_size > 10_000
    assert run("terrain", "info", str(tmp_path / "none.tif")).exit_code == 2
    bad = run("terrain", "preview", str(SCENARIOS / "golombek.toml"), "--out", str(tmp_path / "p"))
    assert bad.exit_code == 2


def test_parts_lists_what_scenarios_choose_from():
    everything = run("parts")
    assert everything.exit_code == 0, everything.output
    lines = [line.split(maxsplit=2) for line in everything.output.splitlines()]
    found = {(contract, kind) for contract, kind, _ in lines}
    assert found == {(c, kind) for c, contract in CONTRACTS.items() for kind in contract.kinds}
    assert all(what[0].isupper() for _, _, what in lines)
    mappers = run("parts", "mapper").output
    assert "shadow" in mappers and "safest" not in mappers
    wrong = run("parts", "maper")
    assert wrong.exit_code == 2
    assert "Did you mean 'mapper'?" in wrong.output


@pytest.mark.parametrize("form", [[], ["--markdown"]], ids=["text", "markdown"])
def test_reference_reports_every_key_of_every_kind(form):
    done = run("scenario", "reference", *form)
    assert done.exit_code == 0, done.output
    for contract, kinds in CONTRACTS.items():
        for kind in kinds.kinds:
            assert f'kind = "{kind}"' in done.output
            for key in settings_of(resolve(contract, kind)).model_fields:
                assert key in done.output
    for table in ("[start]", "[target]", "[prior_map] (optional)", "[simulation]"):
        assert table in done.output
    row = next(line for line in done.output.splitlines() if "heading_deg" in line)
    assert "90" in row and "deg" in row and "Azimuth of the lander's x axis" in row


def test_check_prints_the_scenario_whole_or_what_is_wrong(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text('name = "x"\n[sun]\nelevation_deg = 12.0')
    done = run("scenario", "check", str(path))
    assert done.exit_code == 0, done.output
    printed = Scenario.from_toml(done.stdout)
    assert printed == Scenario.load(path)
    assert (printed.sun.elevation_deg, printed.sun.azimuth_deg) == (12.0, 270.0)
    path.write_text("[sun]\nelevation = 12.0")
    done = run("scenario", "check", str(path))
    assert done.exit_code == 2
    assert "Did you mean 'elevation_deg'?" in done.output


def test_a_class_of_ones_own_is_flown(small, tmp_path):
    module = tmp_path / "my_policies.py"
    module.write_text(
        "from dataclasses import dataclass\n"
        "from lunarsim.onboard.policies import Decision\n"
        "@dataclass(frozen=True)\n"
        "class Stay:\n"
        "    name: str = 'stay'\n"
        "    def decide(self, observation):\n"
        "        return Decision.keep('as told')\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "lunarsim.cli", "fly", str(small), "--policy", "my_policies:Stay"],
        capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "vertical speed" in done.stdout
    assert "divert to" not in done.stdout


@pytest.mark.parametrize("command", ["fly", "compare"])
def test_set_applies_to_the_parts_that_options_name(command, tmp_path):
    """Keys of the named law and policy, which the scenario's own parts lack."""
    tiny = tmp_path / "tiny.toml"
    Scenario.from_dict(TINY_FLIGHT | {"policy": {"kind": "no-divert"}}).save(tiny)
    changes = ["--set", "guidance.gamma=0.6", "--set", "policy.p_safe_min=0.9"]
    parts = {"fly": ["--policy", "nearest-safe"], "compare": ["--policies", "nearest-safe"]}
    more = {"fly": [], "compare": ["--flights", "1", "--jobs", "1", "--no-figures",
                                   "--cache-size", "0"]}  # fmt: skip
    out = tmp_path / "out"
    done = run(
        command, str(tiny), *changes, "--guidance", "fractional-polynomial", *parts[command],
        *more[command], "--out", str(out),
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    flown = Scenario.load(out / "scenario.toml")
    assert (flown.guidance.kind, flown.guidance.gamma) == ("fractional-polynomial", 0.6)
    assert (flown.policy.kind, flown.policy.p_safe_min) == ("nearest-safe", 0.9)
    assert run(command, str(tiny), *changes, "--out", str(tmp_path / "other")).exit_code == 2
    more = ["--set", "guidance.path=no.oem", "--out", str(tmp_path / "other")]
    done = run(command, str(tiny), "--guidance", "trajectory", *more)
    assert (done.exit_code, "guidance.path: " in done.output) == (2, True)
