"""Errors that a user can act on."""

from __future__ import annotations

import difflib
import reprlib
import tempfile
from collections.abc import Iterable
from dataclasses import fields
from numbers import Integral, Real
from pathlib import Path


class InputError(ValueError):
    """Report an unusable value given by the user.

    Parameters
    ----------
    field
        Name of the field, option or argument, for instance ``lander.dry_mass_kg``.
    value
        Value given.
    problem
        Clause that follows the field: ``must be positive``.
    remedy
        Sentence with the remedy; it can be omitted if the problem implies it.

    Examples
    --------
    >>> print(InputError("rocks.cover", 0.5, "must be at most 0.2"))
    rocks.cover: must be at most 0.2, got 0.5.
    >>> print(InputError("jobs", 0, "must be 1 or more", "Omit it to use every processor."))
    jobs: must be 1 or more, got 0. Omit it to use every processor.
    """

    def __init__(self, field: str, value: object, problem: str, remedy: str = "") -> None:
        self.field = field
        self.value = value
        self.problem = problem
        self.remedy = remedy
        message = f"{field}: {problem}, got {_format_value(value)}."
        super().__init__(f"{message} {remedy}" if remedy else message)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str, str]]:
        return InputError, (self.field, self.value, self.problem, self.remedy)

    def renamed(self, field: str) -> InputError:
        """Return the same error under another field name."""
        return InputError(field, self.value, self.problem, self.remedy)


def check_types(where: str, settings: object) -> None:
    """Check that numeric and boolean fields of a dataclass have the declared type.

    Parameters
    ----------
    where
        Prefix of the field names in the error message.
    settings
        Dataclass instance. The check covers fields annotated as `float`, `int`, `bool` or tuples of
        floats; optional fields may be None.

    Raises
    ------
    InputError
        Naming the first field with another type.
    """
    for one in fields(settings):  # type: ignore[arg-type]
        value, kind = getattr(settings, one.name), str(one.type)
        if value is None and "None" in kind:
            continue
        for begins, right, expected in _KINDS:
            if kind.startswith(begins) and not right(value):
                raise InputError(f"{where}.{one.name}", value, expected)


def _is_flag(value: object) -> bool:
    # Recognise NumPy's boolean, which is not a `bool`, without importing NumPy.
    return type(value).__name__ in ("bool", "bool_")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not _is_flag(value)


def _is_integer(value: object) -> bool:
    return isinstance(value, Integral) and not _is_flag(value)


def _are_numbers(value: object) -> bool:
    return isinstance(value, Iterable) and all(_is_number(v) for v in value)


_KINDS = (
    ("float", _is_number, "must be a number"),
    ("int", _is_integer, "must be an integer"),
    ("bool", _is_flag, "must be true or false"),
    ("tuple[float", _are_numbers, "must be a sequence of numbers"),
)


def _format_value(value: object) -> str:
    """Return the repr of a value, shortened if nested too deep or too long."""
    try:
        return repr(value)
    except RecursionError:
        return reprlib.repr(value)
    except ValueError:  # an integer of more than 4,300 digits
        return f"a value of type {type(value).__name__} that is too long to show"


class RenderingError(RuntimeError):
    """Report that the machine cannot render; the message names what to install."""


def check_folder(out: Path, *, hidden: bool = True) -> None:
    """Check that a folder for results is new or empty, and writable.

    The check does not create the folder.

    Parameters
    ----------
    out
        Folder for results.
    hidden
        Whether files whose names begin with a dot make the folder non-empty.

    Raises
    ------
    InputError
        Naming ``--out``.
    """
    if out.exists() and not out.is_dir():
        raise InputError("--out", str(out), "must be a folder, not a file")
    if out.exists() and any(hidden or not p.name.startswith(".") for p in out.iterdir()):
        raise InputError("--out", str(out), "must be a new or empty folder")
    check_writable(out)


def check_writable(out: Path) -> None:
    """Check that a folder is writable or can be created, without creating it.

    Raises
    ------
    InputError
        Naming ``--out``.
    """
    there = next(p for p in (out, *out.absolute().parents) if p.exists())
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise InputError(
            "--out",
            str(out),
            f"must be writable, but {there} is not ({error.strerror})",
        ) from None


def check_output(field: str, path: Path, suffix: str) -> None:
    """Check the suffix of an output file, and that its folder exists and is writable.

    Raises
    ------
    InputError
        Naming `field`.
    """
    if path.suffix.lower() != suffix:
        raise InputError(field, str(path), f"must be a file name that ends in {suffix}")
    if not path.parent.is_dir():
        raise InputError(field, str(path), "must be in an existing folder")
    if path.is_dir():
        raise InputError(field, str(path), "must be a file, not a folder")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(
            field, str(path), f"must be in a writable folder ({error.strerror})"
        ) from None


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a sentence with the known name closest to `name`, or with all names.

    Examples
    --------
    >>> suggestion("hemisphare", ["cube", "hemisphere"])
    "Did you mean 'hemisphere'?"
    """
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    if close:
        return f"Did you mean {close[0]!r}?"
    return f"Known names: {', '.join(known)}." if known else "There are no known names."
