"""One flight of a campaign, flown by whoever works for it; grounds and truth are made once.

`fly` is the function that campaigns name in their `Work`; others serve tests of the machinery.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.campaign.factors import Arm, folder_name, groups_of
from lunarsim.campaign.keys import GROUND_TABLES, TRUTH_TABLES, tables_of
from lunarsim.campaign.plan import Group, Plan, Work, kind_of
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.evaluation.outcome import COLUMNS, evaluate
from lunarsim.rng import Streams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import path_of, with_values
from lunarsim.simulation import Flight, Simulation, build_world
from lunarsim.world import World
from lunarsim.world.terrain import Terrain
from lunarsim.world.truth import Truth

# Of the ground where targets are drawn: share that is exactly safe, at any and at one heading.
SHARES = ("safe_share", "safe_share_at_heading")


@dataclass(frozen=True)
class Study:
    """What workers know of a campaign.

    Attributes
    ----------
    seed
        Root seed.
    arms
        What is compared.
    out
        Folder for records and figures, or None.
    records
        Which flights' whole records are kept: none, failures or all.
    figures
        Whether the first flight of each arm is drawn, and every one that was not safe.
    """

    seed: int
    arms: Sequence[Arm]
    out: Path | None = None
    records: str = "none"
    figures: bool = False


def plan_of(spec: CampaignSpec, out: Path | None = None) -> Plan:
    """Return the plan of a spec; records and figures go to `out`."""
    arms = [(arm.name, _named(arm.values)) for arm in spec.arms]
    laws = spec.dispersions.distributions

    def draws(flight: int) -> dict[str, Any]:
        return spec.dispersions.draws(flight)

    first = _named(draws(0)) if laws else {}
    keys = dict.fromkeys(key for _, values in arms for key in values)
    inputs = {key: kind_of([v[key] for _, v in arms if key in v]) for key in keys}
    for key, law in zip(first, laws.values(), strict=True):
        inputs[key] = kind_of(law.values) if hasattr(law, "values") else "float"
    study = Study(spec.head.seed, spec.arms, out, spec.head.records, spec.head.figures)
    return Plan(
        name=spec.head.name,
        seed=spec.head.seed,
        flights=spec.head.flights,
        arms=arms,
        groups=groups_of(spec.arms),
        draws=lambda flight: _named(draws(flight)),
        columns=COLUMNS | dict.fromkeys(SHARES, "float"),
        inputs=inputs,
        work=Work("lunarsim.campaign.flying:fly", study),
        identity=spec.identity,
    )


def check_flyable(spec: CampaignSpec) -> None:
    """Build the first flight of every arm, as far as it can be without flying.

    Raises
    ------
    InputError
        If one cannot be flown.
    """
    seed = flight_seed(spec.head.seed, 0)
    grounds: dict[str, Terrain] = {}
    for i, arm in enumerate(spec.arms):
        scenario = spec.scenario_of(0, i)
        key = tables_of(scenario, GROUND_TABLES)
        world = build_world(scenario, Streams(seed), grounds.get(key))
        grounds = {key: world.terrain}
        Simulation(scenario, seed, arm.policy or scenario.policy.kind, world=world)


def _named(values: Any) -> dict[str, Any]:
    """Return values by whole key: ``policy`` as ``policy.kind``, which is a column of its own."""
    return {".".join(path_of(key, value)): value for key, value in values.items()}


def fly(study: Study, group: Group, arm: int, memory: dict[Any, Any]) -> dict[str, Any]:
    """Fly one index under one arm; return its metrics.

    Parameters
    ----------
    study
        What is flown.
    group, arm
        Which flight.
    memory
        Grounds and truth of the group so far.
    """
    flight, simulation, row = fly_whole(study, group, arm, memory)
    name = study.arms[arm].name
    _keep(study, group.flight, name, flight, row["safe"])
    if study.out is not None and study.figures and (group.flight == 0 or not row["safe"]):
        from lunarsim.viz import draw_flight  # noqa: PLC0415  (matplotlib is slow to load)

        folder = study.out / "figures" / folder_name(name)
        if group.flight:
            folder /= f"failed-{group.flight}"
        draw_flight(flight, simulation.world, simulation.truth, folder)
    return row


def fly_whole(
    study: Study, group: Group, arm: int, memory: dict[Any, Any]
) -> tuple[Flight, Simulation, dict[str, Any]]:
    """Fly as `fly` does; return the record, what flew it, and the metrics. Nothing is written."""
    chosen = study.arms[arm]
    scenario = with_values(chosen.scenario, group.draws, "dispersions")
    seed = flight_seed(study.seed, group.flight)
    world, truth = _ground(scenario, seed, memory)
    policy = chosen.policy or scenario.policy.kind
    simulation = Simulation(scenario, seed, policy, world=world, truth=truth)
    flight = simulation.run()
    return flight, simulation, evaluate(flight, truth) | _shares(scenario, truth, memory)


def _ground(
    scenario: Scenario, seed: np.random.SeedSequence, memory: dict[Any, Any]
) -> tuple[World, Truth]:
    """Return world and truth; what another arm of the group has made already is taken again."""
    ground = ("ground", tables_of(scenario, GROUND_TABLES))
    world = build_world(scenario, Streams(seed), memory.get(ground))
    memory.setdefault(ground, world.terrain)
    known = ("truth", tables_of(scenario, TRUTH_TABLES))
    if known not in memory:
        memory[known] = Truth.of(world, scenario.vehicle.make())
    return world, memory[known]


def _shares(scenario: Scenario, truth: Truth, memory: dict[Any, Any]) -> dict[str, float]:
    """Return the share of safe ground where targets are drawn, at any and at the heading flown."""
    tables = tables_of(scenario, (*TRUTH_TABLES, "target")), scenario.start.heading_deg
    if tables not in memory:
        # Scatter half sides of zero still mean a spot: look at a footprint's width around it.
        half = np.maximum(scenario.target.scatter_m, 2.0)
        centre = scenario.target.position_m
        heading = float(np.deg2rad(scenario.start.heading_deg))
        values = truth.safe_share(centre, half), truth.safe_share(centre, half, heading)
        memory[tables] = dict(zip(SHARES, values, strict=True))
    return memory[tables]  # type: ignore[no-any-return]


def _keep(study: Study, index: int, arm: str, flight: Flight, safe: bool) -> None:
    """Write the whole record of a flight, where it is to be kept, so that it is there whole."""
    if study.out is None or study.records == "none" or (study.records == "failures" and safe):
        return
    folder = study.out / "flights" / folder_name(arm)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".part-", dir=folder) as temporary:
        flight.save(Path(temporary) / "flight")
        target = folder / f"{index:05d}"
        if target.exists():
            shutil.rmtree(target)  # of the same flight, whose row was not written any more
        (Path(temporary) / "flight").rename(target)
