"""A file runs no code: a "module:Class" in it is imported only if the user allows the module."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace

import pytest
import tomli_w
from click.testing import CliRunner

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.run import run
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.parts import allow_modules
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.viz.style import flight_title
from tests.campaign.surrogate import plan as surrogate_plan
from tests.security.strange_parts import SOURCE
from tests.worlds import TINY_FLIGHT

MODULE = "strange_parts"
STRANGE = {"kind": f"{MODULE}:Mine"}
TABLES = {
    **{name: {name: STRANGE} for name in (
        "policy", "terrain", "vehicle", "navigation", "control", "guidance", "terminal_descent",
    )},
    "sensors.x": {"sensors": {"x": STRANGE}},
    "tasking.x": {"tasking": {"x": STRANGE}},
    "mappers.x": {"mappers": {"x": {"kind": f"{MODULE}.deep:Mine"}}},
    "braking": {"braking": {"law": f"{MODULE}:Mine"}},
}  # fmt: skip


@pytest.fixture
def mark(tmp_path, monkeypatch):
    """Return a file that exists as soon as the strange module has been imported."""
    mark = tmp_path / "imported"
    (tmp_path / f"{MODULE}.py").write_text(SOURCE.format(mark=str(mark)))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", ":".join(filter(None, sys.path)))
    monkeypatch.delenv("LUNARSIM_ALLOW_MODULES", raising=False)
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    yield mark
    sys.modules.pop(MODULE, None)


def write(path, tables):
    path.write_text(tomli_w.dumps(TINY_FLIGHT | tables))
    return path


def call(*arguments):
    return CliRunner().invoke(main, [str(one) for one in arguments])


@pytest.mark.parametrize("table", TABLES)
def test_a_scenario_imports_nothing(mark, tmp_path, table):
    path = write(tmp_path / "s.toml", TABLES[table])
    done = call("scenario", "check", path)
    assert done.exit_code == 2, done.output
    assert done.stderr.startswith(f"error: {table}.")
    assert f"--allow-module {MODULE}" in done.stderr and len(done.stderr) < 250
    with pytest.raises(InputError, match="allow"):
        Scenario.load(path)
    assert not mark.exists()


@pytest.mark.parametrize(
    "command",
    [
        ("fly",), ("compare", "--out", "o"), ("calibrate", "--out", "c.json"),
        ("render", "--out", "p.png"), ("terrain", "preview", "--out", "p.png"),
        ("terrain", "truth", "--out", "t.nc"), ("sweep", "--over", "rocks.cover=0,1", "--out", "o"),
        ("evaluate", "Retarget-v1", "--agent", "zero", "--scenario"),
    ],
)  # fmt: skip
def test_no_command_imports_what_a_file_names(mark, tmp_path, command):
    path = write(tmp_path / "s.toml", TABLES["policy"])
    done = call(*command, path)
    assert done.exit_code == 2 and "--allow-module" in done.stderr, done.output
    assert not mark.exists()


@pytest.mark.parametrize(
    "given",
    [
        {"factors": {"policy": ["no-divert", f"{MODULE}:Mine"]}},
        {"arms": [{"name": "a", "set": {"policy": STRANGE}}]},
        {"dispersions": {"policy": {"kind": "choice", "values": [f"{MODULE}:Mine"]}}},
    ],
)
def test_a_campaign_imports_nothing(mark, tmp_path, given):
    spec = {"name": "c", "flights": 1, "scenario": TINY_FLIGHT} | given
    (tmp_path / "c.toml").write_text(tomli_w.dumps(spec))
    for command in (("plan",), ("run", "--out", tmp_path / "o")):
        done = call("campaign", *command, tmp_path / "c.toml")
        assert done.exit_code == 2 and "--allow-module" in done.stderr, done.output
    assert not mark.exists()


@pytest.mark.parametrize(
    "name",
    ["antigravity:x", "strange_parts2:Mine", ":", "strange_parts;id:Mine", "..strange_parts:Mine",
     "lunarsim.cli:main", "os:system"],
)  # fmt: skip
def test_a_permission_is_for_one_package(mark, monkeypatch, name):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", f"{MODULE}, other")
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({"policy": {"kind": name}})
    assert caught.value.field == "policy.kind" and "imported" not in str(caught.value)
    assert "antigravity" not in sys.modules and not mark.exists()


@pytest.mark.parametrize("how", ["option", "variable", "typed"])
def test_the_user_allows_it(mark, tmp_path, monkeypatch, how):
    path = write(tmp_path / "s.toml", {} if how == "typed" else TABLES["policy"])
    more = {"option": ["--allow-module", MODULE], "typed": ["--set", f"policy={MODULE}:Mine"]}
    if how == "variable":
        monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", MODULE)
    done = call("scenario", "check", path, *more.get(how, []))
    assert done.exit_code == 0 and f'kind = "{MODULE}:Mine"' in done.output, done.output
    assert os.environ.get("LUNARSIM_ALLOW_MODULES", "") == (MODULE if how == "variable" else "")


@pytest.mark.parametrize("name", ["", "my package", "a:B", "a..b", "-x", "a,b"])
def test_what_is_no_module_cannot_be_allowed(mark, tmp_path, name):
    done = call("scenario", "check", write(tmp_path / "s.toml", {}), "--allow-module", name)
    assert done.exit_code == 2 and "--allow-module" in done.stderr, done.output
    with pytest.raises(InputError, match="allow_modules"):
        allow_modules(name)


def test_the_permission_reaches_other_processes(mark, tmp_path, monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", "")
    path = write(tmp_path / "s.toml", TABLES["policy"])
    travels = pickle.dumps(Scenario.load(path, allow_modules=(MODULE,)))
    source = "import pickle, sys; print(pickle.load(sys.stdin.buffer).policy.kind)"
    environment = {k: v for k, v in os.environ.items() if k != "LUNARSIM_ALLOW_MODULES"}
    done = subprocess.run(
        [sys.executable, "-c", source], input=travels, capture_output=True, env=environment,
        check=True,
    )  # fmt: skip
    assert done.stdout.decode().strip() == f"{MODULE}:Mine"


def test_reading_results_imports_nothing(mark, tmp_path):
    folder = tmp_path / "c"
    run(surrogate_plan(), InlineEngine(), folder)
    write(folder / "scenario.toml", TABLES["policy"] | TABLES["terrain"])
    (folder / "spec.toml").write_text(tomli_w.dumps({"scenario": TINY_FLIGHT | TABLES["policy"]}))
    for command in ("status", "report", "sensitivity", "rare"):
        done = call("campaign", command, folder)
        assert done.exit_code in (0, 2) and "Traceback" not in done.output, done.output
        assert "allow-module" not in done.stderr, (command, done.stderr)
    assert call("campaign", "export", folder, "--out", tmp_path / "r.csv").exit_code == 0
    assert call("campaign", "diff", folder, folder).exit_code == 0
    done = call("replay", folder, "--flight", "0-0")
    assert done.exit_code == 2 and "--allow-module" in done.stderr, done.output
    assert not mark.exists()


def test_a_record_is_drawn_without_its_policy(mark, tmp_path):
    flight = Simulation(Scenario.from_dict(TINY_FLIGHT), 1, "no-divert").flight()
    strange = tomli_w.dumps(TINY_FLIGHT | TABLES["policy"])
    record = replace(flight, scenario=strange)
    assert flight_title(record).startswith("tiny")
    assert rebuild_world(record).gravity == 1.622
    assert not mark.exists()
