"""Values of a scenario by keys, and the tables that a world is made from."""

from __future__ import annotations

from typing import Any

from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import at, path_of

# What a ground and the truth about it are made from, besides the seed.
GROUND_TABLES = ("terrain", "rocks")
TRUTH_TABLES = (*GROUND_TABLES, "vehicle")


def value_at(scenario: Scenario, key: str) -> Any:
    """Return the scenario's own value at a key, None where it has none."""
    return at(scenario.to_dict(), path_of(key))


def tables_of(scenario: Scenario, tables: tuple[str, ...]) -> str:
    """Return some tables as a text that two scenarios share exactly if their tables are equal."""
    data = scenario.to_dict()
    return repr({name: data.get(name) for name in tables})
