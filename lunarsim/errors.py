"""Errors that a user can act on."""

from __future__ import annotations

import difflib
import reprlib
import tempfile
from collections.abc import Iterable
from dataclasses import fields
from numbers import Integral, Real
from pathlib import Path

# Longer values are shortened in error messages.
_MAX_SHOWN_CHARACTERS = 100
_MAX_SHOWN_ELEMENTS = 16


class InputError(ValueError):
    """Error that reports an unusable value given by the user.

    Parameters
    ----------
    field
        Name of the field, option or argument, for instance ``vehicle.dry_mass_kg``.
    value
        Value that the user gave.
    problem
        Clause that follows the field: ``must be positive``. A reason after ``, because`` follows
        the value in the message.
    remedy
        Sentence with the remedy; it can be omitted if the problem implies it.
    show_value
        Whether the message contains the value. False suits an error about a key or a name.

    Examples
    --------
    >>> print(InputError("rocks.cover", 0.5, "must be at most 0.2"))
    rocks.cover: must be at most 0.2, got 0.5.
    >>> print(InputError("jobs", 0, "must be 1 or more", "Omit it to use every processor."))
    jobs: must be 1 or more, got 0. Omit it to use every processor.
    >>> print(InputError("optimal.region", 10.0, "must be 0, because it is not supported"))
    optimal.region: must be 0, got 10.0, because it is not supported.
    >>> print(InputError("sun.glow", 0.5, "is an unknown key", show_value=False))
    sun.glow: is an unknown key.
    """

    def __init__(
        self, field: str, value: object, problem: str, remedy: str = "", show_value: bool = True
    ) -> None:
        self.field = field
        self.value = value
        self.problem = problem
        self.remedy = remedy
        self.show_value = show_value
        got = f", got {_format_value(value)}" if show_value else ""
        what, because, reason = problem.partition(", because ")
        message = f"{field}: {what}{got}{because}{reason}."
        super().__init__(f"{message} {remedy}" if remedy else message)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str, str, bool]]:
        return InputError, (self.field, self.value, self.problem, self.remedy, self.show_value)

    def with_field(self, field: str) -> InputError:
        """Return the same error with another field name."""
        return InputError(field, self.value, self.problem, self.remedy, self.show_value)


def missing_package(field: str, package: str, extra: str) -> InputError:
    """Return the error that an optional package is not installed.

    Parameters
    ----------
    field
        Name of the command, option or argument that needs the package.
    package
        Name of the package.
    extra
        Extra of lunarsim that contains it.

    Examples
    --------
    >>> print(missing_package("sensitivity", "SALib", "sensitivity"))
    sensitivity: needs the package SALib, which is not installed. Install the extra `sensitivity` \
of lunarsim: `pip install ".[sensitivity]"` in its clone.
    """
    return InputError(
        field, package, f"needs the package {package}, which is not installed",
        f'Install the extra `{extra}` of lunarsim: `pip install ".[{extra}]"` in its clone.',
        show_value=False,
    )  # fmt: skip


def check_types(prefix: str, settings: object) -> None:
    """Check that numeric and boolean fields of a dataclass have the annotated type.

    Parameters
    ----------
    prefix
        Prefix of the field names in the error message.
    settings
        Dataclass instance. The check covers fields annotated as `float`, `int`, `bool` or tuples of
        floats; optional fields may be None.

    Raises
    ------
    InputError
        If a field has another type; the error names the first such field or element.
    """
    for one in fields(settings):  # type: ignore[arg-type]
        value, kind = getattr(settings, one.name), str(one.type)
        if value is None and "None" in kind:
            continue
        for begins, right, expected in _KINDS:
            if kind.startswith(begins) and not right(value):
                raise InputError(f"{prefix}.{one.name}", value, expected)
        if kind.startswith("tuple[float"):
            _check_numbers(f"{prefix}.{one.name}", value, kind)


def _is_flag(value: object) -> bool:
    # Recognise NumPy's boolean, which is not a `bool`, without importing NumPy.
    return type(value).__name__ in ("bool", "bool_")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not _is_flag(value)


def _is_integer(value: object) -> bool:
    return isinstance(value, Integral) and not _is_flag(value)


def _check_numbers(field: str, value: object, kind: str) -> None:
    """Check a sequence of numbers and the length that its annotation states."""
    count = 0 if "..." in kind else kind.count("float")
    if isinstance(value, str) or not isinstance(value, Iterable):
        expected = f"must be {count} numbers" if count else "must be a sequence of numbers"
        raise InputError(field, value, expected)
    numbers = list(value)
    for i, number in enumerate(numbers):
        if not _is_number(number):
            raise InputError(f"{field}[{i}]", number, "must be a number")
    if count and len(numbers) != count:
        raise InputError(field, value, f"must be {count} numbers")


_KINDS = (
    ("float", _is_number, "must be a number"),
    ("int", _is_integer, "must be an integer"),
    ("bool", _is_flag, "must be true or false"),
)


def _format_value(value: object) -> str:
    """Return the text of a value, without its middle if it is long."""
    if isinstance(value, type):
        return value.__name__
    if isinstance(value, Path):
        value = str(value)
    if hasattr(value, "dtype") and hasattr(value, "tolist"):  # array or number of NumPy
        if getattr(value, "size", 1) > _MAX_SHOWN_ELEMENTS:
            return f"an array of shape {getattr(value, 'shape', ())}"
        value = value.tolist()
    try:
        text = repr(value)
    except RecursionError:
        text = reprlib.repr(value)
    except ValueError:  # an integer of more than 4,300 digits
        return f"a value of type {type(value).__name__} that is too long to show"
    if len(text) <= _MAX_SHOWN_CHARACTERS:
        return text
    half = _MAX_SHOWN_CHARACTERS // 2
    return f"{text[:half]} ... {text[-half:]}"


def error_reason(error: BaseException) -> str:
    """Return the first line of an error's message, or which key is missing.

    For an error of the operating system, return its reason alone, without number and path.
    """
    if isinstance(error, KeyError):
        return f"{error} is missing"
    if isinstance(error, UnicodeError):
        return "it is not text in UTF-8"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return str(error).split("\n", maxsplit=1)[0] or type(error).__name__


class NoThreadError(RuntimeError):
    """Error: no thread can be started any more in this process."""


class RenderingError(RuntimeError):
    """Error: this machine cannot render images; the message names what to install."""


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
        If the folder is unsuitable; the error names the option ``--out``.
    """
    if out.exists() and not out.is_dir():
        raise InputError("--out", str(out), "must be a folder, not a file")
    if out.exists() and any(hidden or not p.name.startswith(".") for p in out.iterdir()):
        raise InputError("--out", str(out), "must be a new or empty folder")
    check_writable(out)


def check_writable(out: Path) -> None:
    """Check that the folder `out` is writable or can be created, without creating it.

    Raises
    ------
    InputError
        If the folder is not writable; the error names the option ``--out``.
    """
    there = next(p for p in (out, *out.absolute().parents) if p.exists())
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise InputError(
            "--out",
            str(out),
            "must be a folder where you can create files",
            _explain_denial(there, error),
        ) from None


def check_output(field: str, path: Path, suffix: str) -> None:
    """Check that an output file has the right suffix and can be written.

    Parameters
    ----------
    field
        Option that an error names, such as ``--out``.
    path
        File to write; its folder must exist and be writable.
    suffix
        Required suffix, such as ``.png``.

    Raises
    ------
    InputError
        If a condition is not met; the error names `field`.
    """
    if path.suffix.lower() != suffix:
        raise InputError(field, str(path), f"must be a file name that ends in {suffix}")
    if not path.parent.is_dir():
        raise InputError(
            field,
            str(path),
            "must be in an existing folder",
            f"Create the folder {str(path.parent)!r} first.",
        )
    if path.is_dir():
        raise InputError(field, str(path), "must be a file, not a folder")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(
            field,
            str(path),
            "must be in a folder where you can create files",
            _explain_denial(path.parent, error),
        ) from None


def _explain_denial(folder: Path, error: OSError) -> str:
    return f"{folder} does not allow this ({error.strerror}). Choose another folder."


def suggestion(name: str, known: Iterable[str], noun: str = "names") -> str:
    """Return a sentence with the known name closest to a mistyped name.

    If no name is close, the sentence lists all known names. `noun` is the plural noun for them.

    Examples
    --------
    >>> suggestion("hemisphare", ["cube", "hemisphere"])
    "Did you mean 'hemisphere'?"
    """
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    if close:
        return f"Did you mean {close[0]!r}?"
    return f"Known {noun}: {', '.join(known)}." if known else f"There are no known {noun}."
