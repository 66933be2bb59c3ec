"""Locate the cache folder: the user's cache, or a temporary substitute.

The cache holds data that can be recomputed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

# Nothing can be read from this folder or written to it.
_NO_FOLDER = Path("/nonexistent")


def user_cache(name: str) -> Path:
    """Return the path of folder `name` in the user's cache, by the XDG rule.

    The folder need not exist.
    """
    return _cache_home() / "lunarsim" / name


def ensure_caches() -> None:
    """Select a temporary cache folder if the user's cache folder is not writable.

    A warning is printed then, and also if no folder can be created. The selection is stored in
    environment variables, so that other libraries and processes started later use it too.
    Matplotlib needs a folder for its configuration as well. A ``~`` that no shell has expanded is
    expanded here.
    """
    for variable in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        given = os.environ.get(variable, "")
        if given.startswith("~"):
            del os.environ[variable]
            if (folder := expanded(given)) != _NO_FOLDER:
                os.environ[variable] = str(folder)
    if not is_writable(_cache_home()):
        try:
            folder = _temporary_folder()
        except OSError as error:
            warn(f"no cache folder can be created ({error.strerror}): nothing is cached")
            return
        os.environ["XDG_CACHE_HOME"] = str(folder)
        warn(f"the user's cache folder cannot be written to: {folder} is used instead")
    if "MPLCONFIGDIR" not in os.environ and not is_writable(
        _xdg_folder("XDG_CONFIG_HOME", ".config")
    ):
        os.environ["MPLCONFIGDIR"] = str(_cache_home() / "matplotlib")


def expanded(folder: str) -> Path:
    """Return a path with ``~`` replaced by the home folder.

    Without a home folder, a path that cannot exist is returned.
    """
    if not folder.startswith("~"):
        return Path(folder)
    name, _, below = folder.partition("/")
    try:
        home = Path(name).expanduser()
    except RuntimeError:
        return _NO_FOLDER
    return home / below if home.is_absolute() and home.is_dir() else _NO_FOLDER


def is_writable(folder: Path) -> bool:
    """Return whether a folder is writable, or can be created if it does not exist."""
    try:
        existing = next(p for p in (folder, *folder.parents) if p.exists())
    except OSError:
        return False
    is_possible = _NO_FOLDER not in (folder, *folder.parents)
    return is_possible and existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


def warn(text: str) -> None:
    """Print a warning as one line on stderr, if stderr is open."""
    try:
        if sys.stderr is not None:
            print(f"lunarsim: {text}", file=sys.stderr, flush=True)
    except OSError:
        pass


def _cache_home() -> Path:
    return _xdg_folder("XDG_CACHE_HOME", ".cache")


def _xdg_folder(variable: str, below_home: str) -> Path:
    """Return an XDG base folder from an environment variable, or its default.

    `below_home` is the default folder relative to home; without a home, the path cannot exist.
    """
    given = Path(os.environ.get(variable, ""))
    if given.is_absolute():
        return given
    return expanded(f"~/{below_home}")


def _temporary_folder() -> Path:
    """Create a temporary cache folder for this user only and return its path.

    All processes of the user share the folder. If a folder of its name exists with another owner,
    or with access for other users, a new folder is created for this process.
    """
    import stat  # noqa: PLC0415  (seldom needed)
    import tempfile  # noqa: PLC0415

    folder = Path(tempfile.gettempdir()) / f"lunarsim-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        found = folder.lstat()
        is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
        if not is_own or found.st_mode & 0o077:
            return Path(tempfile.mkdtemp(prefix="lunarsim-"))
    return folder
