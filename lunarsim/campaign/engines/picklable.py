"""Check that objects can be sent to worker processes."""

from __future__ import annotations

import io
import pickle
from multiprocessing.spawn import get_preparation_data
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError


def check_picklable(field: str, value: object) -> None:
    """Raise `InputError` if worker processes cannot load an object.

    Parameters
    ----------
    field
        Name of the object in the error message.
    value
        Any object.

    Raises
    ------
    InputError
        If the object cannot be pickled, or needs a class or function that exists only in this
        process, for instance in a notebook. A text ``module:Name`` is checked too.
    """
    kind = value if isinstance(value, str) else type(value).__qualname__
    sent = io.BytesIO()
    sender = _NamePickler(sent)
    try:
        sender.dump(value)
        found = _NameUnpickler(io.BytesIO(sent.getvalue()))
        found.load()
    except Exception as error:  # pickling hooks may raise anything
        reason = str(error).split("\n")[0]
        raise InputError(
            field,
            kind,
            f"must be an object that pickle can send to worker processes ({reason})",
            "Use jobs = 1.",
        ) from None
    main_names = found.main_names + sender.main_names
    if main_names and not _is_main_importable():
        raise InputError(
            field, kind,
            f"uses {main_names[0]}, which worker processes cannot import from a notebook or an "
            "interactive session", f"Move {main_names[0]} into a module file, or use jobs = 1.",
            show_value=False,
        )  # fmt: skip


class _NamePickler(pickle.Pickler):
    """Pickler that collects class names in strings such as ``__main__:Mine``."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.main_names: list[str] = []

    def persistent_id(self, value: Any) -> None:
        """Collect the class name in a string; the value is pickled as usual."""
        if isinstance(value, str) and value.startswith("__main__:"):
            self.main_names.append(value.partition(":")[2])


class _NameUnpickler(pickle.Unpickler):
    """Unpickler that collects the names that it loads from module ``__main__``."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.main_names: list[str] = []

    def find_class(self, module: str, name: str) -> Any:
        """Return a class or function by its name."""
        if module == "__main__":
            self.main_names.append(name)
        return super().find_class(module, name)


def _is_main_importable() -> bool:
    """Return whether a spawned process can load this process's ``__main__`` module."""
    data = get_preparation_data("worker")
    path = data.get("init_main_from_path")
    return "init_main_from_name" in data or (path is not None and Path(path).is_file())
