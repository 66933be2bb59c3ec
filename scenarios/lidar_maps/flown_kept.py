"""Flights of the comparison kept one by one in a folder: a study that was cut off goes on.

A file is of one flight and says by what code it was flown; flights of other code are refused, not
mixed in.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import flown
import numpy as np
from flown import Flown, Judged, Mapped, Task

from lunarsim.campaign.files import code_digest, write_json


def flown_or_kept(folder: Path, task: Task) -> Flown:
    """Return a flight from the folder; fly it and keep it where it is not there.

    Raises
    ------
    click.ClickException
        If the file is of another code or scenario, or no flight at all.
    """
    file = folder / f"{_plain(task.world)}-seed{task.seed}-{task.flight:04d}.json"
    if file.exists():
        return _loaded(file, task)
    made = flown.fly(task)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(file, {"code": code_of(task.world), "task": asdict(task), **_tables(made)})
    return made


def code_of(world: str) -> str:
    """Return a digest of what a world's flights come from: package, study and scenario."""
    scenario = json.dumps(flown.scenario_of(world).to_dict(), default=str)
    study = Path(flown.__file__).read_bytes()
    return hashlib.sha256(code_digest().encode() + study + scenario.encode()).hexdigest()[:16]


def _plain(world: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in world)


def _tables(made: Flown) -> dict[str, Any]:
    """Return a flight as nested tables that JSON holds exactly."""
    return json.loads(json.dumps(asdict(made), default=np.ndarray.tolist))  # type: ignore[no-any-return]


def _loaded(file: Path, task: Task) -> Flown:
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        if (kept["code"], kept["task"]) != (code_of(task.world), asdict(task)):
            raise click.ClickException(
                f"{file} was flown by other code or over another scenario: delete its folder, or "
                "name another with --out"
            )
        return Flown(kept["rows"], {name: _mapped(m) for name, m in kept["maps"].items()})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise click.ClickException(f"{file} is no kept flight ({error}): delete it") from None


def _mapped(kept: dict[str, Any]) -> Mapped:
    ends = [_judged(kept[moment]) for moment in ("first", "last")]
    return Mapped(*ends, seconds=kept["seconds"], megabytes=kept["megabytes"])


def _judged(kept: dict[str, Any] | None) -> Judged | None:
    return Judged(**{name: np.array(v) for name, v in kept.items()}) if kept else None
