"""Tables of a flight that are exported as they are."""

from __future__ import annotations

from collections.abc import Iterator

from lunarsim.simulation import Flight
from lunarsim.simulation.columns import CANDIDATES, COLUMN_TABLES, SCANS, Table
from lunarsim.typing import Array


def tables_of(flight: Flight) -> Iterator[tuple[Table, dict[str, Array]]]:
    """Yield declaration and columns (n,) of each table that has rows."""
    for table in COLUMN_TABLES:
        if columns := getattr(flight, table.name):
            yield table, columns
    for table in (SCANS, CANDIDATES):
        rows = getattr(flight, table.name)
        if len(rows):
            yield table, table.as_columns(rows)
