"""Write the inputs of all flights of a campaign to a file."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from lunarsim.campaign.plan import Plan
from lunarsim.campaign.rows import schema_of, to_cell


def write_plan(plan: Plan, path: Path, suffix: str) -> None:
    """Write the inputs of every flight of a campaign to a CSV or Parquet file.

    An arm is a variant of the scenario. The file has one row per flight and arm: id, flight, arm,
    seed and inputs.

    Parameters
    ----------
    plan, path
        Plan; path of the file.
    suffix
        Format, .csv or .parquet.
    """
    full_schema = schema_of(plan.inputs, {})
    schema = pa.schema(
        [full_schema.field(n) for n in ("id", "flight", "arm", "seed", *plan.inputs)]
    )
    rows = [
        row | {key: to_cell(row.get(key), kind) for key, kind in plan.inputs.items()}
        for row in plan.rows()
    ]
    table = pa.Table.from_pylist(rows, schema)
    (pcsv.write_csv if suffix == ".csv" else pq.write_table)(table, path)
