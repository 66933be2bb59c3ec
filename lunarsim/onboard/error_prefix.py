"""Add the scenario table to errors of components, which know only their own keys."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from lunarsim.errors import InputError

_OTHER_TABLES = {"sun", "navigation", "vehicle", "sensors", "prior_map", "expected_rocks"}


@contextmanager
def prefix_input_errors(table: str) -> Iterator[None]:
    """Name the scenario table in the fields of errors that a `with` block raises.

    The field of each `InputError` becomes "TABLE.KEY": `table` and the last part of the old field.
    Fields that begin with "sun", "navigation", "vehicle", "sensors", "prior_map" or
    "expected_rocks" already name a table and stay unchanged, as do other exceptions.
    """
    try:
        yield
    except InputError as error:
        if error.field.partition(".")[0] in _OTHER_TABLES:
            raise
        key = error.field.rpartition(".")[2]
        raise error.with_field(f"{table}.{key}") from None
