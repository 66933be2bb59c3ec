"""Store a campaign: journal of finished flights, Parquet parts and manifest.

``manifest.json``
    What is flown, with which code and on which machine; the state of the campaign.
``results/part-00000.parquet``
    One row per flight and arm: id, seed, inputs, outcome, metrics, versions; sorted by flight,
    then arm. The same campaign gives the same bytes, also after interruptions.
``timing/part-00000.parquet``
    Wall-clock times of the same rows; they differ between runs.
``journal.jsonl``
    Finished flights that are in no part yet, one line each, appended as they finish.

A flight is first written to the journal; parts are renamed into place; the journal is truncated
after that. If the writer is killed, every finished flight is therefore in a part, in the journal,
or in both, and `Store.open` recovers it. A folder has one writer.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import time
from collections.abc import Iterator, Set
from pathlib import Path
from typing import IO, Any

import pyarrow as pa
import pyarrow.parquet as pq

from lunarsim.atomic_files import atomic_write, atomic_write_text
from lunarsim.campaign.manifest import matching_manifest, new_manifest, with_digest
from lunarsim.campaign.outcomes import FLOWN, Finished
from lunarsim.campaign.plan import Plan, row_id
from lunarsim.campaign.provenance import bytes_digest
from lunarsim.campaign.rows import TIMING, Row, check_size_in_memory, row_of, schema_of
from lunarsim.errors import InputError
from lunarsim.untrusted_files import read_bounded_bytes

# Approximate number of rows of a part.
PART_ROWS = 5000
# Number of rows converted to Python objects at a time, which limits memory.
_ROWS_PER_BATCH = 500
# Minimum time between two fsyncs of the journal, s.
_FSYNC_INTERVAL_S = 1.0


class Store:
    """Folder of a campaign, open for writing; create it with `open`.

    Attributes
    ----------
    folder
        Folder of the campaign.
    plan
        Flights of the campaign.
    notes
        Messages about damage found when the folder was opened, and about data not stored.
    """

    def __init__(self, folder: Path, plan: Plan, lock: IO[str], manifest: dict[str, Any]) -> None:
        self.folder, self.plan, self.notes = folder, plan, list[str]()
        self.manifest = manifest
        self._lock = lock
        self._schema = schema_of(plan.inputs, plan.columns)
        self._per_part = max(1, PART_ROWS // len(plan.arms))
        self._full: set[int] = set()
        # Rows of incomplete parts, by part, then (flight, arm). They are kept as journal lines,
        # which take a tenth of the memory of dictionaries.
        self._open: dict[int, dict[tuple[int, int], str]] = {}
        self._journal: IO[str] | None = None
        self._synced = 0.0

    # --- opening --------------------------------------------------------------------------

    @classmethod
    def open(cls, folder: Path, plan: Plan, *, retry: bool = False) -> Store:
        """Create the folder of a campaign, or resume one.

        Parameters
        ----------
        folder, plan
            Folder and flights of the campaign.
        retry
            Whether flights without an outcome are flown again.

        Raises
        ------
        InputError
            If the folder holds other data, another campaign or results of other code, or if
            another process is writing there. Nothing has been changed then.
        """
        manifest = matching_manifest(folder, plan)
        # Creating the first array makes pyarrow load pandas; do it before interrupts are deferred.
        pa.array([], pa.int64())
        folder.mkdir(parents=True, exist_ok=True)
        store = cls(folder, plan, _lock_folder(folder), manifest or new_manifest(plan))
        try:
            store.manifest["flights"] = plan.flights
            store._load(retry)
            # The manifest comes first: it identifies the folder as a campaign.
            store.save_manifest(state="running")
            (folder / "results").mkdir(exist_ok=True)
            (folder / "timing").mkdir(exist_ok=True)
            store._journal = (folder / "journal.jsonl").open("a", encoding="utf-8")
        except BaseException:
            store._release()
            raise
        return store

    def _load(self, retry: bool) -> None:
        """Load the stored results: Parquet parts first, then the journal's newer rows.

        `retry` drops flights without an outcome, so that they are flown again.
        """
        for old in self.folder.rglob(".*.part"):
            old.unlink()
        for path in sorted((self.folder / "results").glob("part-*.parquet")):
            self._load_part(path, retry)
        path = self.folder / "journal.jsonl"
        if path.exists():
            self._load_journal(path, retry)
            self._write_journal()
        for part in [p for p in self._open if self._is_full(p)]:
            self._write_part(part)

    def _load_part(self, path: Path, retry: bool) -> None:
        try:
            number = int(path.stem.removeprefix("part-"))
            part = self._read_part(path)
        except (pa.ArrowException, OSError, ValueError) as error:
            self._parts().pop(f"results/{path.name}", None)
            path.replace(path.with_suffix(".broken"))
            reason = str(error).split("\n")[0]
            self.notes.append(
                f"{path.name} cannot be read ({reason}). It is kept as {path.stem}.broken; its "
                "flights are flown again."
            )
            return
        kept = {
            key: _journal_line(row)
            for key, row in part.items()
            if key[0] < self.plan.flights and not (retry and row[0]["outcome"] != FLOWN)
        }
        self._open[number] = kept
        if self._is_full(number) and len(kept) == len(part):
            del self._open[number]
            self._full.add(number)

    def _read_part(self, path: Path) -> dict[tuple[int, int], Row]:
        """Return results and times in a Parquet part, by indices of flight and arm.

        An arm is a variant of the scenario.
        """
        table = pq.read_table(self._read("results", path.name), page_checksum_verification=True)
        if table.schema != self._schema:
            raise pa.ArrowInvalid("unexpected columns")
        try:
            times = pq.read_table(self._read("timing", path.name), schema=TIMING).to_pylist()
        except (pa.ArrowException, OSError, ValueError):
            times = []
            self.notes.append(f"timing/{path.name} cannot be read: its times are lost.")
        timing = {time["id"]: time for time in times}
        names = {name: i for i, (name, _) in enumerate(self.plan.arms)}
        part = {}
        for row in table.to_pylist():
            flight, arm = row["flight"], names.get(row["arm"], -1)
            if row["id"] != row_id(flight, arm) or path != self._path(
                "results", self._part(flight)
            ):
                raise ValueError(f"row {row['id']} does not belong to this part")
            unknown = dict.fromkeys(TIMING.names) | {"id": row["id"]}
            part[flight, arm] = row, timing.get(row["id"], unknown)
        if len(part) < len(table):
            raise ValueError("a flight occurs twice")
        return part

    def _parts(self) -> dict[str, str]:
        """Return the digest of every complete Parquet part, by its path in the folder."""
        found: dict[str, str] = self.manifest.setdefault("parts", {})
        return found

    def _read(self, kind: str, name: str) -> pa.BufferReader:
        """Return the bytes of a Parquet part; raise ValueError if its digest differs.

        `kind` is the subfolder, "results" or "timing", and `name` the file name.
        """
        data = read_bounded_bytes(self.folder / kind / name)
        if self._parts().get(f"{kind}/{name}", bytes_digest(data)) != bytes_digest(data):
            raise ValueError("its digest differs from the one in manifest.json")
        check_size_in_memory(data)
        return pa.BufferReader(data)

    def _drop_digests(self, part: int) -> None:
        """Remove the digests of a Parquet part, given by number, that is about to change."""
        known = [self._parts().pop(self._name(kind, part), None) for kind in ("results", "timing")]
        if any(known):
            self.save_manifest()

    def _name(self, kind: str, part: int) -> str:
        return str(self._path(kind, part).relative_to(self.folder))

    def _reopen(self, part: int) -> None:
        """Load the rows of a complete Parquet part, given by number, into memory again."""
        self._full.remove(part)
        rows = self._read_part(self._path("results", part))
        self._open[part] = {key: _journal_line(row) for key, row in rows.items()}

    def _load_journal(self, path: Path, retry: bool) -> None:
        lines = read_bounded_bytes(path).split(b"\n")
        for i, line in enumerate(lines):
            if not line:
                continue
            try:
                row, timing = json.loads(line)
                flight, arm = (int(part) for part in row["id"].split("-"))
                if (row["flight"], row["arm"]) != (flight, self.plan.arms[arm][0]):
                    raise ValueError("row of another campaign")
                _check_types(row, timing, self._schema)
            except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
                last = i == len(lines) - 1
                if not last:
                    self.notes.append(
                        f"Line {i + 1} of the journal cannot be read; its flight is flown again."
                    )
                continue
            if (retry and row["outcome"] != FLOWN) or flight >= self.plan.flights:
                continue
            part = self._part(flight)
            if part in self._full:
                # The flight was flown again, but its part still has the failed row.
                self._reopen(part)
            self._open.setdefault(part, {})[flight, arm] = _journal_line((row, timing))

    # --- what is there --------------------------------------------------------------------

    def has(self, flight: int, arm: int) -> bool:
        """Return whether the result of a flight under an arm, given by indices, is stored.

        An arm is a variant of the scenario.
        """
        part = self._part(flight)
        return part in self._full or (flight, arm) in self._open.get(part, {})

    @property
    def count(self) -> int:
        """Number of stored result rows."""
        full = sum(len(self._flights(part)) for part in self._full) * len(self.plan.arms)
        return full + sum(map(len, self._open.values()))

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield all result rows as dictionaries, sorted by flight, then arm.

        An arm is a variant of the scenario.
        """
        for part in sorted(self._full | set(self._open)):
            if part in self._full:
                yield from pq.read_table(self._path("results", part)).to_pylist()
            else:
                lines = self._open[part]
                yield from (json.loads(lines[key])[0] for key in sorted(lines))

    def _part(self, flight: int) -> int:
        return flight // self._per_part

    def _flights(self, part: int) -> range:
        first = part * self._per_part
        return range(first, min(first + self._per_part, self.plan.flights))

    def _is_full(self, part: int) -> bool:
        rows = self._open.get(part, {})
        return len(rows) == len(self._flights(part)) * len(self.plan.arms) > 0

    def _path(self, kind: str, part: int) -> Path:
        return self.folder / kind / f"part-{part:05d}.parquet"

    # --- writing --------------------------------------------------------------------------

    def add(self, finished: Finished) -> dict[str, Any]:
        """Append a finished flight to the journal, and return its result row."""
        row = row_of(self.plan, finished)
        line = _journal_line((row, finished.timing()))
        self._append(line + "\n")
        part = self._part(finished.flight)
        self._open.setdefault(part, {})[finished.flight, finished.arm] = line
        if self._is_full(part):
            self._write_part(part)
        return row

    def _append(self, line: str) -> None:
        assert self._journal is not None
        try:
            self._journal.write(line)
            self._journal.flush()
            if time.monotonic() - self._synced > _FSYNC_INTERVAL_S:
                os.fsync(self._journal.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise OSError(error.errno, error.strerror, self._journal.name) from error

    def _write_part(self, part: int) -> None:
        """Write the Parquet part with a number from its rows in memory.

        If the part is complete, its rows are removed from the journal.
        """
        lines = [self._open[part][key] for key in sorted(self._open[part])]
        self._drop_digests(part)
        if not lines:
            for kind in ("results", "timing"):
                self._path(kind, part).unlink(missing_ok=True)
            return
        for kind, schema, column in (("timing", TIMING, 1), ("results", self._schema, 0)):
            table = _column_table(lines, column, schema)
            atomic_write(self._path(kind, part), lambda p, t=table: _write_table(t, p))  # type: ignore[misc]
            data = self._path(kind, part).read_bytes()
            self._parts()[self._name(kind, part)] = bytes_digest(data)
        if self._is_full(part):
            self.save_manifest()
            del self._open[part]
            self._full.add(part)
            self._write_journal()

    def _write_journal(self) -> None:
        """Rewrite the journal with only the rows of incomplete Parquet parts."""
        path = self.folder / "journal.jsonl"
        lines = [line for part in sorted(self._open) for line in self._open[part].values()]
        text = "".join(f"{line}\n" for line in lines)
        atomic_write_text(path, text)
        if self._journal is not None:
            self._journal.close()
            self._journal = path.open("a", encoding="utf-8")

    def truncate(self, flights: int) -> None:
        """Delete the results of flights with index `flights` or more, after an early stop."""
        self.manifest["flights"] = flights
        for part in sorted(self._full | set(self._open)):
            if self._flights(part).stop <= flights:
                continue
            if part in self._full:
                self._reopen(part)
            self._open[part] = {k: row for k, row in self._open[part].items() if k[0] < flights}

    def delete_rows(self, rows: Set[tuple[int, int]]) -> None:
        """Delete results, given by pairs of flight and arm index, from memory and disk.

        An arm is a variant of the scenario.
        """
        for part in sorted(self._full | set(self._open)):
            first, last = self._flights(part).start, self._flights(part).stop
            gone = {(flight, arm) for flight, arm in rows if first <= flight < last}
            if part in self._full and gone:
                self._reopen(part)
            known = self._open.get(part, {})
            if gone & set(known):
                self._open[part] = {key: line for key, line in known.items() if key not in gone}
                self._write_part(part)
        self._write_journal()

    def save_manifest(self, **values: Any) -> None:
        """Set values of the manifest by key, and write the manifest to the folder."""
        self.manifest |= values
        text = json.dumps(with_digest(self.manifest), indent=1) + "\n"
        atomic_write_text(self.folder / "manifest.json", text)

    def close(self, state: str) -> None:
        """Write all results to Parquet parts, record the campaign's state, and unlock."""
        try:
            for part in sorted(self._open):
                self._write_part(part)
            # Rows of incomplete parts are in the journal too; the parts alone are kept.
            self._open.clear()
            self._write_journal()
            self.save_manifest(state=state, rows=self._rows_written())
        finally:
            self._release()

    def release(self) -> None:
        """Unlock the folder without further writing, for instance after an error.

        Finished flights are already in the journal or in Parquet parts.
        """
        self._release()

    def _rows_written(self) -> int:
        files = (self.folder / "results").glob("part-*.parquet")
        return sum(pq.read_metadata(path).num_rows for path in files)

    def _release(self) -> None:
        if self._journal is not None:
            # Data that could not be written is still in the buffer; closing would fail again.
            with contextlib.suppress(OSError):
                self._journal.close()
            self._journal = None
        self._lock.close()


def _check_types(row: Any, timing: Any, schema: pa.Schema) -> None:
    """Raise `ValueError` or an Arrow error if values do not fit their columns."""
    pa.Table.from_pylist([row], schema)
    pa.Table.from_pylist([timing], TIMING)


def _journal_line(row: Row) -> str:
    """Return a result row and its times as a JSON line of the journal."""
    return json.dumps(list(row))


def _column_table(lines: list[str], column: int, schema: pa.Schema) -> pa.Table:
    """Return the results (column 0) or times (column 1) in journal lines as a table.

    The lines are converted in batches, which limits memory.
    """
    tables = [
        pa.Table.from_pylist(
            [json.loads(line)[column] for line in lines[at : at + _ROWS_PER_BATCH]], schema
        )
        for at in range(0, len(lines), _ROWS_PER_BATCH)
    ]
    return pa.concat_tables(tables).combine_chunks()


def _write_table(table: pa.Table, path: Path) -> None:
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def _lock_folder(folder: Path) -> IO[str]:
    """Lock a campaign folder for writing; return the open lock file.

    The lock ends when the file is closed or the process ends. `InputError` is raised if another
    process holds the lock.
    """
    lock = (folder / ".lock").open("a", encoding="utf-8")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise InputError(
            "--out", str(folder), "must not be a folder to which another process is writing"
        ) from None
    return lock
