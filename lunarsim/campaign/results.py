"""Read the results of a campaign, also while it is running."""

from __future__ import annotations

import fcntl
import json
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from lunarsim.atomic_files import atomic_write
from lunarsim.campaign.manifest import FORMAT, read_manifest
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import WEIGHT
from lunarsim.campaign.provenance import bytes_digest
from lunarsim.campaign.rows import TIMING, check_size_in_memory, schema_of
from lunarsim.errors import InputError, check_output
from lunarsim.typing import BoolArray
from lunarsim.untrusted_files import read_bounded_bytes

# Columns that have a value in every row.
_REQUIRED_COLUMNS = ("id", "flight", "arm")
# Number of attempts to read a part that may change meanwhile.
_READ_ATTEMPTS = 3
# Number of recent rows that the rate is computed from.
_RATE_ROWS = 200


@dataclass(frozen=True)
class Results:
    """Results of the flights in the folder of a campaign.

    Attributes
    ----------
    folder, manifest
        Folder and manifest of the campaign.
    table
        One row per flight and arm (variant of the scenario), sorted by flight, then arm.
    timing
        Wall-clock times of the flights, in the same order.
    """

    folder: Path
    manifest: dict[str, Any]
    table: pa.Table
    timing: pa.Table

    @property
    def arms(self) -> list[str]:
        """Names of the arms, in the order of the spec.

        An arm is a variant of the scenario.
        """
        return [arm["name"] for arm in self.manifest["arms"]]

    @property
    def expected_rows(self) -> int:
        """Number of result rows of the complete campaign: flights times arms.

        An arm is a variant of the scenario.
        """
        return int(self.manifest["flights"]) * len(self.arms)

    @property
    def has_unequal_weights(self) -> bool:
        """Whether flights have unequal weights (method importance or subset)."""
        return WEIGHT in self.manifest["inputs"] or self.is_subset

    @property
    def is_subset(self) -> bool:
        """Whether the campaign is a subset simulation (for rare failures)."""
        return bool(self.manifest["identity"].get("method") == "subset")

    @property
    def independent(self) -> BoolArray:
        """Mask of the rows of statistically independent flights (n,).

        In a Saltelli design, whose blocks fly two worlds repeatedly, these are the first and last
        flight of each block (points A and B). With any other method, they are all flights.
        """
        identity = self.manifest["identity"]
        if identity.get("method") != "saltelli":
            return np.ones(len(self.table), dtype=bool)
        block = len(identity.get("dispersions", {})) + 3
        place = self.table["flight"].to_numpy() % block
        return np.asarray((place == 0) | (place == block - 1))

    def check_equal_weights(self, field: str) -> None:
        """Raise `InputError` naming `field` if flights have unequal weights."""
        if self.has_unequal_weights:
            raise InputError(
                field, str(self.folder), "must be a campaign whose flights have equal weights",
                "For importance sampling and subset simulation use: lunarsim campaign rare.",
            )  # fmt: skip


def load_results(folder: str | Path, columns: Sequence[str] | None = None) -> Results:
    """Read the results of a campaign, finished or not.

    Parameters
    ----------
    folder
        Folder of the campaign.
    columns
        Columns to read; omitted: all.

    Raises
    ------
    InputError
        If the folder holds no campaign, or a file of results cannot be read.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    if manifest["format"] != FORMAT:
        expected = f"must be a campaign of format {FORMAT}, not {manifest['format']}"
        raise InputError("folder", str(folder), expected)
    schema = schema_of(manifest["inputs"], manifest["columns"])
    # The journal comes first: a row that moves meanwhile is then read twice rather than never.
    journal = _journal(folder)
    wanted = None if columns is None else list(dict.fromkeys(["id", "flight", "arm", *columns]))
    table = _read_parts(folder, "results", schema, wanted, manifest)
    timing = _read_parts(folder, "timing", TIMING, None, manifest)
    if journal:
        # A flight that was flown again has its newer row in the journal.
        table, timing = (_without_rows(one, list(journal)) for one in (table, timing))
        try:
            rows = pa.Table.from_pylist([row for row, _ in journal.values()], schema)
            times = pa.Table.from_pylist([t for _, t in journal.values()], TIMING)
        except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
            raise _damaged(folder / "journal.jsonl", error) from None
        table = pa.concat_tables([table, rows.select(table.column_names)])
        timing = pa.concat_tables([timing, times])
    place = {arm["name"]: i for i, arm in enumerate(manifest["arms"])}
    unknown = set(table["arm"].unique().to_pylist()) - set(place)
    if unknown:
        expected = f"has rows of arms that its manifest does not name: {sorted(unknown)}"
        raise InputError("folder", str(folder), expected)
    if manifest["state"] in ("complete", "stopped") and len(table) < int(manifest["rows"]):
        raise InputError(
            "folder", str(folder),
            f"contains the results of only {len(table)} of {manifest['rows']} flights",
            "Fly the missing ones: `lunarsim campaign run` with the same campaign file.",
        )  # fmt: skip
    arm = np.array([place[name] for name in table["arm"].to_pylist()], dtype=np.int64)
    order = np.lexsort((arm, table["flight"].to_numpy()))
    if not np.array_equal(order, np.arange(len(order))):
        table = table.take(order)
    return Results(folder, manifest, table, _order_like(timing, table))


def _without_rows(table: pa.Table, ids: list[str]) -> pa.Table:
    """Return the rows of a table whose ids are not in `ids`."""
    return table.filter(pc.invert(pc.is_in(table["id"], pa.array(ids))))


def _order_like(timing: pa.Table, table: pa.Table) -> pa.Table:
    """Return the rows of `timing` in the order of the results `table`.

    A result without a time has empty values.
    """
    if timing["id"].equals(table["id"]):
        return timing
    places = pc.index_in(table["id"], value_set=timing["id"].combine_chunks())
    return timing.take(places).set_column(0, "id", table["id"])


def _read_parts(
    folder: Path, kind: str, schema: pa.Schema, columns: list[str] | None, manifest: dict[str, Any]
) -> pa.Table:
    """Read all Parquet files of a campaign's results or times into one table.

    `kind` is the subfolder, "results" or "timing"; `columns` are the columns to read, or None.
    """
    tables = []
    for path in sorted((folder / kind).glob("part-*.parquet")):
        try:
            data = _verified_bytes(folder, path, manifest)
            check_size_in_memory(data)
            table = pq.read_table(pa.BufferReader(data), columns=columns, schema=schema)
            if any(
                table[name].null_count for name in _REQUIRED_COLUMNS if name in table.column_names
            ):
                raise ValueError("a row has no id, flight or arm")
            tables.append(table)
        except FileNotFoundError:
            continue
        except (pa.ArrowException, OSError, ValueError, TypeError, KeyError) as error:
            raise _damaged(path, error) from None
    if tables:
        return pa.concat_tables(tables)
    empty = schema.empty_table()
    return empty if columns is None else empty.select(columns)


def _verified_bytes(folder: Path, path: Path, manifest: dict[str, Any]) -> bytes:
    """Return the bytes of a result file, whose digest must match the manifest.

    After a mismatch, the file and the manifest are read again, because a running campaign may be
    changing them; after three mismatches a ValueError is raised.
    """
    name = str(path.relative_to(folder))
    for _ in range(_READ_ATTEMPTS):
        data = read_bounded_bytes(path)
        digest = bytes_digest(data)
        if manifest.get("parts", {}).get(name, digest) == digest:
            return data
        manifest = read_manifest(folder)
    raise ValueError("its digest differs from the one in manifest.json")


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(
        "folder", str(path),
        f"cannot be read ({(str(error).splitlines() or [type(error).__name__])[0][:100]})",
        "Repeat the flights of this file: `lunarsim campaign run` with the same campaign file.",
    )  # fmt: skip


def _journal(folder: Path) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Return result rows and times in the journal of recent flights, by row id.

    Incomplete lines are ignored.
    """
    found = {}
    path = folder / "journal.jsonl"
    lines = read_bounded_bytes(path).split(b"\n") if path.exists() else []
    for line in lines:
        try:
            row, timing = json.loads(line)
            found[row["id"]] = row, timing
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    return found


@dataclass(frozen=True)
class CampaignStatus:
    """State of a campaign, and how many of its flights are done.

    Attributes
    ----------
    name
        Name of the campaign.
    state
        complete, stopped (by the early-stopping rule), interrupted, out of time, flying, or killed
        (no process is writing to the folder, and the last one did not close it).
    done, expected_rows
        Number of rows so far, and of the complete campaign.
    outcomes
        Number of rows by outcome.
    rate
        Recent rows per second; NaN if there are too few.
    """

    name: str
    state: str
    done: int
    expected_rows: int
    outcomes: dict[str, int]
    rate: float

    @property
    def seconds_left(self) -> float:
        """Remaining wall-clock time at the recent rate, s."""
        return (self.expected_rows - self.done) / self.rate if self.rate > 0.0 else float("nan")


def read_status(folder: str | Path) -> CampaignStatus:
    """Read the progress of a finished or running campaign from its folder.

    Raises
    ------
    InputError
        If the folder holds no campaign.
    """
    found = load_results(folder, ["outcome"])
    state = str(found.manifest["state"])
    if state == "running":
        state = "flying" if _is_locked(found.folder) else "killed"
    ended = np.sort(np.array(found.timing["finished_unix_s"].to_pylist(), dtype=np.float64))
    recent = ended[np.isfinite(ended)][-_RATE_ROWS:]
    rate = float("nan")
    if len(recent) > 1:
        span = (time.time() if state == "flying" else recent[-1]) - recent[0]
        rate = float((len(recent) - 1) / span) if span > 0.0 else rate
    return CampaignStatus(
        str(found.manifest["name"]), state, len(found.table), found.expected_rows,
        dict(Counter(found.table["outcome"].to_pylist())), rate,
    )  # fmt: skip


def _is_locked(folder: Path) -> bool:
    """Return whether a process is writing to the folder of a campaign."""
    try:
        with (folder / ".lock").open("r", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def export(folder: str | Path, out: Path, *, timing: bool = False) -> int:
    """Write all results of a campaign to a CSV or Parquet file; return the row count.

    Parameters
    ----------
    folder, out
        Folder of the campaign; file to write.
    timing
        Whether wall-clock times are included.

    Raises
    ------
    InputError
        If the folder or the file name is not usable.
    """
    suffix = out.suffix.lower()
    if suffix not in (".csv", ".parquet"):
        raise InputError("--out", str(out), "must be a file name that ends in .csv or .parquet")
    check_output("--out", out, suffix)
    found = load_results(folder)
    table = found.table
    if timing:
        for name in TIMING.names[1:]:
            table = table.append_column(name, found.timing[name])
    write = pcsv.write_csv if suffix == ".csv" else pq.write_table
    atomic_write(out, lambda path: write(table, path))
    return len(table)


def failures(results: Results) -> list[tuple[str, str, int]]:
    """Count the causes of unsafe landings and errors: arm, cause, number of flights.

    An arm is a variant of the scenario.
    """
    counts: Counter[tuple[str, str]] = Counter()
    table = results.table
    whys = table["failure_causes"] if "failure_causes" in table.column_names else table["error"]
    columns = (table["arm"], table["outcome"], whys, table["error"])
    for arm, outcome, causes, error in zip(*(c.to_pylist() for c in columns), strict=True):
        if outcome != FLOWN:
            counts[arm, f"{outcome}: {error}"] += 1
        elif causes:
            counts[arm, causes] += 1
    place = {name: i for i, name in enumerate(results.arms)}
    ordered = sorted(counts.items(), key=lambda item: (place[item[0][0]], -item[1]))
    return [(arm, what, count) for (arm, what), count in ordered]
