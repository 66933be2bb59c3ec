"""Sensor faults that a campaign disperses, and faults in an environment."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim import Scenario
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.errors import InputError
from lunarsim_envs.descent.env import GuidanceEnv
from lunarsim_envs.retarget import RetargetEnv
from tests.worlds import TINY_FLIGHT

FAULTY = TINY_FLIGHT | {"sensor_faults": {"high": {"kind": "bias", "sensor": "fix", "size": 0.0}}}
SPEC = {
    "name": "faulty", "flights": 3, "seed": 5, "scenario": FAULTY,
    "factors": {"policy": ["no-divert"]},
    "dispersions": {
        "sensor_faults.high.size": {"kind": "uniform", "low": -4.0, "high": 4.0},
        "sensor_faults.high.start_s": {"kind": "uniform", "low": 1.0, "high": 5.0},
        "sensor_faults.high.occurs": {"kind": "choice", "values": [True, False]},
    },
}  # fmt: skip
KEYS = ("sensor_faults.high.size", "sensor_faults.high.start_s")


def flown(folder, engine):
    """Return the results of the campaign by column."""
    run(build_plan(CampaignSpec.from_dict(SPEC)), engine, folder)
    return load_results(folder).table.to_pydict()


@pytest.mark.parametrize(
    "engine",
    [InlineEngine(), pytest.param(LocalEngine(2), marks=pytest.mark.slow)],
    ids=["inline", "local"],
)
def test_a_campaign_disperses_faults_with_the_same_bits_again(tmp_path, engine):
    one, other = flown(tmp_path / "a", InlineEngine()), flown(tmp_path / "b", engine)
    for key in KEYS:
        drawn = next(values for name, values in one.items() if name.endswith(key))
        assert len(set(drawn)) == 3
    occurs = next(v for name, v in one.items() if name.endswith("sensor_faults.high.occurs"))
    assert set(occurs) == {True, False}
    assert one["propellant_kg"] == other["propellant_kg"]
    assert len(set(one["propellant_kg"])) == 3


def test_sites_are_chosen_in_the_full_simulation_with_faults_and_elsewhere_they_are_refused():
    scenario = Scenario.from_dict(FAULTY).changed(
        sensor_faults={"high": {"size": 3.0, "start_s": 2.0}}
    )
    env = RetargetEnv(scenario, perception="onboard")
    env.reset(seed=1)
    over = False
    while not over:
        *_, over, _, info = env.step(0)
    events = env.simulation.flight().events
    assert [e["time"] for e in events if e["name"] == "fault-started"] == pytest.approx([2.0])
    assert np.isfinite(info["score"])
    for make in (
        lambda: RetargetEnv(scenario, perception="truth"),
        lambda: GuidanceEnv(scenario=scenario),
    ):
        with pytest.raises(InputError, match="sensor_faults"):
            make()
