"""Describe recorded hazard maps that do not help to select a site."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.simulation.map_record import MapRecord

# Threshold of p_safe: if all cells are above it, the map classifies everything safe.
_SAFE_THRESHOLD = 0.5


def map_remark(hazard_map: HazardMap | None) -> str | None:
    """Return a remark if a hazard map does not help to select a site, else None.

    It does not help if it has no observed cell, if it classifies all or none of the observed
    terrain safe, or if it is outside its calibrated domain.

    Parameters
    ----------
    hazard_map
        Hazard map from the record of a flight; None if no map was generated.
    """
    if hazard_map is None or not hazard_map.observed.any():
        return "observed nothing: it has no observed cell"
    seen = hazard_map.p_safe[hazard_map.observed]
    low, high = float(np.min(seen)), float(np.max(seen))
    words = None
    if low > _SAFE_THRESHOLD:
        words = f"classifies all observed terrain safe: p_safe {low:.2f} to {high:.2f}"
    elif high <= _SAFE_THRESHOLD:
        words = f"classifies no observed terrain safe: p_safe {low:.2f} to {high:.2f}"
    elif hazard_map.in_domain is not None and not hazard_map.in_domain[hazard_map.observed].any():
        words = "is outside its calibrated domain"
    if words is None or hazard_map.in_domain is None:
        return words
    if not hazard_map.in_domain[hazard_map.observed].any() and "calibrated" not in words:
        words += ", outside its calibrated domain"
    return words


def map_remarks_by_mapper(maps: Mapping[str, MapRecord], decision_mapper: str) -> dict[str, str]:
    """Return remarks on uninformative hazard maps of a flight, by mapper name.

    Parameters
    ----------
    maps
        Record of the last map of each mapper, by name.
    decision_mapper
        Name of the mapper whose map the policy used, or "". If that mapper has no recorded map, the
        result has a remark on it.
    """
    names = dict.fromkeys([*maps, *([decision_mapper] if decision_mapper else [])])
    found: dict[str, str] = {}
    for name in names:
        record = maps.get(name)
        words = map_remark(None if record is None else record.hazard_map)
        rocks = None if record is None else record.tables.get("rocks")
        if words is not None and rocks is not None:
            words += f", {len(rocks['x'])} rocks tracked"
        if words is not None:
            found[name] = words
    return found
