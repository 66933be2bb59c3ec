"""Simulate arms that differ only in policy together until their decisions differ.

An arm is a variant of the scenario in a campaign.

Up to that point worlds, scans, navigation and maps are the same; they are most of the cost of a
flight. At each decision the flown arm also queries the other policies. While their decisions agree,
one flight serves all. When they differ, the simulation is checkpointed, and the other arms resume
from there. Only policies of this package are queried: they have no state, no run time and raise
no errors. All other arms are flown separately.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lunarsim.campaign.factors import Arm
from lunarsim.onboard.policies.contract import Decision
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.checkpoint import Checkpoint, CheckpointError
from lunarsim.simulation.loop import make_policy


@dataclass(frozen=True)
class Branch:
    """Moment of a flight up to which several arms share the flight path.

    An arm is a variant of the scenario.

    Attributes
    ----------
    state
        Checkpoint where the arms diverged from the flown arm, or the finished simulation.
    decisions
        Decision of each arm at the checkpoint, by index of the arm; empty for a finished
        simulation.
    """

    state: Checkpoint | Simulation
    decisions: Mapping[int, Decision] = field(default_factory=dict)


def shared_path_classes(arms: Sequence[Arm]) -> tuple[int, ...]:
    """Return a class number for each arm, equal for arms that can share a path.

    An arm is a variant of the scenario. Arms can share a flight path if they differ only in policy,
    and the policy is one of lunarsim. Each other arm has a separate class.
    """
    seen: dict[str, int] = {}
    found = []
    for number, arm in enumerate(arms):
        tables = _scenario_without_policy(arm)
        found.append(number if tables is None else seen.setdefault(tables, number))
    return tuple(found)


def _scenario_without_policy(arm: Arm) -> str | None:
    """Return an arm's scenario without its policy as text, to compare arms.

    An arm is a variant of the scenario. Return None if the policy is not one of lunarsim. Random
    values need no comparison, because they are the same for all arms of a flight.
    """
    if arm.policy is not None or not _has_packaged_policy(arm.scenario):
        return None
    tables = arm.scenario.to_dict()
    tables.pop("policy", None)
    return repr(tables)


def _has_packaged_policy(scenario: Scenario) -> bool:
    return type(scenario.policy.make()).__module__.partition(".")[0] == "lunarsim"


def fly_on_shared_path(
    arm: int,
    scenarios: Mapping[int, Scenario],
    create_simulation: Callable[[], Simulation],
    branches: dict[int, Branch],
) -> Simulation:
    """Fly one arm to the end, from where its path leaves that of earlier arms.

    An arm is a variant of the scenario. Arms that differ only in policy share a path until their
    decisions differ. If `branches` has a branch of the arm, its flight resumes there, or the branch
    is the finished flight; otherwise it is flown from the start. Return the finished simulation.

    Parameters
    ----------
    arm
        Index of the arm.
    scenarios
        Scenarios of this arm and of those that may share its path, by arm.
    create_simulation
        Function that creates a simulation at its start.
    branches
        Branch of each arm, by index, found while other arms were flown; new ones are added.
    """
    policies = {i: make_policy(s, s.policy.kind) for i, s in scenarios.items()}
    branch = branches.get(arm)
    if branch is None:
        simulation = create_simulation()
        others = [i for i in policies if i != arm and i not in branches]
    elif isinstance(branch.state, Simulation):
        return _relabel(branch.state, scenarios[arm], policies[arm])
    else:
        simulation = branch.state.resumed()
        others = [i for i in branch.decisions if i != arm]
        simulation.apply(branch.decisions[arm])
        simulation.move()
    _fly(simulation, arm, others, policies, branches)
    for other in others:
        branches[other] = Branch(simulation)
    return _relabel(simulation, scenarios[arm], policies[arm])


def _fly(
    simulation: Simulation,
    arm: int,
    others: list[int],
    policies: Mapping[int, Any],
    branches: dict[int, Branch],
) -> None:
    """Fly an arm to its end; store a branch for each arm whose decision differs.

    An arm is a variant of the scenario; a branch is the point of the flight from which another arm
    resumes. `others` are the arms that still share the path: those that get a branch are removed
    from it. `policies` has the policy of each arm, by index.
    """
    while not simulation.done:
        if simulation.decision_due:
            observation = simulation.observe()
            decisions_by_arm = {i: simulation.ask(policies[i], observation) for i in (arm, *others)}
            parting = [
                i for i in others if _decisions_differ(decisions_by_arm[i], decisions_by_arm[arm])
            ]
            for i in parting:
                others.remove(i)
            _store_branches(simulation, {i: decisions_by_arm[i] for i in parting}, branches)
            simulation.apply(decisions_by_arm[arm])
        simulation.move()


def _store_branches(
    simulation: Simulation, decisions: dict[int, Decision], branches: dict[int, Branch]
) -> None:
    """Store a branch for arms whose decision differs from that of the flown arm.

    An arm is a variant of the scenario; a branch is the point of the flight from which it resumes.
    Arms with equal decisions share a branch. `decisions` has the decisions by index of the arm, and
    is emptied; `branches` receives the branch of each arm. If the simulation cannot be copied,
    nothing is stored, and these arms are flown from the start.
    """
    if not decisions:
        return
    try:
        checkpoint = Checkpoint(simulation)
    except CheckpointError:
        return  # these arms are flown from the start
    while decisions:
        first = next(iter(decisions.values()))
        # An abort never compares equal: its recorded details are not compared.
        same = {
            i: decision
            for i, decision in decisions.items()
            if decision is first or not _decisions_differ(decision, first)
        }
        branch = Branch(checkpoint, same)
        for i in same:
            branches[i] = branch
            del decisions[i]


def _decisions_differ(first: Decision, second: Decision) -> bool:
    """Return whether two policy decisions differ in what is flown or recorded."""
    if first.site is None and second.site is None and not (first.abort or second.abort):
        return False  # reasons to keep a site are not recorded
    if first.site is None or second.site is None or first.abort or second.abort:
        return True
    same = first.site.tobytes() == second.site.tobytes() and first.reason == second.reason
    return not (same and repr(first.details) == repr(second.details))


def _relabel(simulation: Simulation, scenario: Scenario, policy: Any) -> Simulation:
    """Set the scenario and policy that a simulation records; return the simulation."""
    simulation.scenario, simulation.policy = scenario, policy
    return simulation
