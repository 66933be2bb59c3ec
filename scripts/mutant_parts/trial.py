"""Try one fault: put it into a copy of the package and run the tests there."""

from __future__ import annotations

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from .faults import Mutant

CAUGHT = ("caught", "crashed", "timed out")
_COPIED = ("lunarsim", "envs", "scenarios", "tests", "pyproject.toml")
_PYTEST = ["-x", "-q", "--no-header", "--tb=line", "-p", "no:cacheprovider"]
# Numba rejects the types at the fault: it cannot run, so no test detects it.
_REFUSED = re.compile(
    r"numba\.core\.errors\.\w+|(Typing|Lowering|UnsupportedBytecode|Unsupported)Error"
)
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


class BrokenTestsError(RuntimeError):
    """Error: the tests cannot be run, or fail without a fault."""


class TrialStopped(Exception):  # noqa: N818
    """Signal that a trial was stopped by another thread and has no result."""


def importers(files: Iterable[Path], root: Path) -> dict[str, set[str]]:
    """Return the direct and indirect importers of each file, and the file itself.

    Numba links a kernel into the cached code of its callers and does not check whether it changed.

    Parameters
    ----------
    files
        Python files that import one another by absolute names.
    root
        Folder of their package, or that holds a folder ``envs`` with it. The returned paths are
        relative to it.
    """
    names = {p.relative_to(root).as_posix(): p for p in files}
    modules = {
        name.removesuffix(".py").removeprefix("envs/").replace("/", "."): name for name in names
    }
    users: dict[str, set[str]] = {name: {name} for name in names}
    for name, path in names.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module in modules:
                users[modules[node.module]].add(name)
    for _ in users:
        for name, mine in users.items():
            users[name] = mine.union(*(users[user] for user in mine))
    return users


class MutantWorkspace:
    """Copy of lunarsim and its tests, into which faults are put one after the other.

    Parameters
    ----------
    root
        Working tree; it is not modified.
    folder
        Empty folder for the copy.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder = folder
        for name in _COPIED:
            if (root / name).is_dir():
                shutil.copytree(root / name, folder / name, symlinks=True)
            elif (root / name).exists():
                shutil.copy2(root / name, folder / name)
        self._stopped = threading.Event()
        self._process: subprocess.Popen[str] | None = None
        files = [p for part in ("lunarsim", "envs") for p in sorted((folder / part).rglob("*.py"))]
        compiled = [p for p in files if "kernel" in p.read_text(encoding="utf-8")]
        self._users = importers(compiled, folder)

    def run_without_fault(self, path: str, tests: list[str]) -> float:
        """Run the tests of a file without a fault, after recompiling its kernels.

        Returns
        -------
        float
            Time, s.

        Raises
        ------
        BrokenTestsError
            If the tests do not pass.
        """
        for file in self._compiled(path):
            file.unlink()
        start = time.monotonic()
        outcome, output = self._run(tests, None)
        if outcome != "survived":
            raise BrokenTestsError(
                f"tests of {path}: must pass without a fault, but fail:\n{output}"
            )
        return time.monotonic() - start

    def trial(self, fault: Mutant, tests: list[str], limit: float) -> tuple[str, str]:
        """Run the tests with a fault; return the outcome and the first failed test.

        Parameters
        ----------
        fault
            Fault to try.
        tests
            Test files, in order; the run ends at the first failure.
        limit
            Time after which the fault counts as caught, s.

        Returns
        -------
        tuple of str
            "caught", "crashed", "timed out", "survived" or "refused" (by the compiler); the name of
            the failed test, or "".
        """
        with self._with_fault(fault):
            outcome, output = self._run(tests, limit)
        failed = _FAILED.search(output)
        if outcome == "caught" and _REFUSED.search(output):
            outcome = "refused"
        return outcome, failed.group(1) if failed else ""

    def stop(self) -> None:
        """End the current trial of another thread; it and later ones raise `TrialStopped`."""
        self._stopped.set()
        process = self._process
        if process is not None and process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)

    def _compiled(self, path: str) -> list[Path]:
        """Return the cached files of compiled kernels that contain kernels of a file."""
        return [
            cached
            for user in self._users.get(path, {path})
            for cached in (self.folder / user).parent.glob(f"__pycache__/{Path(user).stem}.*.nb?")
        ]

    @contextmanager
    def _with_fault(self, fault: Mutant) -> Iterator[None]:
        """Put a fault into a file and hide its compiled kernels within a `with` statement."""
        file = self.folder / fault.path
        stat = file.stat()
        source = file.read_bytes()
        stored = self.folder / "compiled"
        kept = [(cached, stored / str(n)) for n, cached in enumerate(self._compiled(fault.path))]
        stored.mkdir()
        for cached, place in kept:
            cached.rename(place)
        file.write_text(fault.apply(source.decode()), encoding="utf-8")
        _forget_byte_code(file)
        try:
            yield
        finally:
            file.write_bytes(source)
            # Numba and Python decide by size and time whether their caches match the source.
            os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
            for cached in self._compiled(fault.path):
                cached.unlink()
            _forget_byte_code(file)
            for cached, place in kept:
                place.rename(cached)
            stored.rmdir()

    def _run(self, tests: list[str], limit: float | None) -> tuple[str, str]:
        """Run tests in the copy, with a time limit, s; return outcome and output."""
        if self._stopped.is_set():
            raise TrialStopped
        environment = dict(
            os.environ, PYTHONPATH=os.pathsep.join((str(self.folder), str(self.folder / "envs")))
        )
        # the copy has its own cache in its package folders
        environment.pop("NUMBA_CACHE_DIR", None)
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *_PYTEST, *tests],
            cwd=self.folder, env=environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self._process = process
        try:
            output, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            return "timed out", ""
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
        if self._stopped.is_set():
            raise TrialStopped
        code = process.returncode
        if code < 0 or code > 128:
            return "crashed", output
        if code in (1, 2):  # tests failed, or could not be imported
            return "caught", output
        if code != 0:
            raise BrokenTestsError(f"pytest ended with {code}:\n{output}")
        return "survived", output


def _forget_byte_code(file: Path) -> None:
    """Delete the byte code of a module, which could seem valid for a new source.

    Python compares only sizes, and times in integer seconds.
    """
    for byte_code in file.parent.glob(f"__pycache__/{file.stem}.*.pyc"):
        byte_code.unlink()
