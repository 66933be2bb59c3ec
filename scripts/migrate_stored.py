"""Rename keys and events in stored files of earlier versions.

Numbers stay the same, byte for byte. Surrogates (.npz), scenario calibrations (.json), folders of
flights and scenario files are changed in place. Campaigns are not: their columns have other names
now, and they cannot be resumed.

Run as `python scripts/migrate_stored.py PATH ...`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from golden_parts.names import current_json

from lunarsim.atomic_files import atomic_write_arrays, atomic_write_text
from lunarsim.errors import InputError
from lunarsim.scenario.renamed_keys import current_path
from lunarsim.scenario.upgrade import upgrade_file
from lunarsim.untrusted_files import read_arrays

ARRAYS = {"claimed": "reported_velocity_sigma"}
# Path of a scenario table for each table that a surrogate was fitted to.
FITTED_TO = {
    "expected_rocks": "expected_rocks",
    "mapper": "mappers.NAME",
    "sensor": "sensors.NAME",
    "tasking": "tasking.NAME",
}


def migrate(path: Path) -> bool:
    """Rename old keys and events in a stored file or folder of a flight.

    Returns whether anything changed.
    """
    if path.is_dir():
        scenario = path / "scenario.toml"
        changed = scenario.is_file() and bool(upgrade_file(scenario))
        return migrate(path / "flight.json") or changed
    if path.suffix == ".toml":
        return bool(upgrade_file(path))
    if path.suffix == ".npz":
        return _migrate_arrays(path)
    old = json.loads(path.read_text(encoding="utf-8"))
    new = current_json(old)
    if new == old:
        return False
    atomic_write_text(path, json.dumps(new, indent=1))
    return True


def _migrate_arrays(path: Path) -> bool:
    """Rename old arrays and scenario keys in an .npz file; return whether any changed."""
    held = {name: np.asarray(value) for name, value in read_arrays(path).items()}
    new = {ARRAYS.get(name, name): value for name, value in held.items()}
    if "made_for" in held:
        tables = json.loads(str(held["made_for"]))
        current = {
            name: {_key(FITTED_TO[name], key): value for key, value in table.items()}
            for name, table in tables.items()
        }
        new["made_for"] = np.asarray(json.dumps(current, sort_keys=True))
    if all(name in held and np.array_equal(held[name], new[name]) for name in new):
        return False
    atomic_write_arrays(path, new)
    return True


def _key(table: str, key: str) -> str:
    """Return the current name of a key of a scenario table."""
    return current_path(f"{table}.{key}").rpartition(".")[2]


def main() -> None:
    """Migrate the files and folders of the command line."""
    for name in sys.argv[1:]:
        try:
            print(f"{name}: {'renamed' if migrate(Path(name)) else 'nothing to rename'}")
        except (InputError, OSError, ValueError) as error:
            sys.exit(f"error: {name}: {error}")


if __name__ == "__main__":
    main()
