"""What an agent that chooses sites is shown: named parts, one array each.

A part of one's own is added by `register`, and named in an environment's `observation`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim_envs.named_parts import check_new, check_shape, named_parts
from lunarsim_envs.sites.sights import CROP_CELLS, MAP_CELLS, Sights

Array = NDArray[Any]
Shown = dict[str, NDArray[np.float32]]

SITES = 20  # candidate sites that an agent may choose from
# No distance (m), speed (m/s) or mass (kg) in a flight is larger: what would be is clipped.
FAR = 5000.0


@dataclass(frozen=True)
class Part:
    """One part of an observation.

    Attributes
    ----------
    name, meaning
        As documents tell them.
    shape
        Of it.
    units
        Of its last axis, or one for all.
    low, high
        Bounds, as `numpy.broadcast_to` takes them for the shape.
    of
        Returns it for all landers (n, *shape).
    """

    name: str
    shape: tuple[int, ...]
    units: tuple[str, ...]
    low: Any
    high: Any
    meaning: str
    of: Callable[[Sights], Array]

    @property
    def space(self) -> spaces.Box:
        """Of one lander."""
        low = np.broadcast_to(np.asarray(self.low, np.float32), self.shape).copy()
        high = np.broadcast_to(np.asarray(self.high, np.float32), self.shape).copy()
        return spaces.Box(low, high, self.shape, np.float32)


PARTS: dict[str, Part] = {}
# What is seen unless something else is asked for.
DEFAULT = ("estimate", "hazard_map", "sites", "to_go")


def register(part: Part) -> None:
    """Add a part.

    Raises
    ------
    InputError
        If there is one of its name, or its bounds leave no room.
    """
    check_new(part.name, PARTS)
    space = part.space
    if not part.shape or not (space.low < space.high).all():
        raise InputError(part.name, (part.shape, part.low, part.high), "a shape, and a range")
    PARTS[part.name] = part


def _estimate(s: Sights) -> Array:
    return np.concatenate((s.position - s.site, s.velocity, s.attitude), axis=1)


def _to_go(s: Sights) -> Array:
    altitude = s.position[:, 2] - s.site[:, 2]
    return np.stack((s.time_to_go, s.propellant, altitude), axis=1)


def _rows(s: Sights, columns: Sequence[Array]) -> Array:
    """Return a table of sites (n, 20, columns), zero where there is none."""
    out = np.zeros((len(s.site), SITES, len(columns)))
    n = min(SITES, s.p_safe.shape[1])
    known = np.arange(n) < s.count[:, None]
    for k, column in enumerate(columns):
        out[:, :n, k] = np.where(known, column[:, :n], 0.0)
    return out


def _away(s: Sights) -> Array:
    return s.position_of - s.site[:, None]


def _sites(s: Sights) -> Array:
    away, there = _away(s), np.isfinite(s.cost)
    cost = np.where(there, s.cost, FAR)
    return _rows(s, (away[..., 0], away[..., 1], away[..., 2], s.p_safe, cost, there))


def _candidates(s: Sights) -> Array:
    away, there = _away(s), np.isfinite(s.cost)
    stay = np.where(np.isfinite(s.here[:, 1]), s.here[:, 1], 0.0)
    more = np.where(there, s.cost - stay[:, None], FAR)
    return _rows(s, (away[..., 0], away[..., 1], s.p_safe, more, s.distance, there))


def _site(s: Sights) -> Array:
    p, cost, miss = s.here.T
    seen = np.isfinite(p)
    return np.stack((np.where(seen, p, 0.0), seen, np.minimum(cost, FAR), miss), axis=1)


def _small(s: Sights) -> Array:
    return s.small


def _crop(s: Sights) -> Array:
    return s.crop


for _part in (
    Part(
        "estimate", (10,), (*["m"] * 3, *["m/s"] * 3, *[""] * 4),
        [-FAR] * 6 + [-1.0] * 4, [FAR] * 6 + [1.0] * 4,
        "position from the present site, velocity, attitude (scalar last), as navigation "
        "estimates them, ENU", _estimate,
    ),
    Part(
        "hazard_map", (2, MAP_CELLS, MAP_CELLS), ("",), 0.0, 1.0,
        "mean probability of safety and share seen in equal blocks of the hazard map; row 0 south, "
        "column 0 west", _small,
    ),
    Part(
        "sites", (SITES, 6), ("m", "m", "m", "", "kg", ""),
        [-FAR, -FAR, -FAR, 0.0, 0.0, 0.0], [FAR, FAR, FAR, 1.0, FAR, 1.0],
        "offset from the present site east, north, up, probability of safety, propellant to reach "
        "it, 1 if available; rows without a site are zero", _sites,
    ),
    Part(
        "to_go", (3,), ("s", "kg", "m"), 0.0, FAR,
        "time-to-go, propellant left, altitude above the site", _to_go,
    ),
    Part(
        "candidates", (SITES, 6), ("m", "m", "", "kg", "m", ""),
        [-FAR, -FAR, 0.0, -FAR, 0.0, 0.0], [FAR, FAR, 1.0, FAR, FAR, 1.0],
        "offset from the present site east and north, probability of safety, propellant over that "
        "of the present site, distance, 1 if available; the rows of the actions", _candidates,
    ),
    Part(
        "site", (4,), ("", "", "kg", "m"), [0.0, 0.0, 0.0, 0.0], [1.0, 1.0, FAR, FAR],
        "of the present site: probability of safety, 1 if it has been seen, propellant to reach "
        "it, expected miss", _site,
    ),
    Part(
        "hazard_crop", (2, CROP_CELLS, CROP_CELLS), ("",), 0.0, 1.0,
        "probability of safety and 1 where seen, a metre apart about the present site; row 0 "
        "south, column 0 west", _crop,
    ),
):  # fmt: skip
    register(_part)


class ShownSites:
    """An observation made of parts, a ``Dict``.

    Parameters
    ----------
    names
        Of the parts.

    Raises
    ------
    InputError
        If a name is unknown or comes twice, or there is none.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.parts = named_parts("observation", names, PARTS)
        self._bounds = {part.name: (part.space.low, part.space.high) for part in self.parts}

    def __reduce__(self) -> tuple[type[ShownSites], tuple[list[str]]]:
        """Copy by names: what a part is computed by need not be copied itself."""
        return ShownSites, ([part.name for part in self.parts],)

    @property
    def space(self) -> spaces.Dict:
        """Of one lander."""
        return spaces.Dict({part.name: part.space for part in self.parts})

    def of(self, sights: Sights) -> Shown:
        """Return the observation of every lander, an array (n, ...) a part."""
        told = {}
        for part in self.parts:
            value = np.array(part.of(sights), dtype=np.float32)
            check_shape(f"observation: {part.name}", value, (len(sights.site), *part.shape))
            low, high = self._bounds[part.name]
            np.maximum(value, low, out=value)
            told[part.name] = np.minimum(value, high, out=value)
        return told
