"""Manifest of a campaign folder: what is flown, with which code, and its state."""

from __future__ import annotations

import contextlib
import json
import reprlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

import lunarsim
from lunarsim.campaign.plan import MAX_FLIGHTS, Plan
from lunarsim.campaign.provenance import (
    bytes_digest,
    code_digest,
    environment,
    environment_differences,
)
from lunarsim.campaign.rows import KINDS, schema_of
from lunarsim.errors import InputError, check_folder
from lunarsim.scenario.errors import plain_problem
from lunarsim.untrusted_files import check_no_links, read_bounded_bytes, read_json

FORMAT = 2
_Kind = Literal[*KINDS]  # type: ignore[valid-type]


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")


# Control characters in a name could act as commands in a terminal.
_Name = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]


class _Arm(_Strict):
    name: _Name
    values: dict[str, Any]


class _Environment(_Strict):
    __pydantic_extra__: dict[str, str] = Field(init=False)

    python: str
    platform: str


class _Importance(_Strict):
    nominal_share: float = Field(gt=0.0, le=1.0)


class _Identity(_Strict):
    method: str = ""
    seed: int | None = Field(None, ge=0)
    flights: int | None = Field(None, ge=1)
    dispersions: dict[str, Any] = {}
    importance: _Importance | None = None

    @model_validator(mode="after")
    def _has_what_its_method_needs(self) -> _Identity:
        if self.method == "subset" and (self.seed is None or self.flights is None):
            raise ValueError("the keys seed and flights are missing")
        if self.method == "importance" and self.importance is None:
            raise ValueError("the key importance is missing")
        return self


class _Manifest(_Strict):
    """Fields of ``manifest.json`` that readers need, with strict types."""

    format: int
    name: _Name
    seed: int = Field(ge=0)
    flights: int = Field(ge=0, le=MAX_FLIGHTS)
    arms: list[_Arm]
    columns: dict[str, _Kind]
    inputs: dict[str, _Kind]
    state: str
    rows: int = Field(ge=0)
    version: str
    code: str
    environment: _Environment
    identity: _Identity
    parts: dict[str, str] = {}
    digest: str = ""

    @model_validator(mode="after")
    def _names_fit(self) -> _Manifest:
        arms = [arm.name for arm in self.arms]
        columns = schema_of(self.inputs, self.columns).names
        for what, names in (("arm", arms), ("column", columns)):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise ValueError(f"{what} {twice[0]!r} occurs twice")
        for key in self.identity.dispersions:
            if key not in self.inputs:
                raise ValueError(f"the dispersed key {key!r} has no column of values")
        return self


# Fields that must not change when a campaign is resumed, in addition to the identity.
_FIXED_FIELDS = ("name", "seed", "arms", "columns", "inputs")


def matching_manifest(folder: Path, plan: Plan) -> dict[str, Any] | None:
    """Return the manifest in a folder if it belongs to the planned campaign.

    Return None if the folder is new or empty.

    Raises
    ------
    InputError
        If the folder holds another campaign or other files.
    """
    if not (folder / "manifest.json").exists():
        # A writer killed before its manifest leaves a lock and a temporary file.
        check_folder(folder, hidden=False)
        check_no_links(folder)
        return None
    manifest = read_manifest(folder)
    for key, ours in (("format", FORMAT), ("version", lunarsim.__version__),
                      ("code", code_digest())):  # fmt: skip
        if manifest.get(key) != ours:
            raise InputError(
                "--out", str(folder),
                f"contains flights of another version of lunarsim ({key}: {manifest.get(key)} in "
                f"the folder, {ours} installed)",
                "Use a new folder.",
            )  # fmt: skip
    _check_packages(folder, manifest)
    if plan.flights < int(manifest["flights"]):
        last = _last_flight(folder)
        if last >= plan.flights:
            raise InputError(
                "flights", plan.flights,
                f"must be {last + 1} or more, because {folder} already has {last + 1} flights",
                "Increase flights, or use a new folder.",
            )  # fmt: skip
    planned = json.loads(json.dumps(new_manifest(plan)))
    there, here = ({key: tables[key] for key in _FIXED_FIELDS} for tables in (manifest, planned))
    difference = first_difference(manifest["identity"], planned["identity"]) or first_difference(
        there, here
    )
    if difference is not None:
        key, old, new = difference
        raise InputError(
            "--out", str(folder),
            f"contains another campaign ({key}: {_shown(old)} in the folder, {_shown(new)} in this "
            "campaign)", "Use a new folder, or the campaign file of that folder.",
            show_value=False,
        )  # fmt: skip
    return manifest


def _check_packages(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Raise `InputError` if a campaign was flown with other packages or platform."""
    before, now = manifest.get("environment", {}), environment()
    other = environment_differences(before, now)
    if not other:
        return
    differences = [
        f"{n}: {before.get(n, 'none')} in the folder, {now.get(n, 'none')} installed" for n in other
    ]
    pins = [f"{n}=={before[n]}" for n in other if n in before and n != "platform"]
    install = f", or first run: pip install {' '.join(pins)}" if pins else ""
    raise InputError(
        "--out", str(folder), f"was flown with other packages ({'; '.join(differences)})",
        f"Use a new folder{install}.",
    )  # fmt: skip


def _last_flight(folder: Path) -> int:
    """Return the maximum flight index with a result in a folder; -1 if there is none."""
    last = -1
    for path in (folder / "results").glob("part-*.parquet"):
        with contextlib.suppress(pa.ArrowException, OSError):
            flights = pq.read_table(path, columns=["flight"])["flight"].to_numpy()
            last = max(last, int(flights.max(initial=-1)))
    journal = folder / "journal.jsonl"
    for line in read_bounded_bytes(journal).split(b"\n") if journal.exists() else []:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            last = max(last, int(json.loads(line)[0]["flight"]))
    return last


def with_digest(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with the digest of all its other values.

    The digest detects damage, not forgery, because anyone can compute it.
    """
    values = {key: value for key, value in manifest.items() if key != "digest"}
    text = json.dumps(json.loads(json.dumps(values)), sort_keys=True)
    return values | {"digest": bytes_digest(text.encode())}


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a campaign folder, without its digest.

    Raises
    ------
    InputError
        If the manifest is missing or unreadable, or its values do not match its digest.
    """
    path = folder / "manifest.json"
    if not path.is_file():
        raise InputError(
            "folder", str(folder), "must be the folder of a campaign, which contains manifest.json"
        )
    check_no_links(folder)
    try:
        data: dict[str, Any] = read_json(path)
        _Manifest.model_validate(data)
        # Older versions wrote no digest.
        if data.pop("digest", None) not in (None, with_digest(data)["digest"]):
            raise ValueError("its digest does not match its values")
    except ValidationError as error:
        raise _damaged(folder, _reason(error)) from None
    except ValueError as error:
        raise _damaged(folder, str(error)) from None
    return data


def _reason(error: ValidationError) -> str:
    """Describe the first validation error of a manifest as text."""
    first = error.errors()[0]
    field = ".".join(map(str, first["loc"]))
    if first["type"] == "literal_error":
        return f"{field}: unknown type of column"
    if first["type"] == "string_pattern_mismatch":
        return f"{field}: must not contain control characters"
    return f"{field}: {plain_problem(first)}" if field else plain_problem(first)


def _damaged(folder: Path, reason: str) -> InputError:
    return InputError(
        "folder", str(folder), f"contains a damaged manifest.json ({reason[:100]})",
        "Restore manifest.json from a copy, or repeat the campaign in a new folder.",
    )  # fmt: skip


def _shown(value: Any) -> str:
    """Return the text of a manifest value, shortened if it is long."""
    return "not set" if value is None else reprlib.repr(value)


def first_difference(a: Any, b: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """Return key and both values of the first difference between two nested tables.

    Return None if they are equal. `path` is the prefix of the key.
    """
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            found = first_difference(a.get(key), b.get(key), f"{path}.{key}" if path else str(key))
            if found is not None:
                return found
        return None
    return None if a == b else (path, a, b)


def new_manifest(plan: Plan) -> dict[str, Any]:
    """Create the manifest of a new campaign, before its first flight."""
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
        "parts": {},
        "environment": environment(),
        "identity": json.loads(json.dumps(plan.identity)),
    }
