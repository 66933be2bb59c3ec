"""Add the scenario table to errors of parts, which know only their own keys."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from lunarsim.errors import InputError

_OTHER_TABLES = {"sun", "navigation", "vehicle", "sensors", "prior_map", "expected_rocks"}


@contextmanager
def prefix_input_errors(table: str) -> Iterator[None]:
    """Prefix the field of an `InputError` raised inside with a scenario table.

    Fields that name a key of another table (a sensor, the mission) are left unchanged.
    """
    try:
        yield
    except InputError as error:
        if error.field.partition(".")[0] in _OTHER_TABLES:
            raise
        key = error.field.rpartition(".")[2]
        raise error.renamed(f"{table}.{key}") from None
