"""A policy from outside: by name in a scenario, on the command line, as an object, in processes."""

from __future__ import annotations

import pandas as pd
from click.testing import CliRunner

from lunarsim.campaign import compare
from lunarsim.cli import main
from lunarsim.parts import resolve
from lunarsim.simulation import Simulation

OWN = "own_policy:FirstCome"


def test_in_a_scenario(small):
    scenario = small.changed(policy={"kind": OWN, "threshold": 0.5})
    assert scenario.policy.threshold == 0.5
    flight = Simulation(scenario, 3, OWN).run()
    assert flight.policy == "first-come"
    assert [d["reason"] for d in flight.decisions] == ["first come"]


def test_on_the_command_line(small, tmp_path):
    small.changed(rocks={"cover": 0.12}).save(tmp_path / "s.toml")
    arguments = ["fly", str(tmp_path / "s.toml"), "--policy", OWN, "--seed", "3"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.output
    assert "first come" in done.output


def test_objects_compete_in_any_number_of_processes(small, tmp_path):
    policies = [resolve("policy", OWN)(threshold=0.8), "no-divert"]
    for jobs in (1, 2):
        out = tmp_path / str(jobs)
        compare(small, policies, flights=2, seed=4, jobs=jobs, out=out, figures=False)
    table = pd.read_parquet(tmp_path / "1" / "results.parquet")
    assert list(table["policy"]) == ["first-come", "no-divert"] * 2
    first, second = ((tmp_path / j / "results.parquet").read_bytes() for j in "12")
    assert first == second


def test_it_flies_the_environment_as_an_agent(outside, tmp_path, monkeypatch):
    monkeypatch.delenv("LUNARSIM_ALLOW_MODULES")
    arguments = [
        "evaluate",
        "Retarget-v1",
        "--perception",
        "truth",
        "--episodes",
        "2",
        "--worlds",
        "1",
    ]
    arguments += ["--jobs", "1", "--agent", OWN, "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.output
    rows = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert set(rows["agent"]) == {"FirstCome"} and len(rows) == 2
