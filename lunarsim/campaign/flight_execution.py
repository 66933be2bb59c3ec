"""Fly one flight of a campaign, in a worker or again for comparison.

An arm is a variant of the scenario. A group is one flight index under several arms with the same
terrain; the terrain and its true landing safety are computed once per group.

Campaigns name `fly` in their `Work`; other functions serve tests of the engines.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.compute as pc

from lunarsim.campaign.cache import DiskCache
from lunarsim.campaign.dispersions import world_index
from lunarsim.campaign.distributions import Choice
from lunarsim.campaign.factors import (
    GROUND_TABLES,
    Arm,
    folder_name,
    group_arms_by_terrain,
    tables_as_text,
)
from lunarsim.campaign.outcomes import RecordNotWrittenError
from lunarsim.campaign.plan import WEIGHT, Group, Plan, Work, kind_of
from lunarsim.campaign.results import Results, load_results
from lunarsim.campaign.shared_paths import fly_on_shared_path, shared_path_classes
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.campaign.subset import CHAIN, LEVEL, WORLD, SubsetChains
from lunarsim.campaign.world_truth import SAFE_SHARE_COLUMNS, WorldTruthProvider
from lunarsim.errors import InputError
from lunarsim.evaluation.flight_metrics import COLUMNS, evaluate
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import path_of, with_values
from lunarsim.simulation import Flight, Simulation, build_world
from lunarsim.world.terrain import Terrain

# Columns that locate a flight in a subset simulation.
_SUBSET_COLUMNS = (LEVEL, CHAIN, WORLD)


@dataclass(frozen=True)
class FlightSettings:
    """Settings of a campaign that worker processes need to fly its flights.

    Attributes
    ----------
    seed
        Root seed.
    arms
        Arms that are compared.
    out
        Folder for records and figures, or None.
    records
        Flights whose complete records are kept: none, failures or all.
    figures
        Whether to plot the first flight of each arm and every flight that was not safe.
    cache
        Disk cache of the true landing safety of terrains, or None.
    block
        Flights in a block of a Saltelli design, which share two worlds; 0: one world per flight.
    paths
        Class of each arm for shared flight paths, from `shared_path_classes`; empty: no sharing.
    """

    seed: int
    arms: Sequence[Arm]
    out: Path | None = None
    records: str = "none"
    figures: bool = False
    cache: DiskCache | None = None
    block: int = 0
    paths: tuple[int, ...] = ()


def build_plan(spec: CampaignSpec, out: Path | None = None, cache: DiskCache | None = None) -> Plan:
    """Build the plan of all flights of a campaign from its specification.

    Records and plots go to the folder `out`, the true landing safety of terrains to `cache`.
    """
    arms = [(arm.name, _by_full_key(arm.values)) for arm in spec.arms]
    laws = spec.dispersions.distributions
    chains = None if spec.dispersions.subset is None else SubsetChains(spec.dispersions)
    is_weighted = spec.dispersions.importance is not None

    def draws(flight: int) -> dict[str, Any]:
        if chains is not None:
            return _by_full_key(chains.draws(flight))
        drawn = _by_full_key(spec.dispersions.draws(flight))
        return drawn | {WEIGHT: spec.dispersions.weight(flight)} if is_weighted else drawn

    keys = dict.fromkeys(key for _, values in arms for key in values)
    inputs = {key: kind_of([v[key] for _, v in arms if key in v]) for key in keys}
    inputs |= _draw_kinds(laws)
    if is_weighted:
        inputs[WEIGHT] = "float"
    if chains is not None:
        inputs = dict.fromkeys(_SUBSET_COLUMNS, "int") | inputs
    head, block = spec.head, spec.dispersions.block
    study = FlightSettings(head.seed, spec.arms, out, head.records, head.figures, cache, block,
                  shared_path_classes(spec.arms))  # fmt: skip
    return Plan(
        name=spec.head.name,
        seed=spec.head.seed,
        flights=spec.head.flights if chains is None else chains.max_flights,
        arms=arms,
        groups=group_arms_by_terrain(spec.arms),
        draws=draws,
        columns=COLUMNS | dict.fromkeys(SAFE_SHARE_COLUMNS, "float"),
        inputs=inputs,
        work=Work("lunarsim.campaign.flight_execution:fly", study),
        identity=spec.identity,
        chains=chains,
    )


def _draw_kinds(distributions: Mapping[str, Any]) -> dict[str, str]:
    """Return the kind of each result column of random values, by column name.

    Kinds are "bool", "int", "float" and "text". `distributions` has the distribution of each
    scenario key; a choice of tables gives a column for each key of the tables.
    """
    found: dict[str, list[Any]] = {}
    for key, distribution in distributions.items():
        for value in distribution.values if isinstance(distribution, Choice) else (0.0,):
            for name, one in _by_full_key({key: value}).items():
                found.setdefault(name, []).append(one)
    return {name: kind_of(values) for name, values in found.items()}


def check_first_flights(spec: CampaignSpec) -> None:
    """Check that the first flight of every arm of a campaign can be set up.

    An arm is a variant of the scenario. The flights are not flown.

    Raises
    ------
    InputError
        If a flight cannot be set up, or a file of another flight cannot be read.
    """
    check_files(spec)
    seed = flight_seed(spec.head.seed, 0)
    grounds: dict[str, Terrain] = {}
    for i, arm in enumerate(spec.arms):
        scenario = spec.scenario_of(0, i)
        key = tables_as_text(scenario, GROUND_TABLES)
        world = build_world(scenario, RandomStreams(seed), grounds.get(key))
        grounds = {key: world.terrain}
        Simulation(scenario, seed, arm.policy or scenario.policy.kind, world=world).close()


def check_files(spec: CampaignSpec) -> None:
    """Check the terrain files of all arms of a campaign by reading them.

    An arm is a variant of the scenario. This includes files that a random choice of a terrain value
    may select.

    Raises
    ------
    InputError
        If a file cannot be read, or is not usable as the scenario uses it.
    """
    choices = {
        key: law.values
        for key, law in spec.dispersions.distributions.items()
        if isinstance(law, Choice) and key.partition(".")[0] == "terrain"
    }
    read: set[str] = set()
    for arm in spec.arms:
        others = [{key: value} for key, values in choices.items() for value in values]
        for values in others or [{}]:
            scenario = with_values(arm.scenario, values, "dispersions")
            key = tables_as_text(scenario, ("terrain",))
            if key not in read:
                scenario.check_files()
                read.add(key)


def _by_full_key(values: Any, prefix: str = "") -> dict[str, Any]:
    """Return scenario values by complete key, as in the columns of the results.

    For instance, ``policy`` becomes ``policy.kind``. `prefix` precedes the keys.
    """
    found: dict[str, Any] = {}
    for key, value in values.items():
        name = prefix + ".".join(path_of(key, value))
        found |= _by_full_key(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return found


def fly(study: FlightSettings, group: Group, arm: int, memory: dict[Any, Any]) -> dict[str, Any]:
    """Fly one flight of a campaign under one arm; return its metrics by name.

    An arm is a variant of the scenario.

    Parameters
    ----------
    study
        Settings of the campaign.
    group, arm
        Group of the flight; index of the arm.
    memory
        Worlds, their true landing safety and shared parts of flights that the group has computed so
        far; extended here.

    Raises
    ------
    RecordNotWrittenError
        With the metrics, if the record or the plots cannot be written.
    """
    flight, simulation, row = fly_with_simulation(study, group, arm, memory)
    name = study.arms[arm].name
    try:
        _save_record(study, group.flight, name, flight, row["safe"])
        if study.out is not None and study.figures and (group.flight == 0 or not row["safe"]):
            from lunarsim.viz import draw_flight  # noqa: PLC0415  (matplotlib is slow to load)

            folder = study.out / "figures" / folder_name(name)
            if group.flight:
                folder /= f"failed-{group.flight}"
            draw_flight(flight, simulation.world, simulation.truth, folder)
    except OSError as error:
        raise RecordNotWrittenError(row, f"Record or figures were not written: {error}.") from error
    return row


def fly_with_simulation(
    study: FlightSettings, group: Group, arm: int, memory: dict[Any, Any]
) -> tuple[Flight, Simulation, dict[str, Any]]:
    """Fly one flight under one arm; return record, simulation and metrics.

    An arm is a variant of the scenario. No file is written. The parameters are those of `fly`.
    """
    draws = {k: value for k, value in group.draws.items() if k not in (WEIGHT, *_SUBSET_COLUMNS)}
    scenario = with_values(study.arms[arm].scenario, draws, "dispersions")
    seed = flight_seed(study.seed, group.draws.get(WORLD, world_index(group.flight, study.block)))
    grounds = WorldTruthProvider(seed, memory, study.cache)
    world, truth = grounds.world_and_truth(scenario)

    def new_simulation(policy: Any) -> Simulation:
        return Simulation(scenario, seed, policy, world=world, truth=truth)

    others = _same_path_scenarios(study, group, arm, draws)
    if others:
        branches = memory.setdefault(("paths", study.paths[arm]), {})
        scenarios = {arm: scenario} | others
        simulation = fly_on_shared_path(
            arm, scenarios, lambda: new_simulation(scenario.policy.kind), branches
        )
    else:
        simulation = new_simulation(study.arms[arm].policy or scenario.policy.kind)
        simulation.run()
    flight = simulation.flight()
    return flight, simulation, evaluate(flight, truth) | grounds.shares(scenario, truth)


def _same_path_scenarios(
    study: FlightSettings, group: Group, arm: int, draws: Mapping[str, Any]
) -> dict[int, Scenario]:
    """Return the scenarios of other arms of a group that differ only in policy.

    An arm is a variant of the scenario. The result is by index of the arm; an arm that refuses the
    random values is omitted. `draws` are the random values of the flight by key.
    """
    found = {}
    for i in group.arms if study.paths else ():
        if i != arm and study.paths[i] == study.paths[arm]:
            with contextlib.suppress(InputError):  # raised again when that arm is flown
                found[i] = with_values(study.arms[i].scenario, draws, "dispersions")
    return found


def _save_record(study: FlightSettings, index: int, arm: str, flight: Flight, safe: bool) -> None:
    """Write the complete record of a flight atomically, if the campaign keeps it.

    An arm is a variant of the scenario. `index` is the index of the flight, `arm` the name of its
    arm, and `safe` its outcome.
    """
    if study.out is None or study.records == "none" or (study.records == "failures" and safe):
        return
    folder = study.out / "flights" / folder_name(arm)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".part-", dir=folder) as temporary:
        flight.save(Path(temporary) / "flight")
        target = folder / f"{index:05d}"
        if target.exists():
            shutil.rmtree(target)  # leftover of the same flight, whose row was not written
        (Path(temporary) / "flight").rename(target)


@dataclass(frozen=True)
class ReplayResult:
    """Result of flying one flight of a campaign again.

    Attributes
    ----------
    flight, simulation
        Record of the flight, and its simulation.
    row
        Metrics of the new flight by name.
    recorded
        Row of the flight in the results of the campaign, or None.
    differences
        Name, recorded and new value of metrics that differ; None if the row has no outcome.
    """

    flight: Flight
    simulation: Simulation
    row: dict[str, Any]
    recorded: dict[str, Any] | None
    differences: list[tuple[str, Any, Any]] | None


def replay(folder: str | Path, flight: str) -> ReplayResult:
    """Fly one flight of a campaign again, in this process.

    Parameters
    ----------
    folder
        Folder of the campaign.
    flight
        Id of the flight, for instance ``12-0``: index and number of the arm.

    Raises
    ------
    InputError
        If the folder holds no campaign with a readable spec, or the flight does not exist.
    """
    found = load_results(folder)
    spec_file = Path(folder) / "spec.toml"
    if not spec_file.is_file():
        raise InputError(
            "folder", str(folder), "must contain spec.toml",
            "Campaigns with policy objects have none and cannot be replayed.",
        )  # fmt: skip
    spec = CampaignSpec.load(spec_file)
    index, arm = _parse_flight_id(flight, int(found.manifest["flights"]), len(spec.arms))
    plan = build_plan(spec)
    study = plan.work.study
    group = Group(index, (arm,), _draws(plan, found, index))
    record, simulation, row = fly_with_simulation(study, group, arm, {})
    rows = found.table.filter(pc.equal(found.table["id"], flight)).to_pylist()
    recorded = rows[0] if rows else None
    differences = None
    if recorded is not None and recorded["safe"] is not None:
        differences = [
            (name, recorded[name], value)
            for name, value in row.items()
            if not _are_equal(recorded.get(name), value)
        ]
    return ReplayResult(record, simulation, row, recorded, differences)


def _draws(plan: Plan, results: Results, index: int) -> dict[str, Any]:
    """Return the random scenario values of the flight with an index, by key.

    With method subset, they depend on the `results` of earlier flights.
    """
    if plan.chains is not None:
        plan.chains.resume(results.table.to_pylist())
    try:
        return plan.draws(index)
    except LookupError:
        raise InputError(
            "--flight", index, "must not depend on flights that have not been flown",
            "Choose one from the column id of the results.",
        ) from None  # fmt: skip


def _parse_flight_id(flight: str, flights: int, arms: int) -> tuple[int, int]:
    index, _, arm = flight.partition("-")
    if not (index.isdecimal() and arm.isdecimal() and int(index) < flights and int(arm) < arms):
        raise InputError(
            "--flight", flight,
            f"must be INDEX-ARM, with INDEX from 0 to {flights - 1} and ARM from 0 to {arms - 1}",
            "Choose one from the column id of the results.",
        )  # fmt: skip
    return int(index), int(arm)


def _are_equal(a: Any, b: Any) -> bool:
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a):
        return math.isnan(b)
    return bool(a == b)
