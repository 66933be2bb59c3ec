"""The trial of one fault: a copy of the package with the fault in it, and the tests run on it."""

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

from .faults import Fault

CAUGHT = ("caught", "crashed", "timed out")
_COPIED = ("lunarsim", "envs", "scenarios", "tests", "pyproject.toml")
_PYTEST = ["-x", "-q", "--no-header", "--tb=line", "-p", "no:cacheprovider"]
# Numba refuses types in a fault's place: the fault cannot run, so no test is shown to catch it.
_REFUSED = re.compile(
    r"numba\.core\.errors\.\w+|(Typing|Lowering|UnsupportedBytecode|Unsupported)Error"
)
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


class BrokenTestsError(RuntimeError):
    """The tests cannot be run, or fail without a fault."""


class Stopped(Exception):  # noqa: N818
    """A trial was stopped from outside, and tells nothing."""


def importers(files: Iterable[Path], root: Path) -> dict[str, set[str]]:
    """Return for each file those that use it, at first or any hand, itself among them.

    Numba links a kernel into the cached code of its callers and does not look whether it changed.

    Parameters
    ----------
    files
        Python files that import one another by absolute names.
    root
        Folder in which their package stands. The answer has paths relative to it.
    """
    names = {p.relative_to(root).as_posix(): p for p in files}
    modules = {name.removesuffix(".py").replace("/", "."): name for name in names}
    users: dict[str, set[str]] = {name: {name} for name in names}
    for name, path in names.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module in modules:
                users[modules[node.module]].add(name)
    for _ in users:
        for name, mine in users.items():
            users[name] = mine.union(*(users[user] for user in mine))
    return users


class Workspace:
    """A copy of package and tests, with its compiled kernels, that faults are put into in turn.

    Parameters
    ----------
    root
        Working tree; nothing is written there.
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
        self._users = importers(sorted(folder.glob("lunarsim/**/*kernels.py")), folder)

    def unchanged(self, path: str, tests: list[str]) -> float:
        """Run the tests of a file without a fault, with its kernels compiled anew.

        Returns
        -------
        float
            Time, s.

        Raises
        ------
        BrokenTestsError
            If they do not pass.
        """
        for file in self._compiled(path):
            file.unlink()
        start = time.monotonic()
        verdict, output = self._run(tests, None)
        if verdict != "survived":
            raise BrokenTestsError(f"without a fault the tests of {path} fail:\n{output}")
        return time.monotonic() - start

    def trial(self, fault: Fault, tests: list[str], limit: float) -> tuple[str, str]:
        """Return what became of a fault, and the first test that failed.

        Parameters
        ----------
        fault
            What to put in.
        tests
            Test files, in the order in which they are run up to the first failure.
        limit
            Time after which the fault is taken to be caught, s.

        Returns
        -------
        tuple of str
            "caught", "crashed", "timed out", "survived" or "refused" (by the compiler); the
            test's name, or "".
        """
        with self._with_fault(fault):
            verdict, output = self._run(tests, limit)
        failed = _FAILED.search(output)
        if verdict == "caught" and _REFUSED.search(output):
            verdict = "refused"
        return verdict, failed.group(1) if failed else ""

    def stop(self) -> None:
        """End the trial under way, in another thread; it and all later ones raise `Stopped`."""
        self._stopped.set()
        process = self._process
        if process is not None and process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)

    def _compiled(self, path: str) -> list[Path]:
        """Return the cached kernels into which those of a file are compiled."""
        return [
            cached
            for user in self._users.get(path, {path})
            for cached in (self.folder / user).parent.glob(f"__pycache__/{Path(user).stem}.*.nb?")
        ]

    @contextmanager
    def _with_fault(self, fault: Fault) -> Iterator[None]:
        """Put a fault in, set the kernels compiled without it aside, and restore both."""
        file = self.folder / fault.path
        stat = file.stat()
        source = file.read_bytes()
        aside = self.folder / "compiled"
        kept = [(cached, aside / str(n)) for n, cached in enumerate(self._compiled(fault.path))]
        aside.mkdir()
        for cached, place in kept:
            cached.rename(place)
        file.write_text(fault.applied(source.decode()), encoding="utf-8")
        _forget_byte_code(file)
        try:
            yield
        finally:
            file.write_bytes(source)
            # Numba and Python tell by size and time whether what they cached is of this source.
            os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
            for cached in self._compiled(fault.path):
                cached.unlink()
            _forget_byte_code(file)
            for cached, place in kept:
                place.rename(cached)
            aside.rmdir()

    def _run(self, tests: list[str], limit: float | None) -> tuple[str, str]:
        """Return the verdict of the tests, and what they printed."""
        if self._stopped.is_set():
            raise Stopped
        environment = dict(
            os.environ, PYTHONPATH=os.pathsep.join((str(self.folder), str(self.folder / "envs")))
        )
        environment.pop("NUMBA_CACHE_DIR", None)  # the copy has its own beside its modules
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
            raise Stopped
        code = process.returncode
        if code < 0 or code > 128:
            return "crashed", output
        if code in (1, 2):  # tests failed, or could not be imported
            return "caught", output
        if code != 0:
            raise BrokenTestsError(f"pytest ended with {code}:\n{output}")
        return "survived", output


def _forget_byte_code(file: Path) -> None:
    """Delete the byte code of a module; Python would take it for a new source of the same second.

    Python compares sizes, and times in whole seconds.
    """
    for byte_code in file.parent.glob(f"__pycache__/{file.stem}.*.pyc"):
        byte_code.unlink()
