"""Errors that a user can act on."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """A value that the user gave cannot be used.

    Parameters
    ----------
    field
        Where the value was given, for instance ``lander.dry_mass_kg``.
    value
        What was given.
    expected
        What would be right.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        self.field = field
        self.value = value
        self.expected = expected
        super().__init__(f"{field} = {value!r}: {expected}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        return InputError, (self.field, self.value, self.expected)


class RenderingError(RuntimeError):
    """The machine cannot render; the message says what to install."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a sentence naming the known names closest to `name`."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    return "known: " + ", ".join(known)
