"""Errors of parts, by the scenario's tables: a part knows its keys and not where they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from lunarsim.errors import InputError

_OTHER_TABLES = {"sun", "navigation", "vehicle", "sensors", "prior_map", "expected_rocks"}


@contextmanager
def named_in(table: str) -> Iterator[None]:
    """Put the scenario's table before a key that a part complains of.

    What names another table, or a key of one (a sensor's, the mission's), is left as it is.
    """
    try:
        yield
    except InputError as error:
        if error.field.partition(".")[0] in _OTHER_TABLES:
            raise
        key = error.field.rpartition(".")[2]
        raise error.renamed(f"{table}.{key}") from None
