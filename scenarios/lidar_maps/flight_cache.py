"""Save the flights of the mapper comparison so that a study can resume.

Each file holds one flight and a digest of the code that computed it. Flights of other code are
rejected.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import mapper_flights
import numpy as np
from mapper_flights import MapEvaluation, MapperFlight, MapperFlightTask, MapperRecord

from lunarsim.campaign.files import code_digest, write_json


def load_or_fly(folder: Path, task: MapperFlightTask) -> MapperFlight:
    """Return a stored flight; if it is not in the folder, simulate and save it.

    Raises
    ------
    click.ClickException
        If the file has another code or scenario digest, or is not a flight.
    """
    file = folder / f"{_file_name(task.world)}-seed{task.seed}-{task.flight:04d}.json"
    if file.exists():
        return _load(file, task)
    made = mapper_flights.fly(task)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(file, {"code": code_of(task.world), "task": asdict(task), **_flight_to_json(made)})
    return made


def code_of(world: str) -> str:
    """Return a digest of the source code and of the scenario of a terrain.

    `world` is a name in `mapper_flights.WORLDS`.
    """
    scenario = json.dumps(mapper_flights.scenario_of(world).to_dict(), default=str)
    study = Path(mapper_flights.__file__).read_bytes()
    return hashlib.sha256(code_digest().encode() + study + scenario.encode()).hexdigest()[:16]


def _file_name(world: str) -> str:
    """Return a terrain name with "_" for all characters except letters and digits."""
    return "".join(c if c.isalnum() else "_" for c in world)


def _flight_to_json(flight: MapperFlight) -> dict[str, Any]:
    """Return a flight as nested dictionaries and lists for exact storage in JSON."""
    return json.loads(json.dumps(asdict(flight), default=np.ndarray.tolist))  # type: ignore[no-any-return]


def _load(file: Path, task: MapperFlightTask) -> MapperFlight:
    """Read a stored flight and check that its code and settings are current."""
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        if (kept["code"], kept["task"]) != (code_of(task.world), asdict(task)):
            raise click.ClickException(
                f"{file} was computed with different code or another scenario. Delete its folder "
                f"or "
                "choose another one with --out."
            )
        return MapperFlight(
            kept["rows"], {name: _mapper_record(m) for name, m in kept["maps"].items()}
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise click.ClickException(f"{file} is not a saved flight ({error}). Delete it.") from None


def _mapper_record(stored: dict[str, Any]) -> MapperRecord:
    """Convert the stored results of one mapper from JSON."""
    ends = [_map_evaluation(stored[moment]) for moment in ("first", "last")]
    return MapperRecord(*ends, seconds=stored["seconds"], megabytes=stored["megabytes"])


def _map_evaluation(stored: dict[str, Any] | None) -> MapEvaluation | None:
    """Convert a stored map evaluation from JSON; None if there is none."""
    return MapEvaluation(**{name: np.array(v) for name, v in stored.items()}) if stored else None
