"""A scenario file runs a program only if the user allows exactly this file."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from click.testing import CliRunner

import lunarsim
from lunarsim import InputError
from lunarsim.campaign.engines.local import LocalEngine
from lunarsim.campaign.fly_spec import fly_spec
from lunarsim.campaign.results import load_results
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.interface import allow_programs
from lunarsim.scenario import Scenario
from tests.interface.software import EXAMPLES, library, small

PROGRAM = EXAMPLES / "e_guidance.py"
TABLES = {
    "guidance": {}, "terminal_descent": {}, "policy": {}, "control": {}, "computer": {},
    "mappers": {"sensor": "flash"},
}  # fmt: skip


@pytest.fixture(autouse=True)
def allowed(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_PROGRAMS", "")


def scenario(table: str, kind: str, path: Path | str) -> Scenario:
    part = {"kind": kind, "path": str(path), **TABLES[table]}
    return small(**{table: {"dem": part} if table == "mappers" else part})


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("kind", ["library", "process"])
def test_program_must_be_allowed_in_every_table(table, kind):
    with pytest.raises(InputError, match="must name an allowed program") as caught:
        scenario(table, kind, PROGRAM)
    name = "mappers.dem" if table == "mappers" else table
    assert caught.value.field == f"{name}.path"
    assert "--allow-program" in caught.value.remedy
    allow_programs(PROGRAM)
    assert scenario(table, kind, PROGRAM) is not None


def test_only_the_allowed_file_may_run(tmp_path):
    allow_programs(PROGRAM)
    other = tmp_path / PROGRAM.name
    other.write_text(PROGRAM.read_text())
    with pytest.raises(InputError, match="allowed"):
        scenario("guidance", "process", other)
    link = tmp_path / "link.py"
    link.symlink_to(other)
    with pytest.raises(InputError, match="allowed"):
        scenario("guidance", "process", link)
    with pytest.raises(InputError, match="allowed"):
        scenario("guidance", "process", EXAMPLES)
    allow_programs(tmp_path / "none.py")
    with pytest.raises(InputError, match="must be an existing file"):
        scenario("guidance", "process", tmp_path / "none.py")


def test_file_that_changes_its_target_after_the_check_is_refused(tmp_path):
    allow_programs(PROGRAM)
    link = tmp_path / "link.py"
    link.symlink_to(PROGRAM)
    made = scenario("guidance", "process", link)
    evil = tmp_path / "evil.py"
    evil.write_text("raise SystemExit(9)")
    link.unlink()
    link.symlink_to(evil)
    flight = lunarsim.fly(made, policy="no-divert", seed=1)
    assert "software-failed" not in flight.outcome.failure_causes


def test_permission_is_pickled_with_a_scenario(monkeypatch):
    allow_programs(PROGRAM)
    data = pickle.dumps(scenario("guidance", "process", PROGRAM))
    monkeypatch.setenv("LUNARSIM_ALLOW_PROGRAMS", "")
    assert pickle.loads(data).guidance.kind == "process"


def test_paths_in_a_scenario_file_start_from_its_folder(tmp_path, monkeypatch):
    (tmp_path / "law.py").write_text(PROGRAM.read_text())
    file = tmp_path / "own.toml"
    file.write_text('[guidance]\nkind = "process"\npath = "law.py"\n')
    monkeypatch.chdir("/")
    allow_programs(tmp_path / "law.py")
    assert Scenario.load(file).guidance.path == tmp_path / "law.py"


@pytest.mark.parametrize(
    ("given", "field", "problem"),
    [
        ({"kind": "library"}, "guidance.path", "is required"),
        ({"kind": "process"}, "guidance.path", "is required"),
        ({"kind": "library", "path": "/x", "deadline_s": 0.0}, "guidance.deadline_s", "0"),
        ({"kind": "process", "path": "/x", "transport": "udp"}, "guidance.transport", "unix"),
        ({"kind": "process", "path": "/x", "arguments": [3]}, "guidance.arguments", ""),
        ({"kind": "library", "path": "/x", "configuration": "a" * 1024}, "guidance.configuration",
         "at most 1023 bytes"),
    ],
)  # fmt: skip
def test_bad_settings_are_errors_with_their_field(given, field, problem):
    with pytest.raises(InputError) as caught:
        small(guidance=given)
    assert caught.value.field.startswith(field)
    assert problem in str(caught.value)


def test_command_line_needs_the_option(tmp_path):
    file = tmp_path / "own.toml"
    small().changed(simulation={"max_time_s": 1.0}).save(file)
    arguments = ["fly", str(file), "--set", "guidance.kind=process", "--set",
                 f"guidance.path={PROGRAM}"]  # fmt: skip
    refused = CliRunner().invoke(main, arguments)
    assert refused.exit_code == 2
    assert "--allow-program" in refused.output
    assert len(refused.output.splitlines()) == 1
    flown = CliRunner().invoke(main, [*arguments, "--allow-program", str(PROGRAM), "--pace", "50"])
    assert flown.exit_code == 0, flown.output
    assert "pace 50: " in flown.output
    # The permission ends with the command.
    assert CliRunner().invoke(main, arguments).exit_code == 2


def test_campaign_with_a_crashing_library_goes_on_in_all_workers(tmp_path):
    path = library("faulty_software.c")
    allow_programs(path)
    faults = ("crash", "nan", "none", "hang")
    guidance = {"kind": "library", "path": str(path), "deadline_s": 1.0}
    flown = small(guidance=guidance, simulation={"max_time_s": 8.0}).to_dict()
    spec = CampaignSpec.from_dict({
        "name": "faults", "flights": 1, "scenario": flown,
        "arms": [
            {"name": fault, "set": {"guidance.configuration": fault}} for fault in faults
        ],
    })  # fmt: skip
    result = fly_spec(spec, engine=LocalEngine(2), out=tmp_path / "c")
    assert result.complete
    rows = load_results(tmp_path / "c").table.to_pylist()
    causes = {row["arm"]: row["failure_causes"] for row in rows}
    assert {row["outcome"] for row in rows} == {"flown"}
    for fault in faults:
        assert causes[fault] == ("time-limit" if fault == "none" else "software-failed")
    # The library is part of the campaign's identity: another one needs another campaign.
    assert str(path) in spec.identity["made from"]
