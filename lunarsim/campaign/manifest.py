"""The manifest of a campaign's folder: what is flown there, by which code, and how far it is."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

import lunarsim
from lunarsim.campaign.files import bytes_digest, code_digest, differing, environment
from lunarsim.campaign.plan import MAX_FLIGHTS, Plan
from lunarsim.campaign.rows import KINDS, schema_of
from lunarsim.errors import InputError, check_folder
from lunarsim.json_files import read_json
from lunarsim.received_folders import bounded_bytes, check_contents

FORMAT = 1
_Kind = Literal[*KINDS]  # type: ignore[valid-type]


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")


# A terminal that shows a name must not take parts of it as commands.
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
            raise ValueError("seed and flights are missing")
        if self.method == "importance" and self.importance is None:
            raise ValueError("importance is missing")
        return self


class _Manifest(_Strict):
    """What readers need of a manifest, in strict types."""

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
                raise ValueError(f"{what} {twice[0]!r} is there twice")
        for key in self.identity.dispersions:
            if key not in self.inputs:
                raise ValueError(f"no column holds the draws of {key!r}")
        return self


# Besides the identity, what stays the same as long as a campaign flies.
_FIXED = ("name", "seed", "arms", "columns", "inputs")


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
        check_contents(folder)
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
    planned = json.loads(json.dumps(new_manifest(plan)))
    there, here = ({key: tables[key] for key in _FIXED} for tables in (manifest, planned))
    difference = first_difference(manifest["identity"], planned["identity"]) or first_difference(
        there, here
    )
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
    for line in bounded_bytes(journal).split(b"\n") if journal.exists() else []:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            last = max(last, int(json.loads(line)[0]["flight"]))
    return last


def with_digest(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with the digest of all its other values.

    It finds damage, not forgery: whoever changes a value can compute the digest again.
    """
    values = {key: value for key, value in manifest.items() if key != "digest"}
    text = json.dumps(json.loads(json.dumps(values)), sort_keys=True)
    return values | {"digest": bytes_digest(text.encode())}


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a campaign's folder, without its digest.

    Raises
    ------
    InputError
        If there is none, it cannot be read, or its values do not have the digest that it states.
    """
    path = folder / "manifest.json"
    if not path.is_file():
        raise InputError("folder", str(folder), "the folder of a campaign, with manifest.json")
    check_contents(folder)
    try:
        data: dict[str, Any] = read_json(path)
        _Manifest.model_validate(data)
        # Versions before the digest wrote none.
        if data.pop("digest", None) not in (None, with_digest(data)["digest"]):
            raise ValueError("its values do not have the digest that it states")
    except ValidationError as error:
        raise _damaged(folder, _reason(error)) from None
    except ValueError as error:
        raise _damaged(folder, str(error)) from None
    return data


def _reason(error: ValidationError) -> str:
    """Return the first fault of a manifest in words."""
    first = error.errors()[0]
    field = ".".join(map(str, first["loc"])) or "manifest"
    if first["type"] == "literal_error":
        return f"columns of unknown kinds: {field}"
    return f"no campaign's: {field}: {first['msg']}"


def _damaged(folder: Path, reason: str) -> InputError:
    return InputError(
        "folder", str(folder),
        f"a manifest.json in order ({reason[:100]}). Restore it from a copy, or use a new folder",
    )  # fmt: skip


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
        "parts": {},
        "environment": environment(),
        "identity": json.loads(json.dumps(plan.identity)),
    }
