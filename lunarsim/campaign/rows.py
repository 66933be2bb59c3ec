"""Columns of plans, results and times; convert finished flights to rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

import lunarsim
from lunarsim.campaign.outcomes import Finished
from lunarsim.campaign.plan import Plan, row_id
from lunarsim.campaign.provenance import code_digest
from lunarsim.untrusted_files import MAX_FILE_BYTES

# A row of results and its row of times.
Row = tuple[dict[str, Any], dict[str, Any]]
# Kinds of columns and their Arrow types.
KINDS = {"bool": pa.bool_(), "int": pa.int64(), "float": pa.float64(), "text": pa.string()}
_PYTHON_TYPES = {"bool": bool, "int": int, "float": float, "text": str}
TIMING = pa.schema(
    [("id", pa.string()), ("seconds", pa.float64()), ("finished_unix_s", pa.float64()),
     ("worker", pa.string()), ("attempts", pa.int64())]
)  # fmt: skip


def schema_of(inputs: Mapping[str, str], columns: Mapping[str, str]) -> pa.Schema:
    """Return the Arrow schema of a campaign's results.

    `inputs` and `columns` are the kinds ("bool", "int", "float", "text") of the scenario values and
    of the metrics, by column name.
    """
    return pa.schema(
        [
            ("id", pa.string()),
            ("flight", pa.int64()),
            ("arm", pa.string()),
            ("seed", pa.int64()),
            *((key, KINDS[kind]) for key, kind in inputs.items()),
            ("outcome", pa.string()),
            *((key, KINDS[kind]) for key, kind in columns.items()),
            ("error", pa.string()),
            ("traceback", pa.string()),
            ("campaign", pa.string()),
            ("version", pa.string()),
            ("code", pa.string()),
        ]
    )


def check_size_in_memory(data: bytes) -> None:
    """Refuse a Parquet file that takes more than `MAX_FILE_BYTES` in memory.

    A small file may expand to a large table, because a column may repeat a long text many times.

    Raises
    ------
    ValueError
        If the file is too large.
    """
    file = pq.ParquetFile(pa.BufferReader(data))
    leaves = [file.schema.column(i) for i in range(len(file.schema))]
    texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]
    size = 8 * file.metadata.num_rows * len(leaves)
    if size <= MAX_FILE_BYTES:
        table = pq.ParquetFile(pa.BufferReader(data), read_dictionary=texts).read(texts)
        for chunk in (chunk for column in table.columns for chunk in column.chunks):
            lengths = pc.binary_length(chunk.dictionary.cast(pa.large_string()))
            size += pc.sum(lengths.take(chunk.indices)).as_py() or 0
    if size > MAX_FILE_BYTES:
        raise ValueError(f"larger than {MAX_FILE_BYTES // 2**20} MiB when decompressed")


def row_of(plan: Plan, finished: Finished) -> dict[str, Any]:
    """Return the result row of a finished flight, with None for missing values.

    `plan` has the inputs of the flight, and `finished` its outcome and metrics.
    """
    metrics = finished.metrics or {}
    inputs = plan.inputs_of(finished.flight, finished.arm)
    return {
        "id": row_id(finished.flight, finished.arm),
        "flight": finished.flight,
        "arm": plan.arms[finished.arm][0],
        "seed": plan.seed,
        **{key: to_cell(inputs.get(key), kind) for key, kind in plan.inputs.items()},
        "outcome": finished.outcome,
        **{key: _convert_metric(metrics.get(key), kind) for key, kind in plan.columns.items()},
        "error": _escape_non_utf8(finished.error),
        "traceback": _escape_non_utf8(finished.traceback),
        "campaign": plan.name,
        "version": lunarsim.__version__,
        "code": code_digest(),
    }


def _convert_metric(value: Any, kind: str) -> Any:
    """Convert a metric to the Python type of its column's kind; None stays None."""
    return None if value is None else _PYTHON_TYPES[kind](value)


def _escape_non_utf8(text: str) -> str:
    """Escape characters that UTF-8 cannot encode; file names may contain them."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def to_cell(value: Any, kind: str) -> Any:
    """Convert a scenario value for a result column of the given kind.

    In a text column, a value that is not a string becomes JSON text.
    """
    return json.dumps(value) if kind == "text" and not isinstance(value, str | None) else value


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
