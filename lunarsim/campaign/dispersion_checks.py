"""Check that scenarios accept the random values of their dispersions."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from lunarsim.campaign.dispersions import Dispersions
from lunarsim.campaign.distributions import Choice
from lunarsim.campaign.factors import check_plain
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import path_of, with_values

# Maximum number of flights whose random values are checked.
_MAX_CHECKED_DRAWS = 1000


def check_dispersions(
    dispersions: Dispersions,
    scenarios: Sequence[Scenario],
    set_elsewhere: Mapping[str, Any],
    flights: int,
) -> None:
    """Check that scenarios accept the extreme random values of each scenario key.

    Parameters
    ----------
    dispersions
        Random values to check.
    scenarios
        Scenarios that must accept them.
    set_elsewhere
        Values by key that the arms of a campaign set.
    flights
        Number of flights; the extremes of the first thousand are checked.

    Raises
    ------
    InputError
        If a random key is also set elsewhere, or a scenario refuses a random value.
    """
    laws = dispersions.distributions
    texts = {key: list(law.values) for key, law in laws.items() if isinstance(law, Choice)}
    for key, choices in texts.items():
        for value in choices:
            check_plain(f"dispersions.{key}.values", value)
    check_no_overlap(laws, texts, "dispersions")
    for name in laws:
        for key, value in set_elsewhere.items():
            if keys_overlap(name, key, texts.get(name, [0.0]), [value]):
                raise InputError(
                    f"dispersions.{name}", name, f"must be omitted, because the arms set {key}",
                    show_value=False,
                )  # fmt: skip
    drawn = [dispersions.draws(i) for i in range(min(flights, _MAX_CHECKED_DRAWS))]
    for key in laws:
        values = [one[key] for one in drawn]
        for value in _extremes(values):
            for scenario in scenarios:
                with_values(scenario, drawn[values.index(value)], "dispersions")


def keys_overlap(
    first: str,
    second: str,
    first_values: Sequence[Any] = (0.0,),
    second_values: Sequence[Any] = (0.0,),
) -> bool:
    """Return whether one of two scenario keys contains the other (its table).

    `first_values` and `second_values` are possible values of the keys. A component's table, for
    instance ``policy``, with string values means its `kind`.
    """
    paths = [
        path_of(key, "" if all(isinstance(value, str) for value in values) else values)
        for key, values in ((first, first_values), (second, second_values))
    ]
    shorter, longer = sorted(paths, key=len)
    return longer[: len(shorter)] == shorter


def check_no_overlap(keys: Iterable[str], values: Mapping[str, Sequence[Any]], field: str) -> None:
    """Raise `InputError` if one scenario key contains another, for instance its table.

    The result would depend on the order in which the two keys are set. `values` has the values of
    the keys, and `field` is the field name for errors.
    """
    for a, b in itertools.combinations(keys, 2):
        if keys_overlap(a, b, values.get(a, [0.0]), values.get(b, [0.0])):
            raise InputError(
                f"{field}.{b}", b, f"must not be set together with {a}", show_value=False
            )


def _extremes(values: list[Any]) -> list[Any]:
    """Return minimum and maximum of a list of numbers.

    If some values are not numbers, return all distinct values.
    """
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return [min(values), max(values)]
    return [v for i, v in enumerate(values) if v not in values[:i]]
