"""C code of a nonlinear program, compiled once and kept.

CasADi writes the program and its derivatives as C; a compiler makes a library of it, in the user's
cache folder, named by what was written.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError
from lunarsim.optimal.errors import SolverError
from lunarsim.user_cache import user_cache
from lunarsim.whole_files import write_whole

# -O1: -O2 takes three times as long to compile, for a program that is no faster.
_FLAGS = ("-O1", "-fPIC", "-shared")


def compiler() -> str | None:
    """Return the C compiler: $CC, cc, gcc or clang, the first there is; None for none."""
    wanted = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((found for name in wanted if name and (found := shutil.which(name))), None)


def compiled_library(name: str, make: Callable[[], Any]) -> Path:
    """Return the library of a program's functions.

    Parameters
    ----------
    name
        Begins its file name.
    make
        Returns the solver whose functions are written.

    Raises
    ------
    InputError
        If there is no compiler.
    SolverError
        If it fails.
    """
    with_what = compiler()
    if with_what is None:
        raise InputError("optimal.compiled", True, "false where no C compiler is (set CC to one)")
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / f"{name}.c"
        here = Path.cwd()
        os.chdir(folder)  # CasADi writes where it stands
        try:
            make().generate_dependencies(source.name)
        finally:
            os.chdir(here)
        digest = hashlib.sha256(source.read_bytes() + " ".join(_FLAGS).encode()).hexdigest()[:16]
        library = user_cache("optimal") / f"{name}-{digest}.so"
        if not library.exists():
            library.parent.mkdir(parents=True, exist_ok=True)
            write_whole(library, lambda part: _compile(with_what, source, part))
    return library


def _compile(with_what: str, source: Path, library: Path) -> None:
    done = subprocess.run(
        [with_what, *_FLAGS, "-o", str(library), str(source), "-lm"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SolverError(f"{with_what} fails on CasADi's code: {done.stderr.strip()[-300:]}")
