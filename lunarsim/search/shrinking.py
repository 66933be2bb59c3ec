"""Move the values of a finding back to nominal while its failure persists."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lunarsim.search.space import SearchSpace

Values = Mapping[str, Any]
# Bisections of the interval between the nominal value and the value of the finding.
_BISECTIONS = 3


def changed_keys(space: SearchSpace, values: Values) -> list[str]:
    """Return the keys whose value is not nominal."""
    nominal = space.nominal()
    return [key for key in nominal if values[key] != nominal[key]]


def shrink(
    space: SearchSpace, values: Values, persists: Callable[[Values], bool]
) -> dict[str, Any]:
    """Return values with as few keys away from nominal as the failure needs.

    Keys are set to nominal in groups, which are halved if the failure disappears (as in delta
    debugging: Zeller and Hildebrandt 2002), then one by one until each remaining key is needed.
    The remaining keys are moved towards nominal by bisection.

    Parameters
    ----------
    space
        Ranges with nominal values.
    values
        Values of the finding.
    persists
        Whether the failure persists with other values. It is called once for each set of values.

    Returns
    -------
    dict
        Value of each key.
    """
    known: dict[str, bool] = {}

    def check(candidate: Values) -> bool:
        key = repr([candidate[name] for name in space.ranges])
        if key not in known:
            known[key] = persists(candidate)
        return known[key]

    found = _reset(space, dict(values), changed_keys(space, values), check)
    before: dict[str, Any] = {}
    while found != before:
        before = dict(found)
        for key in changed_keys(space, found):
            found = _reset(space, found, [key], check)
    for key in changed_keys(space, found):
        found = _bisect(space, found, key, check)
    return found


def _reset(
    space: SearchSpace, values: dict[str, Any], keys: Sequence[str], check: Callable[[Values], bool]
) -> dict[str, Any]:
    """Return the values with those `keys` nominal that the failure does not need."""
    if not keys:
        return values
    candidate = {**values, **{key: space.ranges[key].nominal for key in keys}}
    if check(candidate):
        return candidate
    if len(keys) > 1:
        middle = len(keys) // 2
        for half in (keys[:middle], keys[middle:]):
            values = _reset(space, values, half, check)
    return values


def _bisect(
    space: SearchSpace, values: dict[str, Any], key: str, check: Callable[[Values], bool]
) -> dict[str, Any]:
    """Return the values with one key as close to nominal as the failure allows."""
    low, high, start = 0.0, 1.0, values[key]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        candidate = {**values, key: space.ranges[key].toward_nominal(start, middle)}
        if check(candidate):
            high, values = middle, candidate
        else:
            low = middle
    return values
