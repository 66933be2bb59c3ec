"""What a scenario's map promises is told before the flight."""

from __future__ import annotations

from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.onboard.navigation.map_features import lock_forecast
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import SCENARIOS


def test_a_forecast_follows_the_map():
    scenario = Scenario.load(SCENARIOS / "morpheus.toml")
    rich = lock_forecast(Simulation(scenario, 1).briefing)
    poor = lock_forecast(Simulation(scenario.changed(prior_map={"sigma_m": 0.6}), 1).briefing)
    assert rich.can_lock
    assert not poor.can_lock
    assert rich.expected > 2.0 * poor.expected
    # The start is known to 30 m: that many places there are, whatever the map.
    assert rich.needed == poor.needed
    unmapped = Scenario.load(SCENARIOS / "instruments.toml")
    assert lock_forecast(Simulation(unmapped, 1).briefing) is None


def test_fly_warns_of_a_map_that_cannot_lock(tmp_path):
    text = (SCENARIOS / "morpheus.toml").read_text(encoding="utf-8")
    text = text.replace("max_time_s = 120.0", "max_time_s = 0.3")
    for sigma, warned in ((0.1, False), (0.6, True)):
        path = tmp_path / f"{sigma}.toml"
        path.write_text(text.replace("[prior_map]", f"[prior_map]\nsigma_m = {sigma}"))
        result = CliRunner().invoke(main, ["fly", str(path)])
        assert ("warning: cannot lock" in result.output) == warned, result.output
