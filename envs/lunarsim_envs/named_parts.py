"""Parts of an observation or an action chosen by name from a registry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from lunarsim.errors import InputError, suggestion

Part = TypeVar("Part")


def named_parts(field: str, names: Sequence[str], known: Mapping[str, Part]) -> list[Part]:
    """Return the parts of some names, in their order.

    Raises
    ------
    InputError
        If a name is unknown or comes twice, or there is none; `field` names what was given.
    """
    listed = isinstance(names, Sequence) and not isinstance(names, (str, bytes))
    if not listed or not len(names) or not all(isinstance(name, str) for name in names):
        raise InputError(field, names, "a list of the names of at least one part")
    for name in names:
        if name not in known:
            raise InputError(field, name, suggestion(name, known))
    if len(set(names)) < len(names):
        raise InputError(field, list(names), "each part once")
    return [known[name] for name in names]


def check_new(name: str, known: Mapping[str, Any]) -> None:
    """Refuse a name that a registry of parts has already.

    Raises
    ------
    InputError
        If it has.
    """
    if name in known:
        raise InputError("name", name, "a name of its own: there is such a part already")


def check_shape(field: str, value: Any, shape: tuple[int, ...]) -> None:
    """Refuse what a part gives where it is not of its shape, all landers first.

    Raises
    ------
    InputError
        Naming the part, as `field` does.
    """
    if np.shape(value) != shape:
        raise InputError(field, np.shape(value), f"an array of shape {shape}")
