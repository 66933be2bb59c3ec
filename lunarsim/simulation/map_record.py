"""Record of a mapper's last hazard map in a flight."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.typing import Array


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
    """

    hazard_map: HazardMap
    error: Array
    tables: dict[str, dict[str, Array]] = field(default_factory=dict)

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
