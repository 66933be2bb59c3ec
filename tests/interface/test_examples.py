"""The examples in C, C++ and Python land, and each flies as its twin in the other language."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import lunarsim
from lunarsim.cli import main
from lunarsim.interface import allow_programs
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from tests.interface.software import EXAMPLES, assert_same_flight, library, small

PYTHON = {name: EXAMPLES / f"{name}.py" for name in ("e_guidance", "nearest_safe")}


@pytest.fixture(autouse=True)
def allowed(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_PROGRAMS", "")


def in_library(name: str, **more: Any) -> dict[str, Any]:
    path = library(name)
    allow_programs(path)
    return {"kind": "library", "path": str(path), **more}


def in_process(name: str, **more: Any) -> dict[str, Any]:
    allow_programs(PYTHON[name])
    return {"kind": "process", "path": str(PYTHON[name]), **more}


def golombek(**changes: Any) -> Flight:
    return lunarsim.fly(lunarsim.load_scenario("golombek").changed(**changes), seed=1)


@cache
def c_guidance() -> Flight:
    return golombek(guidance=in_library("e_guidance.c", isolated=False))


def test_guidance_law_in_c_lands_golombek_as_its_twin_in_python():
    flight = c_guidance()
    assert flight.outcome.safe, flight.outcome.failure_causes
    assert_same_flight(flight, golombek(guidance=in_process("e_guidance")))


def test_isolated_library_flies_as_a_library_in_this_process_and_repeats():
    scenario = small(guidance=in_library("e_guidance.c", isolated=False))
    first = Simulation(scenario, 4, "safest").run()
    assert_same_flight(first, Simulation(scenario, 4, "safest").run())
    isolated = small(guidance=in_library("e_guidance.c"))
    assert_same_flight(first, Simulation(isolated, 4, "safest").run())


def test_tcp_gives_the_same_flight_as_a_unix_socket():
    flights = [
        Simulation(small(guidance=in_process("e_guidance", transport=kind)), 4, "safest").run()
        for kind in ("unix", "tcp")
    ]
    assert_same_flight(*flights)


def test_policy_in_cpp_lands_golombek_as_its_twin_in_python():
    chosen = {"configuration": "0.9"}
    flight = golombek(policy=in_library("nearest_safe.cpp", isolated=False, **chosen))
    assert flight.outcome.safe, flight.outcome.failure_causes
    assert {d["reason"] for d in flight.decisions} == {"nearest safe cell"}
    assert_same_flight(flight, golombek(policy=in_process("nearest_safe", **chosen)))


def test_computer_in_c_lands():
    scenario = Scenario.load(EXAMPLES / "golombek_fixes.toml")
    flown = scenario.changed(computer=in_library("computer.c"))
    flight = Simulation(flown, 1, "safest").run()
    assert flight.outcome.safe, flight.outcome.failure_causes
    assert flight.policy == "external"
    again = scenario.changed(computer=in_library("computer.c", isolated=False))
    assert_same_flight(flight, Simulation(again, 1, "safest").run())


def test_control_in_c_flies_as_the_control_of_lunarsim():
    flight = Simulation(small(), 4, "safest").run()
    control = in_library("roles.c", isolated=False)
    external = Simulation(small(control={**control, "response_time_s": 0.45}), 4, "safest").run()
    # The compiled loop of lunarsim may round differently.
    for name in flight.trajectory:
        assert np.allclose(
            flight.trajectory[name], external.trajectory[name], atol=1e-6, equal_nan=True
        ), name


@pytest.mark.parametrize("isolated", [False, True])
def test_mapper_in_c_writes_the_map_of_the_scan(isolated):
    mapper = in_library("roles.c", isolated=isolated, size_m=50.0, posting_m=0.5)
    simulation = Simulation(small(mappers={"dem": None, "points": mapper}), 4, "no-divert")
    while not simulation.computer.updated_mappers:
        simulation.step()
    hazards = simulation.computer.mappers["points"].hazard_map()
    assert 0.2 < hazards.observed.mean() <= 1.0
    assert np.array_equal(hazards.p_safe, np.where(hazards.observed, np.float32(0.75), 0.0))
    grid, (rows, cols) = hazards.grid, np.nonzero(hazards.observed)
    xy = np.column_stack(
        (grid.x0 + cols * grid.posting, grid.y0 + rows * grid.posting)
    )  # fmt: skip
    true = simulation.world.terrain.elevation(xy - simulation.navigation_error[:2])
    error = hazards.elevation[rows, cols] - true - simulation.navigation_error[2]
    # A cell holds the height of one point in it, not that of its centre.
    assert np.median(np.abs(error)) < 0.1


def test_examples_build_with_cmake(tmp_path):
    if shutil.which("cmake") is None or shutil.which("g++") is None:
        pytest.skip("needs cmake and g++")
    build = tmp_path / "build"
    subprocess.run(
        ["cmake", "-S", EXAMPLES, "-B", build], check=True, capture_output=True, text=True
    )
    made = subprocess.run(["cmake", "--build", build], check=False, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert "warning" not in made.stderr
    assert {path.name for path in build.glob("*.so")} == {
        "e_guidance.so", "computer.so", "nearest_safe.so",
    }  # fmt: skip


def test_recorded_calls_are_repeated_byte_for_byte_without_a_simulation(tmp_path):
    path = library("e_guidance.c")
    allow_programs(path)
    messages = tmp_path / "messages"
    scenario = small(guidance=in_library("e_guidance.c", isolated=False))
    Simulation(scenario, 4, "safest", messages=messages).run()
    record = messages / "guidance.messages"

    def replayed(*arguments: object) -> tuple[int, str]:
        found = CliRunner().invoke(main, ["interface", "replay", *map(str, arguments)])
        return found.exit_code, found.output

    for software in (path, PYTHON["e_guidance"]):
        code, text = replayed(record, software)
        assert code == 0, text
        assert "all answers are identical" in text
    code, text = replayed(record, library("faulty_software.c"))
    assert code == 1
    assert "call 0: the answer differs in acceleration" in text
    code, text = replayed(record, library("roles.c"))
    assert code == 2
    assert text.startswith("error: SOFTWARE: must define the function lunarsim_guidance_init")
    cut = tmp_path / "cut.messages"
    cut.write_bytes(record.read_bytes()[:-3])
    assert replayed(cut, path)[0] == 2
    assert replayed(tmp_path / "none", path)[0] == 2
    cut.write_bytes(b"\xff" * 100)
    assert replayed(cut, path)[0] == 2


def test_record_without_an_answer_is_refused(tmp_path):
    fails_at_once = in_library("faulty_software.c", configuration="crash at once")
    messages = tmp_path / "messages"
    Simulation(small(guidance=fails_at_once), 4, "no-divert", messages=messages).run()
    found = CliRunner().invoke(main, [
        "interface", "replay", str(messages / "guidance.messages"), str(library("e_guidance.c")),
    ])  # fmt: skip
    assert found.exit_code == 2
    assert "must have at least one answer" in found.output


def test_mapper_and_policy_calls_are_repeated_with_their_arrays(tmp_path):
    mapper = in_library("roles.c", isolated=False, size_m=50.0, posting_m=0.5)
    policy = in_library("nearest_safe.cpp", isolated=False, configuration="0.7")
    scenario = small(mappers={"dem": None, "points": mapper}, policy=policy)
    Simulation(scenario, 4, "library", messages=tmp_path / "m").run()
    for role, software in (("mapper", "roles.c"), ("policy", "nearest_safe.cpp")):
        record = tmp_path / "m" / f"{role}.messages"
        found = CliRunner().invoke(
            main, ["interface", "replay", str(record), str(library(software))]
        )
        assert found.exit_code == 0, found.output
