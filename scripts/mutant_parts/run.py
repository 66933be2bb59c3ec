"""Run the trials of many faults in parallel and store their results."""

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

from .faults import Mutant
from .trial import MutantWorkspace, TrialStopped


@dataclass(frozen=True)
class MutantResult:
    """Stored result of the trial of one fault.

    `verdict` is the outcome ("caught", "survived", ...) and `test` the first failed test, from
    `MutantWorkspace.trial`; `seconds` is the time of the trial. `source` and `tests` are digests of
    the file and of its tests at the time of the trial.
    """

    fault: str
    verdict: str
    test: str
    seconds: float
    source: str
    tests: str


def _digest(paths: list[Path]) -> str:
    """Return a hash of files and of the Python files in folders."""
    files = [f for p in paths for f in (sorted(p.rglob("*.py")) if p.is_dir() else [p])]
    return hashlib.sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest()[:16]


class MutationRun:
    """Run trials of faults in parallel, and store and reuse their results.

    Parameters
    ----------
    root
        Working tree.
    kept
        File of JSON lines, one per result; it is read and extended. A line with the name of a file
        is the run of its tests without a fault.
    tests
        Test files and folders of each kernel file, relative to `root`.

    Raises
    ------
    ValueError
        If `kept` is not a file of results.
    """

    def __init__(self, root: Path, kept: Path, tests: dict[str, list[str]]) -> None:
        self._root = root
        self._file = kept
        self._tests = tests
        self._kept: dict[str, MutantResult] = {}
        self._writing = threading.Lock()
        if kept.exists():
            for n, line in enumerate(kept.read_text(encoding="utf-8").splitlines(), 1):
                try:
                    result = MutantResult(**json.loads(line))
                except (TypeError, json.JSONDecodeError) as error:
                    raise ValueError(
                        f"{kept}: line {n}: must be the JSON result of a fault"
                    ) from error
                self._kept[result.fault] = result
        self._digests = {
            path: (_digest([root / path]), _digest([root / t for t in names]))
            for path, names in tests.items()
        }

    def known(self, fault: Mutant) -> MutantResult | None:
        """Return the stored result of a fault, or None if there is no valid result."""
        return self._valid_result(fault.name, fault.path)

    def _valid_result(self, name: str, path: str) -> MutantResult | None:
        """Return a stored result if file and, for survivors, tests are unchanged."""
        kept = self._kept.get(name)
        source, tests = self._digests[path]
        if kept is None or kept.source != source:
            return None
        return kept if kept.verdict != "survived" or kept.tests == tests else None

    def run(
        self, faults: list[Mutant], jobs: int, limit: float, report: Callable[[MutantResult], None]
    ) -> None:
        """Try faults, one file at a time, and store their results.

        Parameters
        ----------
        faults
            Faults to try.
        jobs
            Number of parallel trials, each in its own copy.
        limit
            Time limit of one fault, s. The actual limit is smaller if the tests are fast: 30 s plus
            three times their time without a fault.
        report
            Callback for every result.

        Raises
        ------
        BrokenTestsError
            If the tests of a file fail without a fault.
        """
        spaces: queue.Queue[MutantWorkspace] = queue.Queue()

        made: list[MutantWorkspace] = []

        def work(group: list[Mutant]) -> None:
            space = spaces.get()
            try:
                needed = self._time_without_fault(space, group[0].path)
                for fault in group:
                    report(self._try_fault(space, fault, min(limit, 30.0 + 3.0 * needed)))
            except TrialStopped:
                pass
            finally:
                spaces.put(space)

        groups: dict[str, list[Mutant]] = {}
        for fault in faults:
            groups.setdefault(fault.path, []).append(fault)
        with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
            for job in range(min(jobs, len(groups))):
                made.append(MutantWorkspace(self._root, Path(folder) / str(job)))
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

    def _time_without_fault(self, space: MutantWorkspace, path: str) -> float:
        """Return the test time of a file without a fault, s, stored or measured now."""
        kept = self._valid_result(path, path)
        if kept is None:
            seconds = round(space.run_without_fault(path, self._tests[path]), 1)
            kept = MutantResult(path, "survived", "", seconds, *self._digests[path])
            self._keep(kept)
        return kept.seconds

    def _try_fault(self, space: MutantWorkspace, fault: Mutant, limit: float) -> MutantResult:
        """Try a fault in a workspace with a time limit, s, and store the result."""
        start = time.monotonic()
        outcome, test = space.trial(fault, self._tests[fault.path], limit)
        seconds = round(time.monotonic() - start, 1)
        result = MutantResult(fault.name, outcome, test, seconds, *self._digests[fault.path])
        self._keep(result)
        return result

    def _keep(self, result: MutantResult) -> None:
        """Append a result to the file of results."""
        with self._writing, self._file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(asdict(result)) + "\n")
        self._kept[result.fault] = result
