"""Record of a mapper's last hazard map in a flight, and remarks on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.typing import Array

# Threshold of p_safe: if all cells are above it, the map classifies everything safe.
_SAFE_THRESHOLD = 0.5


@dataclass(frozen=True)
class MapRecord:
    """Record of the last hazard map of one mapper in a flight.

    Attributes
    ----------
    hazard_map
        Map in the local frame, with 16 significant bits.
    error
        Local minus true coordinates when the map was last updated (3,), m. Subtract it to get the
        true frame.
    tables
        Other data of the mapper in the local frame, for instance tracked rocks: columns (n,) by
        name, for each table name.
    time
        Time when the map was last updated, s; None in records of earlier versions.
    """

    hazard_map: HazardMap
    error: Array
    tables: dict[str, dict[str, Array]] = field(default_factory=dict)
    time: float | None = None

    def __post_init__(self) -> None:
        m = self.hazard_map
        rounded = replace(
            m,
            p_safe=_round_layer(m.p_safe),
            elevation=None if m.elevation is None else _round_layer(m.elevation),
            variance=None if m.variance is None else _round_layer(m.variance),
            value=None if m.value is None else _round_layer(m.value),
        )
        object.__setattr__(self, "hazard_map", rounded)


def _round_layer(layer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Round a map layer to 16 significant bits, which compress much better.

    The rounding error of a value is at most 2 mm below 256 m, and at most 8 mm below 1 km.
    """
    bits = np.ascontiguousarray(layer, dtype=np.float32).view(np.uint32)
    rounded = (bits + np.uint32(0x80)) & np.uint32(0xFFFFFF00)
    return np.asarray(np.where(np.isfinite(layer), rounded, bits).view(np.float32))


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
