"""The trials of many faults, side by side, and the file in which their results are kept."""

from __future__ import annotations

import hashlib
import json
import queue
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

from .faults import Fault
from .trial import Stopped, Workspace


@dataclass(frozen=True)
class Result:
    """What became of a fault; `verdict` and `test` as `Workspace.trial` has them.

    `source` and `tests` are digests of the file and of its tests at the time.
    """

    fault: str
    verdict: str
    test: str
    seconds: float
    source: str
    tests: str


def _digest(paths: list[Path]) -> str:
    """Return a hash of what stands in files and in the Python files of folders."""
    files = [f for p in paths for f in (sorted(p.rglob("*.py")) if p.is_dir() else [p])]
    return hashlib.sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest()[:16]


class Trials:
    """Trials of faults.

    Parameters
    ----------
    root
        Working tree.
    kept
        File of JSON lines, one a result; it is read, and what is found is added. A line that
        names a file alone is the run of its tests without a fault.
    tests
        Test files and folders of each kernel file, relative to `root`.

    Raises
    ------
    ValueError
        If `kept` holds something else.
    """

    def __init__(self, root: Path, kept: Path, tests: dict[str, list[str]]) -> None:
        self._root = root
        self._file = kept
        self._tests = tests
        self._kept: dict[str, Result] = {}
        self._writing = threading.Lock()
        if kept.exists():
            for n, line in enumerate(kept.read_text(encoding="utf-8").splitlines(), 1):
                try:
                    result = Result(**json.loads(line))
                except (TypeError, json.JSONDecodeError) as error:
                    raise ValueError(f"{kept}, line {n}, is no result of a fault") from error
                self._kept[result.fault] = result
        self._digests = {
            path: (_digest([root / path]), _digest([root / t for t in names]))
            for path, names in tests.items()
        }

    def known(self, fault: Fault) -> Result | None:
        """Return what was kept of a fault, unless its file, or a survivor's tests, have changed."""
        return self._holding(fault.name, fault.path)

    def _holding(self, name: str, path: str) -> Result | None:
        kept = self._kept.get(name)
        source, tests = self._digests[path]
        if kept is None or kept.source != source:
            return None
        return kept if kept.verdict != "survived" or kept.tests == tests else None

    def run(
        self, faults: list[Fault], jobs: int, limit: float, tell: Callable[[Result], None]
    ) -> None:
        """Try faults, a file at a time, and keep their results.

        Parameters
        ----------
        faults
            What to try.
        jobs
            How many at a time, each in a copy of its own.
        limit
            Longest time of one fault, s. Less is allowed where the tests take less: half a minute
            and three times what they take without a fault.
        tell
            Is given every result.

        Raises
        ------
        BrokenTestsError
            If the tests of a file fail without a fault.
        """
        spaces: queue.Queue[Workspace] = queue.Queue()

        made: list[Workspace] = []

        def work(group: list[Fault]) -> None:
            space = spaces.get()
            try:
                needed = self._unchanged(space, group[0].path)
                for fault in group:
                    tell(self._tried(space, fault, min(limit, 30.0 + 3.0 * needed)))
            except Stopped:
                pass
            finally:
                spaces.put(space)

        groups: dict[str, list[Fault]] = {}
        for fault in faults:
            groups.setdefault(fault.path, []).append(fault)
        with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
            for job in range(min(jobs, len(groups))):
                made.append(Workspace(self._root, Path(folder) / str(job)))
                spaces.put(made[-1])
            with ThreadPoolExecutor(jobs) as pool:
                futures = [pool.submit(work, group) for group in groups.values()]
                try:
                    for future in as_completed(futures):
                        future.result()
                except BaseException:
                    for space in made:
                        space.stop()
                    pool.shutdown(cancel_futures=True)
                    raise

    def _unchanged(self, space: Workspace, path: str) -> float:
        """Return what the tests of a file take without a fault, s, as kept or as tried now."""
        kept = self._holding(path, path)
        if kept is None:
            seconds = round(space.unchanged(path, self._tests[path]), 1)
            kept = Result(path, "survived", "", seconds, *self._digests[path])
            self._keep(kept)
        return kept.seconds

    def _tried(self, space: Workspace, fault: Fault, limit: float) -> Result:
        """Try a fault and keep its result."""
        start = time.monotonic()
        verdict, test = space.trial(fault, self._tests[fault.path], limit)
        seconds = round(time.monotonic() - start, 1)
        result = Result(fault.name, verdict, test, seconds, *self._digests[fault.path])
        self._keep(result)
        return result

    def _keep(self, result: Result) -> None:
        with self._writing, self._file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(asdict(result)) + "\n")
        self._kept[result.fault] = result
