"""Tables of a flight as CSV files."""

from __future__ import annotations

from pathlib import Path

import pyarrow.csv as pcsv

from lunarsim.atomic_files import atomic_write
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.tables import tables_of
from lunarsim.simulation import Flight
from lunarsim.simulation.flight_files import arrow_table


def write_csv(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write one file ``TABLE.csv`` per table into the folder `out`.

    The header line has the names of the columns with their units: ``position_x (m)``. The options
    have no effect.
    """
    out.mkdir(parents=True, exist_ok=True)
    for table, columns in tables_of(flight):
        found = arrow_table(table, columns)
        units = table.columns(len(columns))
        named = found.rename_columns(
            [f"{name} ({units[name].unit})" for name in found.column_names]
        )
        atomic_write(out / f"{table.name}.csv", lambda part, t=named: pcsv.write_csv(t, part))  # type: ignore[misc]
