"""Build actions of ``Retarget-v1`` from named components, one integer each.

`register` adds custom components, which can then be named in an environment's `action`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import check_shape
from lunarsim_envs.named_components import PER_LANDER, check_new, named_parts
from lunarsim_envs.sites.site_inputs import SITES, SiteInputs

Choice = IntArray

# Factors on the time-to-go for choices 1 and above of `time_scale` (see `Decision`). No factor is
# less than 1, because the minimum-propellant path is usually the fastest one within the limits.
TIME_SCALES = (1.0, 1.07, 1.15, 1.3)


def _all_available(inputs: SiteInputs, count: int) -> BoolArray:
    """Return a mask (n, count) in which all choices are available."""
    return np.ones((len(inputs.site), count), np.bool_)


@dataclass(frozen=True)
class ActionComponent:
    """One component of the action of ``Retarget-v1``, such as the choice of a site.

    Attributes
    ----------
    name
        Name by which the environment's argument `action` selects the component.
    sets
        Quantity that the component sets: "site", or "time_scale" (factor on the time-to-go).
    count
        Number of choices. Choice 0 changes nothing and is always available.
    meaning
        Description, for the documentation.
    of
        Function that converts the choices of all landers (n,) to sites (n, 3), local frame, m, or
        to factors (n,). NaN changes nothing. Values of unavailable choices are ignored.
    open
        Function that returns the available choices (n, count). Default: all.
    """

    name: str
    sets: Literal["site", "time_scale"]
    count: int
    meaning: str
    of: Callable[[SiteInputs, Choice], Array]
    open: Callable[[SiteInputs], BoolArray] | None = None


PARTS: dict[str, ActionComponent] = {}
# Default components of the action.
DEFAULT_ACTION = ("site",)


def register(part: ActionComponent) -> None:
    """Register a custom component, so that environments can select it by name.

    Raises
    ------
    InputError
        If the name exists, `sets` is invalid, or there are fewer than two choices.
    """
    check_new(part.name, PARTS)
    if part.sets not in ("site", "time_scale"):
        raise InputError(f"{part.name}.sets", part.sets, "must be 'site' or 'time_scale'")
    if part.count < 2:
        raise InputError(f"{part.name}.count", part.count, "must be 2 or more")
    PARTS[part.name] = part


def _sites(inputs: SiteInputs, chosen: Choice) -> Array:
    n, most = len(chosen), inputs.position_of.shape[1]
    out = np.full((n, 3), np.nan)
    (moved,) = np.nonzero((chosen > 0) & (chosen <= most))
    out[moved] = inputs.position_of[moved, chosen[moved] - 1]
    return out


def _sites_open(inputs: SiteInputs) -> BoolArray:
    mask = np.zeros((len(inputs.site), SITES + 1), np.bool_)
    mask[:, 0] = True
    n = min(SITES, inputs.cost.shape[1])
    known = np.arange(n) < inputs.count[:, None]
    mask[:, 1 : n + 1] = known & np.isfinite(inputs.cost[:, :n])
    return mask


def _time_scales(inputs: SiteInputs, chosen: Choice) -> Array:
    return np.array([np.nan, *TIME_SCALES])[chosen]


for _part in (
    ActionComponent(
        "site", "site", SITES + 1,
        "0 keeps the current site, i diverts to row i - 1 of the observation `sites`",
        _sites, _sites_open,
    ),
    ActionComponent(
        "time_scale", "time_scale", len(TIME_SCALES) + 1,
        "0 keeps the time-to-go (minimum propellant for a new site); 1 and above set it to "
        f"{', '.join(f'{one:g}' for one in TIME_SCALES)} times that of minimum propellant",
        _time_scales,
    ),
):  # fmt: skip
    register(_part)


@dataclass(frozen=True)
class SiteDecisions:
    """Site decisions of n landers, decoded from their actions.

    Attributes
    ----------
    site, time_scale
        New sites (n, 3), local frame, m, and factors on the time-to-go of the minimum-propellant
        path (n,). NaN changes nothing.
    invalid
        Landers with an unavailable choice (n,); nothing changes for them.
    factor_ignored
        Landers whose factor is ignored because another choice was unavailable (n,).
    """

    site: Array
    time_scale: Array
    invalid: BoolArray
    factor_ignored: BoolArray


def _array(actions: Any) -> NDArray[Any]:
    """Return actions as an array; lists of unequal lengths give an array of shape ()."""
    try:
        return np.asarray(actions)
    except ValueError:
        return np.array(None)


def _given_text(action: Any) -> str:
    """Describe an invalid action for an error message.

    The text is the number if `action` is a single one, otherwise shape and type of the array.
    """
    given = _array(action)
    if given.ndim:
        return f"shape {given.shape} and type {given.dtype}"
    ragged = isinstance(action, Sequence) and given.item() is None
    return "lists of unequal lengths" if ragged else repr(given.item())


class SiteActions:
    """Decode actions that consist of named components into site decisions.

    The action space is ``Discrete`` for one component, otherwise ``MultiDiscrete``.

    Parameters
    ----------
    names
        Names of the components, in order.

    Raises
    ------
    InputError
        If a name is unknown or occurs twice, there are no names, or two components set the same
        quantity.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.parts = named_parts("action", names, PARTS)
        sets = [part.sets for part in self.parts]
        for one in set(sets):
            if sets.count(one) > 1:
                raise InputError(
                    "action", list(names), f"must not have two components that set the {one}"
                )
        self.counts = [part.count for part in self.parts]
        self.space: spaces.Discrete[Any] | spaces.MultiDiscrete[Any]
        if len(self.parts) == 1:
            self.space = spaces.Discrete(self.counts[0])
        else:
            self.space = spaces.MultiDiscrete(self.counts)

    def __reduce__(self) -> tuple[type[SiteActions], tuple[list[str]]]:
        """Pickle the names only, because functions of components may not be picklable."""
        return SiteActions, ([part.name for part in self.parts],)

    @property
    def has_time_scale(self) -> bool:
        """Whether the action can set a factor on the time-to-go."""
        return any(part.sets == "time_scale" for part in self.parts)

    def has(self, name: str) -> bool:
        """Return whether the action has a component with this name."""
        return any(part.name == name for part in self.parts)

    def single_choice(self, name: str, choice: int) -> Any:
        """Return the action that makes `choice` in one component, and 0 in all others."""
        chosen = np.array([choice * (part.name == name) for part in self.parts], np.int64)
        return chosen[0] if len(chosen) == 1 else chosen

    def choice(self, name: str, chosen: Choice) -> Choice:
        """Return the choices (n,) of one component; zeros if the action does not have it.

        `chosen` (n, components) are the choices of all components.
        """
        at = [k for k, part in enumerate(self.parts) if part.name == name]
        return np.asarray(chosen[:, at].sum(axis=1))

    def checked_choices(self, action: Any) -> Choice:
        """Check the action of a single environment; return its choices (1, components).

        Raises
        ------
        ValueError
            If the action is invalid.
        """
        if len(self.parts) > 1:
            return self._checked("action", action, (len(self.parts),))
        if not self.space.contains(action):
            bounds = f"must be an integer between 0 and {self.counts[0] - 1}"
            raise ValueError(f"action: {bounds}, got {_given_text(action)}.")
        return np.array([[int(action)]])

    def checked_batch_choices(self, actions: Any, count: int) -> Choice:
        """Check the actions of `count` environments; return the choices (n, components).

        Raises
        ------
        ValueError
            If the actions are invalid.
        """
        shape = (count,) if len(self.parts) == 1 else (count, len(self.parts))
        return self._checked("actions", actions, shape)

    def _checked(self, field: str, action: Any, shape: tuple[int, ...]) -> Choice:
        """Check shape, type and bounds of actions; return the choices (n, components)."""
        given = _array(action)
        if given.shape != shape or given.dtype.kind not in "iu":
            raise ValueError(
                f"{field}: must be integers of shape {shape} for "
                f"{', '.join(part.name for part in self.parts)}, got {_given_text(action)}."
            )
        wide = given.reshape(-1, len(self.parts))
        outside = (wide < 0) | (wide >= np.array(self.counts))
        if outside.any():
            index = np.argwhere(outside.reshape(shape))[0].tolist()
            k = index[-1] if len(self.parts) > 1 else 0
            raise ValueError(
                f"{field}{index}: must be between 0 and {self.counts[k] - 1} (component "
                f"{self.parts[k].name!r}), got {given[tuple(index)]}."
            )
        return wide.astype(np.int64)

    def masks(self, inputs: SiteInputs) -> BoolArray:
        """Return which choices are available (n, total number of choices).

        The masks of all components are concatenated. Factors on the time-to-go are always
        available; whether they can be flown also depends on the site.
        """
        return np.concatenate([self._open(part, inputs) for part in self.parts], axis=1)

    def _open(self, part: ActionComponent, inputs: SiteInputs) -> BoolArray:
        if part.open is None:
            return _all_available(inputs, part.count)
        mask = np.asarray(part.open(inputs), dtype=np.bool_)
        check_shape(f"action {part.name!r}, open", mask, (len(inputs.site), part.count), PER_LANDER)
        return mask

    def decisions(self, chosen: Choice, inputs: SiteInputs) -> SiteDecisions:
        """Convert the choices of n landers (n, components) to site decisions.

        `inputs` are the onboard data from which the choices were made.
        """
        n = len(chosen)
        places = chosen + np.cumsum([0, *self.counts[:-1]])
        had = np.take_along_axis(self.masks(inputs), places, axis=1)
        invalid: BoolArray = np.asarray(~had.all(axis=1))
        decided = {"site": np.full((n, 3), np.nan), "time_scale": np.full(n, np.nan)}
        for part, own in zip(self.parts, chosen.T, strict=True):
            value = np.array(part.of(inputs, own), dtype=np.float64)
            check_shape(f"action {part.name!r}", value, decided[part.sets].shape, PER_LANDER)
            decided[part.sets] = value
        scale = decided["time_scale"]
        wrong = (scale <= 0.0) | np.isinf(scale)
        if wrong.any():
            problem = "must be positive and finite, or NaN"
            raise InputError("time_scale", scale[wrong][0].item(), problem)
        lost = invalid & np.isfinite(decided["time_scale"])
        for value in decided.values():
            value[invalid] = np.nan
        return SiteDecisions(decided["site"], decided["time_scale"], invalid, lost)
