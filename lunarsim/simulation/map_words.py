"""What a map that tells nothing must be said of: it saw nothing, or it calls everything safe."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.simulation.map_record import MapRecord

# A map on which nothing is less safe than this calls all of it safe.
_SAFE = 0.5


def map_words(hazard_map: HazardMap | None) -> str | None:
    """Return a sentence on a map that tells one place from another nowhere, else None.

    Parameters
    ----------
    hazard_map
        As recorded; None where nothing was ever drawn.
    """
    if hazard_map is None or not hazard_map.observed.any():
        return "saw nothing: no cell of it was observed"
    seen = hazard_map.p_safe[hazard_map.observed]
    low, high = float(np.min(seen)), float(np.max(seen))
    words = None
    if low > _SAFE:
        words = f"calls everything that it saw safe: p_safe {low:.2f} to {high:.2f}"
    elif high <= _SAFE:
        words = f"calls nothing that it saw safe: p_safe {low:.2f} to {high:.2f}"
    elif hazard_map.in_domain is not None and not hazard_map.in_domain[hazard_map.observed].any():
        words = "is outside of what it was calibrated for"
    if words is None or hazard_map.in_domain is None:
        return words
    if not hazard_map.in_domain[hazard_map.observed].any() and "calibrated" not in words:
        words += ", outside of what it was calibrated for"
    return words


def words_on_maps(maps: Mapping[str, MapRecord], decided_on: str) -> dict[str, str]:
    """Return by mapper what is noteworthy about a flight's maps.

    Parameters
    ----------
    maps
        Last map of each mapper.
    decided_on
        Mapper whose map the policy used; it is reported even without a map. Empty: none.
    """
    names = dict.fromkeys([*maps, *([decided_on] if decided_on else [])])
    found: dict[str, str] = {}
    for name in names:
        record = maps.get(name)
        words = map_words(None if record is None else record.hazard_map)
        rocks = None if record is None else record.tables.get("rocks")
        if words is not None and rocks is not None:
            words += f", {len(rocks['x'])} rocks tracked"
        if words is not None:
            found[name] = words
    return found
