"""Campaigns in processes that tests kill, and what is left of them."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from lunarsim.campaign.manifest import with_digest
from lunarsim.campaign.provenance import bytes_digest
from lunarsim.campaign.results import load_results
from lunarsim.errors import InputError
from tests.campaign.driver import drive
from tests.conftest import ROOT

_LOADED = ["lunarsim.campaign.run", "tests.campaign.surrogate"]


def start(at: Path, **options: object) -> subprocess.Popen[str]:
    """Start a driver, see `tests.campaign.driver`."""
    command = [sys.executable, "-m", "tests.campaign.driver", str(at), json.dumps(options)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def fly_alone(at: Path, **options: object) -> int:
    """Let a driver without workers fly to its end; return its exit code.

    It is forked from a process that has all loaded, which takes longer than the flights.
    """
    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(_LOADED)
    driver = forks.Process(target=drive, args=(at, {"jobs": 0} | options))
    driver.start()
    driver.join(60.0)
    assert driver.exitcode is not None, "it did not end"
    return driver.exitcode


def parts(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all parts of the results, by name."""
    return {p.name: p.read_bytes() for p in sorted((folder / "results").glob("*.parquet"))}


def children(process: int) -> list[int]:
    """Return the workers of a driver: its children but for the tracker of shared memory."""
    path = Path(f"/proc/{process}/task/{process}/children")
    found = [int(word) for word in path.read_text().split()] if path.exists() else []
    return [c for c in found if "spawn_main" in command_of(c)]


def command_of(process: int) -> str:
    """Return the command line of a process, empty if it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_text()
    except OSError:
        return ""


def wait_for(condition, seconds: float = 60.0):
    """Return what a condition gives as soon as that is true; fail after so many seconds."""
    until = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < until, "it never came"
        time.sleep(0.1)
    return value


def journalled(folder: Path) -> int:
    """Return the number of rows that a folder holds."""
    try:
        return len(load_results(folder, ["outcome"]).table)
    except (InputError, OSError):
        return 0


def write_part(path: Path, table: pa.Table) -> None:
    """Write another table in place of a part, and note its digest in the manifest."""
    pq.write_table(table, path)
    manifest = path.parent.parent / "manifest.json"
    data = json.loads(manifest.read_text())
    data["parts"][f"{path.parent.name}/{path.name}"] = bytes_digest(path.read_bytes())
    write_manifest(path.parent.parent, data)


def write_manifest(folder: Path, data: dict) -> None:
    """Write another manifest with the digest of its values."""
    (folder / "manifest.json").write_text(json.dumps(with_digest(data)))
