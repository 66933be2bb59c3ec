"""What an agent that chooses sites decides on: named parts, one whole number each.

A part of one's own is added by `register`, and named in an environment's `action`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim_envs.named_parts import check_new, check_shape, named_parts
from lunarsim_envs.sites.parts import SITES
from lunarsim_envs.sites.sights import Sights

Array = NDArray[np.float64]
Choice = NDArray[np.int64]
Mask = NDArray[np.bool_]

# What choices 1 and on of the part "stretch" stand for: see `Decision`. None is less than 1: the
# cheapest path is mostly the fastest within the limits.
STRETCHES = (1.0, 1.07, 1.15, 1.3)


def _every(sights: Sights, count: int) -> Mask:
    return np.ones((len(sights.site), count), np.bool_)


@dataclass(frozen=True)
class ActionPart:
    """One part of an action.

    Attributes
    ----------
    name, meaning
        As documents tell them.
    sets
        Of a decision: the site, or the stretch of the time-to-go.
    count
        Of choices; the first leaves what it sets as it is, and can always be had.
    of
        Returns what choices (n,) of all landers stand for: sites (n, 3), local frame, m, or
        stretches (n,); NaN leaves them as they are. What it returns where a choice cannot be had is
        not taken.
    open
        Tells which choices can be had (n, count); left out: all.
    """

    name: str
    sets: Literal["site", "stretch"]
    count: int
    meaning: str
    of: Callable[[Sights, Choice], Array]
    open: Callable[[Sights], Mask] | None = None


PARTS: dict[str, ActionPart] = {}
# What is decided on unless something else is asked for.
DEFAULT_ACTION = ("site",)


def register(part: ActionPart) -> None:
    """Add a part.

    Raises
    ------
    InputError
        If there is one of its name, it sets something else, or leaves no choice.
    """
    check_new(part.name, PARTS)
    if part.sets not in ("site", "stretch"):
        raise InputError(f"{part.name}: sets", part.sets, "'site' or 'stretch'")
    if part.count < 2:
        raise InputError(f"{part.name}: count", part.count, "at least 2 choices")
    PARTS[part.name] = part


def _sites(sights: Sights, chosen: Choice) -> Array:
    n, most = len(chosen), sights.position_of.shape[1]
    out = np.full((n, 3), np.nan)
    (moved,) = np.nonzero((chosen > 0) & (chosen <= most))
    out[moved] = sights.position_of[moved, chosen[moved] - 1]
    return out


def _sites_open(sights: Sights) -> Mask:
    mask = np.zeros((len(sights.site), SITES + 1), np.bool_)
    mask[:, 0] = True
    n = min(SITES, sights.cost.shape[1])
    known = np.arange(n) < sights.count[:, None]
    mask[:, 1 : n + 1] = known & np.isfinite(sights.cost[:, :n])
    return mask


def _stretches(sights: Sights, chosen: Choice) -> Array:
    return np.array([np.nan, *STRETCHES])[chosen]


for _part in (
    ActionPart(
        "site", "site", SITES + 1,
        "0 keeps the present site, i flies to row i - 1 of the observation's `sites`",
        _sites, _sites_open,
    ),
    ActionPart(
        "stretch", "stretch", len(STRETCHES) + 1,
        "0 leaves the time-to-go as it is, the cheapest for a new site; 1 and on make it "
        f"{', '.join(f'{one:g}' for one in STRETCHES)} times the cheapest",
        _stretches,
    ),
):  # fmt: skip
    register(_part)


@dataclass(frozen=True)
class Orders:
    """What n landers are told.

    Attributes
    ----------
    site, stretch
        Where to (n, 3), local frame, m, and time-to-go over the cheapest (n,); NaN leaves them as
        they are.
    invalid
        Where something was chosen that cannot be had (n,): all is left as it is.
    lost
        Where a stretch was asked for beside that (n,).
    """

    site: Array
    stretch: Array
    invalid: Mask
    lost: Mask


def _array(given: Any) -> NDArray[Any]:
    """Return actions as an array; of no type that they may have where rows are of many lengths."""
    try:
        return np.asarray(given)
    except ValueError:
        return np.array(None)


class SiteActions:
    """Actions made of parts: ``Discrete`` of one, ``MultiDiscrete`` of several.

    Parameters
    ----------
    names
        Of the parts.

    Raises
    ------
    InputError
        If a name is unknown or comes twice, there is none, or two parts set the same.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.parts = named_parts("action", names, PARTS)
        sets = [part.sets for part in self.parts]
        for one in set(sets):
            if sets.count(one) > 1:
                raise InputError("action", list(names), f"one part that sets the {one}")
        self.counts = [part.count for part in self.parts]
        self.space: spaces.Discrete[Any] | spaces.MultiDiscrete[Any]
        if len(self.parts) == 1:
            self.space = spaces.Discrete(self.counts[0])
        else:
            self.space = spaces.MultiDiscrete(self.counts)

    def __reduce__(self) -> tuple[type[SiteActions], tuple[list[str]]]:
        """Copy by names: what a part is computed by need not be copied itself."""
        return SiteActions, ([part.name for part in self.parts],)

    @property
    def stretches(self) -> bool:
        """Whether a stretch can be asked for."""
        return any(part.sets == "stretch" for part in self.parts)

    def has(self, name: str) -> bool:
        """Tell whether a part is among them."""
        return any(part.name == name for part in self.parts)

    def alone(self, name: str, choice: int) -> Any:
        """Return the action of one choice of a part that leaves to all others what they set."""
        chosen = np.array([choice * (part.name == name) for part in self.parts], np.int64)
        return chosen[0] if len(chosen) == 1 else chosen

    def choice(self, name: str, chosen: Choice) -> Choice:
        """Return what is chosen (n,) of a part in actions (n, parts); 0 of one not among them."""
        at = [k for k, part in enumerate(self.parts) if part.name == name]
        return np.asarray(chosen[:, at].sum(axis=1))

    def chosen(self, action: Any) -> Choice:
        """Return the choices of one environment's action (1, parts).

        Raises
        ------
        ValueError
            If it is none.
        """
        if len(self.parts) == 1:
            if not self.space.contains(action):
                raise ValueError(
                    f"action = {action!r}: must be an integer from 0 to {self.counts[0] - 1}"
                )
            return np.array([[int(action)]])
        given = _array(action)
        if given.shape != (len(self.parts),) or given.dtype.kind not in "iu" or self._out(given):
            raise ValueError(f"action = {action!r}: must be {self._bounds}")
        return given.astype(np.int64)[None]

    def all_chosen(self, actions: Any, count: int) -> Choice:
        """Return the choices of the actions of so many environments (n, parts).

        Raises
        ------
        ValueError
            If they are none.
        """
        one = len(self.parts) == 1
        shape = (count,) if one else (count, len(self.parts))
        given = _array(actions)
        wanted = f"integers from 0 to {self.counts[0] - 1}" if one else f"times {self._bounds}"
        if given.shape != shape or given.dtype.kind not in "iu":
            raise ValueError(
                f"actions of shape {given.shape} and type {given.dtype}: must be {count} {wanted}"
            )
        wide = given.reshape(count, len(self.parts))
        if self._out(wide):
            told = (wide.min(axis=0), wide.max(axis=0))
            low, high = (str(v[0] if one else v.tolist()) for v in told)
            raise ValueError(f"actions from {low} to {high}: must be {count} {wanted}")
        return wide.astype(np.int64)

    @property
    def _bounds(self) -> str:
        """What actions of several parts are, for messages."""
        told = (f"{part.name} from 0 to {part.count - 1}" for part in self.parts)
        return f"{len(self.parts)} integers, {', '.join(told)}"

    def _out(self, given: NDArray[Any]) -> bool:
        return bool(((given < 0) | (given >= np.array(self.counts))).any())

    def masks(self, sights: Sights) -> Mask:
        """Return which choices can be had, those of one part after those of the other (n, sum).

        A stretch can always be asked for: whether it is flown hangs on the site too.
        """
        return np.concatenate([self._open(part, sights) for part in self.parts], axis=1)

    def _open(self, part: ActionPart, sights: Sights) -> Mask:
        if part.open is None:
            return _every(sights, part.count)
        mask = np.asarray(part.open(sights), dtype=np.bool_)
        check_shape(f"action: {part.name}: open", mask, (len(sights.site), part.count))
        return mask

    def orders(self, chosen: Choice, sights: Sights) -> Orders:
        """Return what choices (n, parts) stand for by what the landers are shown."""
        n = len(chosen)
        places = chosen + np.cumsum([0, *self.counts[:-1]])
        had = np.take_along_axis(self.masks(sights), places, axis=1)
        invalid: Mask = np.asarray(~had.all(axis=1))
        told = {"site": np.full((n, 3), np.nan), "stretch": np.full(n, np.nan)}
        for part, own in zip(self.parts, chosen.T, strict=True):
            value = np.array(part.of(sights, own), dtype=np.float64)
            check_shape(f"action: {part.name}", value, told[part.sets].shape)
            told[part.sets] = value
        if (told["stretch"] <= 0.0).any() or np.isinf(told["stretch"]).any():
            raise InputError("action: stretch", told["stretch"].tolist(), "positive finite, or NaN")
        lost = invalid & np.isfinite(told["stretch"])
        for value in told.values():
            value[invalid] = np.nan
        return Orders(told["site"], told["stretch"], invalid, lost)
