"""Fly one flight of a campaign again and compare its metrics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.compute as pc

from lunarsim.campaign.flight_execution import build_plan, fly_with_simulation
from lunarsim.campaign.plan import Group, Plan
from lunarsim.campaign.results import Results, load_results
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.errors import InputError
from lunarsim.simulation import Flight, Simulation


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
