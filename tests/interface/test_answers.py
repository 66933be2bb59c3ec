"""Answers of external policies, control, guidance and mappers are checked and not kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lunarsim import Grid
from lunarsim.interface.definitions import GuidancePhase, PolicyAction
from lunarsim.interface.structs import Struct
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.external.control import ExternalControl
from lunarsim.onboard.external.encode import MeasurementWriter
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.guidance import ExternalGuidance
from lunarsim.onboard.external.mapper import ExternalMapper
from lunarsim.onboard.external.policy import ExternalPolicy
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.simulation import Simulation
from tests.interface.software import small

SCAN = LidarScan(1.0, np.ones(1), np.ones((1, 3)), np.eye(3), np.ones(1), (1, 1))


class Software:
    """Connection that gives the answers of functions, one per call."""

    def __init__(self, *answers: Callable[[Struct, Struct], None]) -> None:
        self._answers = list(answers)

    def step(self, given: Struct, answer: Struct) -> None:
        self._answers.pop(0)(given, answer)

    def close(self) -> None:
        pass


def write(**values: object) -> Callable[[Struct, Struct], None]:
    return lambda given, answer: answer.set(**values)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    made = Simulation(small(), 4)
    while not made.decision_due:
        made.move()
    return made


def test_policy_decides_or_fails(simulation):
    site = (1.0, 2.0, 3.0)
    seen = simulation.observe()
    policy = ExternalPolicy("library", Software(
        write(action=PolicyAction.DIVERT, site=site, reason=b"near"),
        write(action=PolicyAction.DIVERT),
        write(action=PolicyAction.ABORT),
        write(),
        write(action=3, site=site),
    ))  # fmt: skip
    decision = policy.decide(seen)
    assert tuple(decision.site) == site
    assert decision.reason == "near"
    with pytest.raises(SoftwareFailure, match="site is"):
        policy.decide(seen)  # the site of the first answer does not count
    assert policy.decide(seen).abort
    kept = policy.decide(seen)
    assert kept.site is None
    assert not kept.abort
    with pytest.raises(SoftwareFailure, match="action is 3"):
        policy.decide(seen)


def test_control_and_guidance_need_finite_answers(simulation):
    control = ExternalControl(Software(write(torque=(1.0, 2.0, 3.0)), write()), 0.5)
    given = np.zeros(3), np.zeros(3), np.ones(3)
    assert tuple(control.torque(*given)) == (1.0, 2.0, 3.0)
    with pytest.raises(SoftwareFailure, match="torque"):
        control.torque(*given)
    guidance = ExternalGuidance(
        Software(write(acceleration=(1.0, 2.0, 3.0)), write()), GuidancePhase.APPROACH
    )
    state = simulation.estimate, PhaseEnd(np.zeros(3), np.zeros(3), np.zeros(3)), 1.0, 2.0
    assert tuple(guidance.command(*state)) == (1.0, 2.0, 3.0)
    with pytest.raises(SoftwareFailure, match="acceleration"):
        guidance.command(*state)


def test_map_of_a_mapper_is_checked_and_changes_only_on_request(simulation):
    def draw(p_safe: float, changed: int) -> Callable[[Struct, Struct], None]:
        def step(given: Struct, answer: Struct) -> None:
            given.arrays["p_safe"][...] = p_safe
            given.arrays["observed"].flat[:3] = 1
            answer.set(changed=changed)

        return step

    mapper = ExternalMapper(
        Software(draw(0.5, 0), draw(0.75, 1), draw(1.5, 1), draw(np.nan, 1)),
        Grid.centred((0.0, 0.0), 10.0, 1.0), "flash", MeasurementWriter(("flash",)),
    )  # fmt: skip
    mapper.update(SCAN, simulation.estimate)
    assert mapper.is_empty
    assert not mapper.hazard_map().observed.any()
    mapper.update(SCAN, simulation.estimate)
    hazards = mapper.hazard_map()
    assert not mapper.is_empty
    assert hazards.observed.sum() == 3
    # Cells that are not observed have p_safe = 0.
    assert hazards.p_safe.sum() == pytest.approx(3 * 0.75)
    for _ in range(2):
        with pytest.raises(SoftwareFailure, match="p_safe is not between 0 and 1"):
            mapper.update(SCAN, simulation.estimate)
    # A map that is moved starts empty.
    mapper.recentre(np.array([500.0, 0.0, 0.0]))
    assert mapper.is_empty
    assert not mapper.hazard_map().observed.any()
    assert mapper.hazard_map().grid.x0 > 400.0
