"""Keep the results of a study in a folder: a journal, then one JSON file."""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import shlex
import subprocess
import sys
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lunarsim
from lunarsim.atomic_files import atomic_write_text
from lunarsim.campaign.provenance import bytes_digest, code_digest, environment
from lunarsim.errors import InputError, error_reason

JOURNAL = "journal.jsonl"
RESULTS = "results.json"
# Minimum time between two fsyncs of the journal, s: a fsync can take longer than a short case, and
# only a failure of the power can lose what was written since.
_FSYNC_INTERVAL_S = 1.0


def provenance(name: str, script: Path, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the command, code, machine and options behind the results of a study.

    `name` is the study, `script` its file and `options` the values of its options.
    """
    return {
        "study": name,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "version": lunarsim.__version__,
        "code": code_digest(),
        "script": script_digest(script),
        "commit": _commit(script),
        "machine": environment(),
        "options": plain(options),
    }


def script_digest(script: Path) -> str:
    """Return a digest of a script and of the files in its folder that it imports."""
    files, waiting = set(), [script]
    while waiting:
        file = waiting.pop()
        files.add(file)
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            named = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            named += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            beside = {script.with_name(f"{name}.py") for name in named if name.isidentifier()}
            waiting += [f for f in beside - files if f.is_file()]
    return bytes_digest(b"".join(file.read_bytes() for file in sorted(files)))[:12]


def _commit(script: Path) -> str:
    """Return the commit of the checkout that holds a script; empty outside a checkout."""
    command = ["git", "-C", str(script.parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10.0)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def _text(data: Any, **style: Any) -> str:
    """Return data as JSON; arrays become lists, and NumPy numbers become numbers."""

    def convert(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if isinstance(value, Path):
            return str(value)
        raise TypeError(f"rows must hold numbers, texts and lists, got {type(value).__name__}")

    return json.dumps(data, default=convert, **style)


def plain(data: Any) -> Any:
    """Return data as they are read back from a file."""
    return json.loads(_text(data))


class Journal:
    """Rows of finished cases in a folder, so that an interrupted study can continue.

    Parameters
    ----------
    folder
        Folder of the study, or None to keep nothing.
    identity
        What must be equal for the journal to be continued.

    Raises
    ------
    InputError
        If the folder holds the results of another study or of other options.
    """

    def __init__(self, folder: Path | None, identity: Mapping[str, Any]) -> None:
        self._path = None if folder is None else folder / JOURNAL
        self._synced = time.monotonic()
        self.finished: dict[int, list[dict[str, Any]]] = {}
        if folder is None or self._path is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        same = plain(identity)
        if self._path.exists():
            header, *lines = self._path.read_text(encoding="utf-8").split("\n")
            if _line(header) != same:
                raise InputError(
                    "--out", str(folder),
                    "holds results of another study, version, machine or options",
                    "Use a new folder.",
                )  # fmt: skip
            for entry in map(_line, lines):
                if isinstance(entry, list) and len(entry) == 2:
                    self.finished[entry[0]] = entry[1]
        elif any(folder.iterdir()):
            raise InputError(
                "--out", str(folder), "must be a new or empty folder, or hold this study",
                "Use a new folder.",
            )  # fmt: skip
        # A process that was killed can leave an incomplete last line.
        lines = [_text([index, rows]) for index, rows in self.finished.items()]
        atomic_write_text(self._path, "\n".join([_text(same), *lines]) + "\n")

    def add(self, index: int, rows: Any) -> None:
        """Keep the rows of one finished case, by its index."""
        self.finished[index] = plain(rows)
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(_text([index, rows]) + "\n")
                file.flush()
                if time.monotonic() - self._synced > _FSYNC_INTERVAL_S:
                    os.fsync(file.fileno())
                    self._synced = time.monotonic()


def _line(text: str) -> Any:
    """Return one line of a journal; None if it is incomplete."""
    try:
        return json.loads(text)
    except ValueError:
        return None


def write_results(folder: Path, results: Mapping[str, Any]) -> None:
    """Write all results of a study to one JSON file atomically."""
    atomic_write_text(folder / RESULTS, _text(results, indent=1) + "\n")


def read_results(folder: Path, name: str) -> dict[str, Any]:
    """Return the results of a study in a folder.

    Raises
    ------
    InputError
        If the folder has no readable results of the study `name`.
    """
    path = folder / RESULTS
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if found["study"] != name or not isinstance(found["rows"], list):
            raise ValueError(f"it holds the study {found['study']}")
        int(found["options"]["seed"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InputError(
            "folder", str(folder),
            f"must hold {RESULTS} of the study {name} ({error_reason(error)})",
            "Run the study with --out.",
        ) from None  # fmt: skip
    return found


def pack_array(array: NDArray[Any]) -> str:
    """Return an array of numbers or booleans as compressed text, for a row of a study."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return base64.b64encode(zlib.compress(file.getvalue())).decode("ascii")


def unpack_array(text: str) -> NDArray[Any]:
    """Return the array in a text of `pack_array`, with equal values and type."""
    data = zlib.decompress(base64.b64decode(text))
    return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))
