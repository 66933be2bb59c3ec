"""Flights of one index that differ in policy alone, flown on one path until their decisions differ.

Up to there worlds, scans, navigation and maps are the same, and they are most of what a flight
costs. Whoever flies asks the other policies too where a decision is due. As long as they decide the
same there is one flight; where they do not, the simulation is kept as it stands, and each of the
others goes on from there when its turn comes. Only policies of this package are asked: they hold no
state, take no time and do not raise; whatever else cannot be shared is flown apart, as if alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lunarsim.campaign.factors import Arm
from lunarsim.onboard.policies.contract import Decision
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.checkpoint import Checkpoint, NoCheckpointError
from lunarsim.simulation.loop import make_policy


@dataclass(frozen=True)
class Branch:
    """Where flights have got to that are on one path.

    Attributes
    ----------
    at
        Where they parted from those that were flown before, or the end of them all.
    decisions
        What each is about to do there, by arm; empty at the end.
    """

    at: Checkpoint | Simulation
    decisions: Mapping[int, Decision] = field(default_factory=dict)


def path_classes(arms: Sequence[Arm]) -> tuple[int, ...]:
    """Return a number for each arm, the same for those that differ in policy alone.

    An arm that may share its path with no other has one of its own.
    """
    seen: dict[str, int] = {}
    found = []
    for number, arm in enumerate(arms):
        tables = _but_policy(arm)
        found.append(number if tables is None else seen.setdefault(tables, number))
    return tuple(found)


def _but_policy(arm: Arm) -> str | None:
    """Return all of an arm's scenario but its policy; None where the policy is not this package's.

    What is drawn is the same for all arms of a group.
    """
    if arm.policy is not None or not _made_here(arm.scenario):
        return None
    tables = arm.scenario.to_dict()
    tables.pop("policy", None)
    return repr(tables)


def _made_here(scenario: Scenario) -> bool:
    return type(scenario.policy.make()).__module__.partition(".")[0] == "lunarsim"


def flown_on(
    arm: int,
    scenarios: Mapping[int, Scenario],
    begin: Callable[[], Simulation],
    branches: dict[int, Branch],
) -> Simulation:
    """Return the simulation of an arm at its end.

    Parameters
    ----------
    arm
        Which.
    scenarios
        Of it and of those that may share its path, by arm.
    begin
        Returns a simulation at its start.
    branches
        Where arms have got to by flights before; what this one finds out is added.
    """
    policies = {i: make_policy(s, s.policy.kind) for i, s in scenarios.items()}
    branch = branches.get(arm)
    if branch is None:
        simulation = begin()
        others = [i for i in policies if i != arm and i not in branches]
    elif isinstance(branch.at, Simulation):
        return _as_flown_by(branch.at, scenarios[arm], policies[arm])
    else:
        simulation = branch.at.resumed()
        others = [i for i in branch.decisions if i != arm]
        simulation.apply(branch.decisions[arm])
        simulation.move()
    _fly(simulation, arm, others, policies, branches)
    for other in others:
        branches[other] = Branch(simulation)
    return _as_flown_by(simulation, scenarios[arm], policies[arm])


def _fly(
    simulation: Simulation,
    arm: int,
    others: list[int],
    policies: Mapping[int, Any],
    branches: dict[int, Branch],
) -> None:
    """Fly an arm to its end; `others` loses those whose path parts from its own."""
    while not simulation.done:
        if simulation.decision_due:
            seen = simulation.observe()
            said = {i: simulation.ask(policies[i], seen) for i in (arm, *others)}
            parting = [i for i in others if _apart(said[i], said[arm])]
            for i in parting:
                others.remove(i)
            _keep(simulation, {i: said[i] for i in parting}, branches)
            simulation.apply(said[arm])
        simulation.move()


def _keep(
    simulation: Simulation, decisions: dict[int, Decision], branches: dict[int, Branch]
) -> None:
    """Note where arms part, those that decide alike on one branch."""
    if not decisions:
        return
    try:
        at = Checkpoint(simulation)
    except NoCheckpointError:
        return  # they are flown from the start
    while decisions:
        first = next(iter(decisions.values()))
        # Who climbs away does so alone: what is recorded of it is not compared.
        alike = {
            i: said for i, said in decisions.items() if said is first or not _apart(said, first)
        }
        branch = Branch(at, alike)
        for i in alike:
            branches[i] = branch
            del decisions[i]


def _apart(one: Decision, other: Decision) -> bool:
    """Tell whether two decisions, or what the record says of them, differ."""
    if one.site is None and other.site is None and not (one.abort or other.abort):
        return False  # why a site is kept is not recorded
    if one.site is None or other.site is None or one.abort or other.abort:
        return True
    same = one.site.tobytes() == other.site.tobytes() and one.reason == other.reason
    return not (same and repr(one.details) == repr(other.details))


def _as_flown_by(simulation: Simulation, scenario: Scenario, policy: Any) -> Simulation:
    """Return a simulation whose record names a scenario and a policy."""
    simulation.scenario, simulation.policy = scenario, policy
    return simulation
