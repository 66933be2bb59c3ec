"""Scenario values by key, and the tables that define a world."""

from __future__ import annotations

from typing import Any

from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import nested_value, path_of

# Tables that define the terrain and the truth about it, together with the seed.
GROUND_TABLES = ("terrain", "rocks")
TRUTH_TABLES = (*GROUND_TABLES, "vehicle")


def value_at(scenario: Scenario, key: str) -> Any:
    """Return the value of a scenario at a dotted key; None if the key does not exist."""
    return nested_value(scenario.to_dict(), path_of(key))


def tables_as_text(scenario: Scenario, tables: tuple[str, ...]) -> str:
    """Return the named tables of a scenario as text, for use as a dictionary key.

    Two texts are equal if and only if the tables are equal.
    """
    data = scenario.to_dict()
    return repr({name: data.get(name) for name in tables})
