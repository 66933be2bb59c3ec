"""The shadow paper's direct descent under the law, which tests of law and planner share."""

from dataclasses import replace

import pytest

from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import SCENARIOS

QUICK = {"kind": "information-seeking", "candidates": 600, "nodes_per_side": 4}


@pytest.fixture(scope="package")
def paper():
    """Its computer as the flight begins; nobody steps it."""
    scenario = Scenario.load(SCENARIOS / "shadow_nominal.toml").changed(
        guidance=QUICK, mappers={"rocks": {"size_m": 60.0}},
        terrain={"size_m": 80.0}, rocks={"min_diameter_m": 0.6},
    )  # fmt: skip
    return Simulation(scenario, 3).computer


def at_start(computer, **settings):
    """Return a law of its own as the flight begins, and what it is asked with."""
    law = computer.briefing.software.guidance
    guidance = replace(law, **settings).build(computer.briefing, 0.3)
    guidance.hazard_map_source = computer.guidance.hazard_map_source
    return guidance, (computer.estimate, computer.approach.end(computer.site, computer.lander))
