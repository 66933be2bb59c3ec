"""Build observations of ``Retarget-v1`` from named components, one array each.

`register` adds custom components, which can then be named in an environment's `observation`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.value_checks import check_shape
from lunarsim_envs.named_components import PER_LANDER, check_new, named_parts
from lunarsim_envs.sites.site_features import FEATURES, site_features
from lunarsim_envs.sites.site_inputs import CROP_CELLS, MAP_CELLS, SITES, SiteInputs

Array = NDArray[Any]
Shown = dict[str, NDArray[np.float32]]

# Bound of distances (m), speeds (m/s) and masses (kg) in observations; larger values are clipped.
FAR = 5000.0


@dataclass(frozen=True)
class SiteObservationComponent:
    """One component of the observation of ``Retarget-v1``, such as the hazard map.

    Attributes
    ----------
    name
        Name by which the environment's argument `observation` selects the component.
    shape
        Shape of the array for one lander.
    units
        Units along the last axis, or one unit for all.
    low, high
        Bounds that can be broadcast to the shape.
    meaning
        Description, for the documentation.
    of
        Function that returns the values of all landers (n, *shape).
    """

    name: str
    shape: tuple[int, ...]
    units: tuple[str, ...]
    low: Any
    high: Any
    meaning: str
    of: Callable[[SiteInputs], Array]

    @property
    def space(self) -> spaces.Box:
        """Gymnasium space of the component for one lander."""
        low = np.broadcast_to(np.asarray(self.low, np.float32), self.shape).copy()
        high = np.broadcast_to(np.asarray(self.high, np.float32), self.shape).copy()
        return spaces.Box(low, high, self.shape, np.float32)


PARTS: dict[str, SiteObservationComponent] = {}
# Default components of the observation.
DEFAULT = ("estimate", "hazard_map", "sites", "to_go")


def register(part: SiteObservationComponent) -> None:
    """Register a custom component, so that environments can select it by name.

    Raises
    ------
    InputError
        If the name exists, the shape is empty, or the bounds are empty.
    """
    check_new(part.name, PARTS)
    space = part.space
    if not part.shape:
        raise InputError(f"{part.name}.shape", part.shape, "must have one axis or more")
    if not (space.low < space.high).all():
        raise InputError(
            f"{part.name}.low", part.low, "must be less than high everywhere", show_value=False
        )
    PARTS[part.name] = part


def _estimate(s: SiteInputs) -> Array:
    return np.concatenate((s.position - s.site, s.velocity, s.attitude), axis=1)


def _to_go(s: SiteInputs) -> Array:
    altitude = s.position[:, 2] - s.site[:, 2]
    return np.stack((s.time_to_go, s.propellant, altitude), axis=1)


def _site_table(inputs: SiteInputs, columns: Sequence[Array]) -> Array:
    """Return a table of candidate sites (n, 20, columns) from its columns (n, m).

    Rows without a site are zero.
    """
    out = np.zeros((len(inputs.site), SITES, len(columns)))
    n = min(SITES, inputs.p_safe.shape[1])
    known = np.arange(n) < inputs.count[:, None]
    for k, column in enumerate(columns):
        out[:, :n, k] = np.where(known, column[:, :n], 0.0)
    return out


def _away(s: SiteInputs) -> Array:
    return s.position_of - s.site[:, None]


def _sites(s: SiteInputs) -> Array:
    away, there = _away(s), np.isfinite(s.cost)
    cost = np.where(there, s.cost, FAR)
    return _site_table(s, (away[..., 0], away[..., 1], away[..., 2], s.p_safe, cost, there))


def _candidates(s: SiteInputs) -> Array:
    away, there = _away(s), np.isfinite(s.cost)
    stay = np.where(np.isfinite(s.here[:, 1]), s.here[:, 1], 0.0)
    more = np.where(there, s.cost - stay[:, None], FAR)
    return _site_table(s, (away[..., 0], away[..., 1], s.p_safe, more, s.distance, there))


def _site(s: SiteInputs) -> Array:
    p, cost, miss = s.here.T
    seen = np.isfinite(p)
    return np.stack((np.where(seen, p, 0.0), seen, np.minimum(cost, FAR), miss), axis=1)


def _features(s: SiteInputs) -> Array:
    return site_features(s)[0]


def _small(s: SiteInputs) -> Array:
    return s.small


def _crop(s: SiteInputs) -> Array:
    return s.crop


for _part in (
    SiteObservationComponent(
        "estimate", (10,), (*["m"] * 3, *["m/s"] * 3, *[""] * 4),
        [-FAR] * 6 + [-1.0] * 4, [FAR] * 6 + [1.0] * 4,
        "estimated position relative to the current site, velocity and attitude (scalar last), ENU",
        _estimate,
    ),
    SiteObservationComponent(
        "hazard_map", (2, MAP_CELLS, MAP_CELLS), ("",), 0.0, 1.0,
        "mean p_safe and observed fraction in equal blocks of the hazard map; row 0 south, column "
        "0 west", _small,
    ),
    SiteObservationComponent(
        "sites", (SITES, 6), ("m", "m", "m", "", "kg", ""),
        [-FAR, -FAR, -FAR, 0.0, 0.0, 0.0], [FAR, FAR, FAR, 1.0, FAR, 1.0],
        "offset from the current site east, north, up, p_safe, propellant to reach it, 1 if "
        "available; rows without a site are zero", _sites,
    ),
    SiteObservationComponent(
        "to_go", (3,), ("s", "kg", "m"), 0.0, FAR,
        "time-to-go, remaining propellant, altitude above the site", _to_go,
    ),
    SiteObservationComponent(
        "candidates", (SITES, 6), ("m", "m", "", "kg", "m", ""),
        [-FAR, -FAR, 0.0, -FAR, 0.0, 0.0], [FAR, FAR, 1.0, FAR, FAR, 1.0],
        "offset from the current site east and north, p_safe, propellant minus that of the current "
        "site, distance, 1 if available; one row per divert action", _candidates,
    ),
    SiteObservationComponent(
        "site", (4,), ("", "", "kg", "m"), [0.0, 0.0, 0.0, 0.0], [1.0, 1.0, FAR, FAR],
        "current site: p_safe, 1 if observed, propellant to reach it, expected miss", _site,
    ),
    SiteObservationComponent(
        "site_features", (SITES + 1, len(FEATURES)), ("",), -100.0, 100.0,
        "scaled features of each action, for a network that scores all of them alike: "
        + ", ".join(FEATURES), _features,
    ),
    SiteObservationComponent(
        "hazard_crop", (2, CROP_CELLS, CROP_CELLS), ("",), 0.0, 1.0,
        "p_safe and observed mask around the current site, 1 m spacing; row 0 south, column 0 west",
        _crop,
    ),
):  # fmt: skip
    register(_part)


class SiteObservationLayout:
    """Compute observations of named components, as a dictionary of arrays.

    Parameters
    ----------
    names
        Names of the components.

    Raises
    ------
    InputError
        If a name is unknown or occurs twice, or there are no names.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.parts = named_parts("observation", names, PARTS)
        self._bounds = {part.name: (part.space.low, part.space.high) for part in self.parts}

    def __reduce__(self) -> tuple[type[SiteObservationLayout], tuple[list[str]]]:
        """Pickle the names only, because functions of components may not be picklable."""
        return SiteObservationLayout, ([part.name for part in self.parts],)

    @property
    def space(self) -> spaces.Dict:
        """Observation space of one lander."""
        return spaces.Dict({part.name: part.space for part in self.parts})

    def of(self, inputs: SiteInputs) -> Shown:
        """Compute the observations of n landers: an array (n, ...) per component."""
        observation = {}
        for part in self.parts:
            value = np.array(part.of(inputs), dtype=np.float32)
            check_shape(
                f"observation {part.name!r}", value, (len(inputs.site), *part.shape), PER_LANDER
            )
            low, high = self._bounds[part.name]
            np.maximum(value, low, out=value)
            observation[part.name] = np.minimum(value, high, out=value)
        return observation
