"""Tables of a flight as structs in a MAT file."""

from __future__ import annotations

import io
from pathlib import Path

from scipy.io import savemat

from lunarsim.atomic_files import atomic_write
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.tables import tables_of
from lunarsim.simulation import Flight


def write_matlab(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write a MAT file (version 5) with one struct per table.

    A struct has one column vector per column. ``units.TABLE`` and ``frames.TABLE`` have the unit
    and the frame of each column as text, and ``flight`` has scenario, seed and outcome. The options
    have no effect.
    """
    tables, units, frames = {}, {}, {}
    for table, columns in tables_of(flight):
        groups = table.columns(len(columns))
        tables[table.name] = columns
        units[table.name] = {name: g.unit for name, g in groups.items()}
        frames[table.name] = {name: g.frame for name, g in groups.items()}
    facts = {
        "scenario": flight.scenario, "policy": flight.policy, "safe": flight.outcome.safe,
        "failure_causes": ", ".join(flight.outcome.failure_causes),
        "entropy": str(flight.seed.get("entropy")), "spawn_key": str(flight.seed.get("spawn_key")),
        "target": flight.target,
    }  # fmt: skip
    content = {**tables, "units": units, "frames": frames, "flight": facts}
    stream = io.BytesIO()
    savemat(stream, content, long_field_names=True, do_compression=True, oned_as="column")
    atomic_write(out, lambda part: part.write_bytes(stream.getbuffer()))
