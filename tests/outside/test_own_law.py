"""A guidance law from outside."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.simulation import Simulation

OWN = "own_law:LinearLaw"


def test_it_flies_to_the_site(small):
    scenario = small.changed(guidance={"kind": OWN}, approach={"time_to_go_s": 38.0})
    simulation = Simulation(scenario, 3, "no-divert")
    flight = simulation.run()
    touchdown = flight.outcome.touchdown
    aimed = simulation.site - simulation.navigation_error
    assert np.hypot(*(touchdown.position - aimed)[:2]) < 0.8
    assert touchdown.horizontal_speed < 0.5
    apollo = Simulation(small.changed(approach={"time_to_go_s": 38.0}), 3, "no-divert").run()
    assert flight.propellant_used != pytest.approx(apollo.propellant_used, rel=1e-3)


def test_its_settings_are_checked(small):
    with pytest.raises(ValueError, match=r"guidance\.min_time_to_go_s: .*got -1"):
        small.changed(guidance={"kind": OWN, "min_time_to_go_s": -1.0})


def test_it_flies_the_environment_as_an_agent(outside, tmp_path, monkeypatch):
    monkeypatch.delenv("LUNARSIM_ALLOW_MODULES")
    arguments = ["evaluate", "Guidance-v1", "--episodes", "2", "--jobs", "1"]
    arguments += ["--agent", "apollo", "--agent", OWN, "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.output
    rows = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert rows["safe"].all()
    custom, built_in = (group["propellant_kg"].to_numpy() for _, group in rows.groupby("agent"))
    # A law without a shape leaves the time for rotations that the Apollo law needs.
    ratio = custom / built_in
    assert (ratio > 0.85).all() and (ratio < 1.0).all()
