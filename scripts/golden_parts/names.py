"""Names in results of earlier versions, and the names that replace them.

The module does not import lunarsim, because golden cases of an older revision use it too.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

EVENTS = {
    "all-safe": "no-hazard-found",
    "arrives-later": "time-to-go-extended",
    "believed": "recovered",
    "diverts-allowed": "diverts-enabled",
    "diverts-barred": "diverts-inhibited",
    "doubted": "covariance-inflated",
    "few-rocks": "too-few-rocks",
    "measured-ground-refused": "measured-terrain-rejected",
    "picture": "image",
    "picture-accepted": "image-accepted",
    "picture-refused": "image-rejected",
    "renewed": "rocks-reset",
    "samples-jumped": "samples-jump",
    "samples-refused": "samples-rejected",
    "scans-refused": "scans-rejected",
    "seeking-over": "observation-phase-ended",
    "shut-off": "beam-excluded",
    "stretch-refused": "time-scale-refused",
}
KEYS = {
    "decided_on": "decision_mapper",
    "failed": "failure_causes",
    "gap": "bias",
    "sure": "confident_sites",
    "verdict": "outcome",
}
_ROOT = Path(__file__).resolve().parent.parent.parent
_FILE = _ROOT / "lunarsim" / "scenario" / "renamed_keys.py"
_spec = importlib.util.spec_from_file_location("renamed_keys", _FILE)
assert _spec is not None and _spec.loader is not None
_renamed_keys = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_renamed_keys)
SCENARIOS: dict[str, str] = _renamed_keys.RENAMED_SCENARIOS


def current_json(value: Any) -> Any:
    """Return JSON data with renamed keys and events replaced by their current names."""
    if isinstance(value, list):
        return [current_json(one) for one in value]
    if not isinstance(value, dict):
        return value
    found = {KEYS.get(key, key): current_json(one) for key, one in value.items()}
    if {"time", "name"} <= set(found):
        found["name"] = EVENTS.get(found["name"], found["name"])
    return found


def current_values(tables: dict[str, Any], path: str = "") -> dict[str, Any]:
    """Flatten scenario tables to values by dotted key, with current names.

    `path` is the dotted key of `tables`, "" for a complete scenario.
    """
    found: dict[str, Any] = {}
    for key, value in tables.items():
        own = _renamed_keys.current_path(f"{path}.{key}" if path else key)
        if isinstance(value, dict):
            found |= current_values(value, own)
        elif isinstance(value, str):
            pattern = _renamed_keys.pattern_of(own.split("."))
            renamed = _renamed_keys.RENAMED_VALUES.get((pattern, value), value)
            found[own] = SCENARIOS.get(renamed, renamed)
        else:
            found[own] = value
    return found
