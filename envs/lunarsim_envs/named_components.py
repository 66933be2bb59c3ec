"""Select components of an observation or an action by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from lunarsim.errors import InputError, suggestion

Part = TypeVar("Part")
# End of the error about an array of a component with a wrong shape.
PER_LANDER = "(first axis: landers)"


def named_parts(field: str, names: Sequence[str], known: Mapping[str, Part]) -> list[Part]:
    """Look up components of an observation or an action by their names, in order.

    `known` has all components by name. If a name is unknown or occurs twice, or there are no names,
    an `InputError` for the argument `field` is raised.
    """
    listed = isinstance(names, Sequence) and not isinstance(names, (str, bytes))
    if not listed or not len(names) or not all(isinstance(name, str) for name in names):
        raise InputError(field, names, "must be a list of one or more names")
    for name in names:
        if name not in known:
            raise InputError(
                field, name, "must contain only known components", suggestion(name, known)
            )
    for name in names:
        if names.count(name) > 1:
            raise InputError(field, name, "must contain each name only once")
    return [known[name] for name in names]


def check_new(name: str, known: Mapping[str, Any]) -> None:
    """Raise an `InputError` if a component of `known` has the name of a new component."""
    if name in known:
        raise InputError("name", name, "must not be the name of a registered component")
