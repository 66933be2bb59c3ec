"""Compiled C code of nonlinear programs, cached in the user's cache folder.

CasADi writes the program and its derivatives as C; a compiler builds a library. Its file name
contains a hash of the source.
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

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError
from lunarsim.optimal.errors import SolverError
from lunarsim.user_cache import user_cache

# -O1: -O2 takes three times as long to compile, and the program is not faster.
_FLAGS = ("-O1", "-fPIC", "-shared")


def find_compiler() -> str | None:
    """Return the first available C compiler of $CC, cc, gcc and clang, or None."""
    wanted = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((found for name in wanted if name and (found := shutil.which(name))), None)


def compiled_library(name: str, build_solver: Callable[[], Any]) -> Path:
    """Compile the functions of a CasADi solver to a library, or find it in the cache.

    The result is the path of the library.

    Parameters
    ----------
    name
        Start of the file name.
    build_solver
        Function that returns the solver.

    Raises
    ------
    InputError
        If there is no compiler.
    SolverError
        If the compiler fails.
    """
    compiler_path = find_compiler()
    if compiler_path is None:
        raise InputError(
            "optimal.compiled",
            True,
            "must be False without a C compiler",
            "Install one, or name it in the environment variable CC.",
        )
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / f"{name}.c"
        working_directory = Path.cwd()
        os.chdir(folder)  # CasADi writes to the working directory
        try:
            build_solver().generate_dependencies(source.name)
        finally:
            os.chdir(working_directory)
        digest = hashlib.sha256(source.read_bytes() + " ".join(_FLAGS).encode()).hexdigest()[:16]
        library = user_cache("optimal") / f"{name}-{digest}.so"
        if not library.exists():
            library.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(library, lambda part: _compile(compiler_path, source, part))
    return library


def _compile(compiler_path: str, source: Path, library: Path) -> None:
    """Compile a C file to a shared library; raise SolverError if that fails."""
    process = subprocess.run(
        [compiler_path, *_FLAGS, "-o", str(library), str(source), "-lm"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if process.returncode:
        raise SolverError(
            f"{compiler_path} cannot compile CasADi's code: {process.stderr.strip()[-300:]}"
        )
