"""A landing that is given up: the lander climbs away, which is neither a landing nor a crash."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.flight_metrics import evaluate
from lunarsim.onboard.policies.contract import Decision
from lunarsim.onboard.policies.library import SafestOrAbort
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.flight import Flight
from tests.worlds import SMALL_FLIGHT


@dataclass
class GivesUp:
    """Climbs away when first asked below a height."""

    below: float
    name: str = "gives-up"

    def decide(self, observation):
        height = observation.estimate.position[2] - observation.site[2]
        if height < self.below:
            return Decision.climb_away("tried")
        return Decision.keep("not yet")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.from_dict(SMALL_FLIGHT)


def test_an_abort_climbs_away_and_is_counted_apart(scenario, tmp_path):
    simulation = Simulation(scenario, 3, GivesUp(120.0))
    flight = simulation.run()
    t = flight.trajectory
    assert flight.outcome.failure_causes == ("aborted",)
    assert flight.outcome.touchdown is None
    assert not flight.outcome.safe
    row = evaluate(flight, simulation.truth)
    assert row["aborted"]
    assert not row["safe"]
    low = int(np.argmin(t["position_z"]))
    assert t["phase"][low] == 2
    assert t["velocity_z"][-1] > 5.0
    # Nothing of it sinks again, and sideways speed is taken out.
    assert np.all(np.diff(t["position_z"][low:]) > 0.0)
    assert np.hypot(t["velocity_x"][-1], t["velocity_y"][-1]) < 10.0
    assert [e["name"] for e in flight.events].count("abort") == 1
    flight.save(tmp_path / "flight")
    assert Flight.load(tmp_path / "flight").outcome == flight.outcome


def test_an_abort_too_low_still_meets_the_terrain_or_clears_it(scenario):
    """From 12 m up at some metres a second the engine turns the descent round, or it is a crash."""
    verdict = Simulation(scenario, 3, GivesUp(18.0)).run().outcome
    assert verdict.failure_causes == ("aborted",) or verdict.touchdown is not None


def test_the_policy_aborts_for_want_of_a_safe_site(scenario):
    never = Simulation(scenario, 3, SafestOrAbort(p_safe_min=0.0)).run()
    always = Simulation(scenario, 3, SafestOrAbort(p_safe_min=1.0, abort_altitude=200.0)).run()
    assert never.outcome.failure_causes != ("aborted",)
    assert always.outcome.failure_causes == ("aborted",)
    # With nothing to be afraid of it decides as `safest`.
    safest = Simulation(scenario, 3, "safest").run()
    assert np.array_equal(never.sites, safest.sites)


def test_an_abort_names_no_site():
    with pytest.raises(InputError, match=r"decision\.site"):
        Decision(np.zeros(3), "both", abort=True)
