"""The manifest of a campaign's folder: what is flown there, by which code, and how far it is."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

import lunarsim
from lunarsim.campaign.files import code_digest, differing, environment
from lunarsim.campaign.plan import Plan
from lunarsim.campaign.rows import KINDS
from lunarsim.errors import InputError, check_folder

FORMAT = 1
# Of a manifest, what readers need.
_NEEDED = (
    "format",
    "name",
    "seed",
    "flights",
    "arms",
    "columns",
    "inputs",
    "state",
    "rows",
    "identity",
)


def manifest_of(folder: Path, plan: Plan) -> dict[str, Any] | None:
    """Return the manifest of a folder of the same campaign; None for a new or empty folder.

    Raises
    ------
    InputError
        If it is anything else.
    """
    if not (folder / "manifest.json").exists():
        # A writer that was killed before its manifest leaves its lock and a part of a file.
        check_folder(folder, hidden=False)
        return None
    manifest = read_manifest(folder)
    for key, ours in (("format", FORMAT), ("version", lunarsim.__version__),
                      ("code", code_digest())):  # fmt: skip
        if manifest.get(key) != ours:
            raise InputError(
                "--out", str(folder),
                f"a new folder: this one was flown with {key} {manifest.get(key)}, this is {ours}",
            )  # fmt: skip
    _check_packages(folder, manifest)
    if plan.flights < int(manifest["flights"]):
        last = _last_flight(folder)
        if last >= plan.flights:
            raise InputError(
                "flights", plan.flights,
                f"at least {last + 1}, as {folder} has so many already, or a new folder",
            )  # fmt: skip
    difference = first_difference(manifest["identity"], json.loads(json.dumps(plan.identity)))
    if difference is not None:
        key, old, new = difference
        raise InputError(
            "--out", str(folder),
            f"a new folder, or the spec it was begun with: {key} was {old!r} there, is {new!r} now",
        )  # fmt: skip
    return manifest


def _check_packages(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse other packages, or another kind of machine: they may give other results."""
    before, now = manifest.get("environment", {}), environment()
    other = differing(before, now)
    if not other:
        return
    told = [f"{n} {before.get(n, 'none')} there, {now.get(n, 'none')} here" for n in other]
    pins = [f"{n}=={before[n]}" for n in other if n in before and n != "platform"]
    install = f", or `pip install {' '.join(pins)}` first" if pins else ""
    raise InputError(
        "--out", str(folder), f"a new folder{install}: it was flown with {'; '.join(told)}"
    )


def _last_flight(folder: Path) -> int:
    """Return the greatest index that a folder has a row of; -1 for none."""
    last = -1
    for path in (folder / "results").glob("part-*.parquet"):
        with contextlib.suppress(pa.ArrowException, OSError):
            flights = pq.read_table(path, columns=["flight"])["flight"].to_numpy()
            last = max(last, int(flights.max(initial=-1)))
    journal = folder / "journal.jsonl"
    for line in journal.read_bytes().split(b"\n") if journal.exists() else []:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            last = max(last, int(json.loads(line)[0]["flight"]))
    return last


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a campaign's folder.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.
    """
    path = folder / "manifest.json"
    if not path.is_file():
        raise InputError("folder", str(folder), "the folder of a campaign, with manifest.json")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or set(_NEEDED) - set(data):
            raise ValueError("no campaign's")
        unknown = {*data["inputs"].values(), *data["columns"].values()} - set(KINDS)
        if unknown:
            raise ValueError(f"columns of unknown kinds: {sorted(unknown)}")
    except ValueError as error:
        raise InputError("folder", str(folder), f"a manifest.json in order ({error})") from None
    return data


def first_difference(a: Any, b: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """Return key and both values of the first difference of two tables, None if they are equal."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            found = first_difference(a.get(key), b.get(key), f"{path}.{key}" if path else str(key))
            if found is not None:
                return found
        return None
    return None if a == b else (path, a, b)


def new_manifest(plan: Plan) -> dict[str, Any]:
    """Return the manifest of a campaign of which nothing has been flown."""
    return {
        "format": FORMAT,
        "version": lunarsim.__version__,
        "code": code_digest(),
        "name": plan.name,
        "seed": plan.seed,
        "flights": plan.flights,
        "arms": [{"name": name, "values": dict(values)} for name, values in plan.arms],
        "columns": dict(plan.columns),
        "inputs": dict(plan.inputs),
        "state": "running",
        "rows": 0,
        "environment": environment(),
        "identity": json.loads(json.dumps(plan.identity)),
    }
