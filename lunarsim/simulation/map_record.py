"""Record of a mapper's last hazard map in a flight."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MapRecord:
    """The last map of one mapper.

    Attributes
    ----------
    hazard_map
        In the local frame, to 16 significant bits.
    error
        Local less true coordinates when it was last drawn (3,), m: subtract it for the true frame.
    tables
        What else the mapper keeps: name to columns (n,), local frame.
    """

    hazard_map: HazardMap
    error: Array
    tables: dict[str, dict[str, Array]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        m = self.hazard_map
        rounded = replace(
            m,
            p_safe=_rounded(m.p_safe),
            elevation=None if m.elevation is None else _rounded(m.elevation),
            variance=None if m.variance is None else _rounded(m.variance),
            value=None if m.value is None else _rounded(m.value),
        )
        object.__setattr__(self, "hazard_map", rounded)


def _rounded(layer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a layer rounded to 16 significant bits, which packs far shorter.

    Heights within 256 m of the frame's origin are so kept to 2 mm, those within 1 km to 8 mm.
    """
    bits = np.ascontiguousarray(layer, dtype=np.float32).view(np.uint32)
    whole = (bits + np.uint32(0x80)) & np.uint32(0xFFFFFF00)
    return np.asarray(np.where(np.isfinite(layer), whole, bits).view(np.float32))
