"""Detect changed results by digests (hashes) of golden cases.

A golden case is a short run with a fixed seed. The script records a digest of every quantity that a
case writes, and compares later digests with them.

    python scripts/golden.py record --at HEAD~3    # record that revision on this machine
    python scripts/golden.py check                 # compare the working tree with the record
    python scripts/golden.py check --complete      # also cameras, all instruments and a report

Results are bit-identical only on one machine (see docs/howto/reproducibility.md). A recording is
therefore kept in the ignored folder `out/golden` and never committed. Each state of the source has
its own folder of compiled kernels, and each case runs with a fixed number of threads. Figures are
not compared.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
from llvmlite.binding import get_host_cpu_name

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

from golden_parts.cases import CASES, COMPLETE, Digests  # noqa: E402

OUT = ROOT / "out" / "golden"
_PACKAGES = ("numba", "llvmlite", "numpy", "scipy", "moderngl", "opencv-python-headless", "qoco")
_COUNTS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "LP_NUM_THREADS")


@click.group()
def main() -> None:
    """Record digests of results and compare later results with them."""


_COMPLETE = click.option(
    "--complete",
    is_flag=True,
    help="Run also the cases of cameras, instruments and a campaign report.",
)
_JOBS = click.option(
    "--jobs", default=2, show_default=True, help="Number of cases that run in parallel."
)
_THREADS = click.option(
    "--threads",
    default=1,
    show_default=True,
    help="Number of threads per case; it does not change the results.",
)


@main.command()
@click.option(
    "--at", "revision", default=None, help="Git revision to run (default: the working tree)."
)
@_COMPLETE
@_JOBS
@_THREADS
def record(revision: str | None, complete: bool, jobs: int, threads: int) -> None:
    """Record the digests of a revision or of the working tree."""
    with _tree(revision) as tree:
        found = _run(tree, COMPLETE if complete else CASES, jobs, threads)
    OUT.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": _machine(), "of": revision or "working tree", "cases": found})
    (OUT / "recorded.json").write_text(text, encoding="utf-8")
    click.echo(f"recorded {sum(map(len, found.values()))} quantities of {len(found)} cases")


@main.command()
@_COMPLETE
@_JOBS
@_THREADS
def check(complete: bool, jobs: int, threads: int) -> None:
    """Compare results of the working tree with the record; status 1 if changed."""
    path = OUT / "recorded.json"
    if not path.is_file():
        raise click.UsageError("No record exists. Run `golden.py record --at REVISION` first.")
    recorded = json.loads(path.read_text(encoding="utf-8"))
    if recorded["machine"] != _machine():
        raise click.UsageError(
            "The record is from another machine or other packages. Record again with --at. "
            f"Recorded: {recorded['machine']}, here: {_machine()}"
        )
    cases = COMPLETE if complete else CASES
    missing = [name for name in cases if name not in recorded["cases"]]
    if missing:
        raise click.UsageError(
            f"The record lacks cases: {', '.join(missing)}. Record with the same options."
        )
    found = _run(ROOT, cases, jobs, threads)
    lines = [line for name in cases for line in changes(name, recorded["cases"][name], found[name])]
    for line in lines:
        click.echo(line)
    changed = sum(not line.startswith("renamed") for line in lines)
    click.echo(f"{changed} changes in {len(cases)} cases, compared with {recorded['of']}")
    sys.exit(1 if changed else 0)


def changes(case: str, before: Digests, after: Digests) -> Iterator[str]:
    """Yield a line of text for each changed, added, removed or renamed quantity.

    `before` and `after` are the digests of one golden case by quantity.
    """
    for name in sorted(before.keys() & after.keys()):
        if before[name][0] != after[name][0]:
            yield f"changed: {case}: {name}: {before[name][1]} -> {after[name][1]}"
    added = {name: after[name] for name in sorted(after.keys() - before.keys())}
    for name in sorted(before.keys() - after.keys()):
        same = next((new for new, digest in added.items() if digest[0] == before[name][0]), None)
        if same is None:
            yield f"removed: {case}: {name}: {before[name][1]}"
        else:
            del added[same]
            yield f"renamed: {case}: {name} -> {same}"
    for name, (_, summary) in added.items():
        yield f"added: {case}: {name}: {summary}"


@contextmanager
def _tree(revision: str | None) -> Iterator[Path]:
    """Yield a folder with the source of a Git revision; None is the working tree."""
    if revision is None:
        yield ROOT
        return
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(
            ["git", "worktree", "add", "--quiet", "--detach", str(tree), revision],
            cwd=ROOT, check=True,
        )  # fmt: skip
        try:
            yield tree
        finally:
            subprocess.run(
                ["git", "worktree", "remove", "--force", str(tree)], cwd=ROOT, check=True
            )


def _run(tree: Path, cases: dict[str, Any], jobs: int, threads: int) -> dict[str, Digests]:
    """Run cases with the source in the folder `tree`; return the digests of each.

    `jobs` is the number of parallel cases and `threads` the number of threads of each case.
    """
    begin = time.monotonic()
    found = {}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(_case, tree, name, Path(folder), threads): name for name in cases}
        for done in as_completed(running):
            found[running[done]] = done.result()
            click.echo(
                f"  {time.monotonic() - begin:4.0f} s  {len(found)} of {len(cases)}: "
                f"{running[done]}", err=True,
            )  # fmt: skip
    return found


def _case(tree: Path, name: str, folder: Path, threads: int) -> Digests:
    """Run one golden case in a separate process and return its digests.

    `tree` is the source folder and `folder` gets the results.
    """
    out = folder / f"{name}.json"
    environment = os.environ | dict.fromkeys(_COUNTS, str(threads)) | {
        "PYTHONPATH": os.pathsep.join(map(str, (tree, tree / "envs", ROOT / "scripts"))),
        "NUMBA_CACHE_DIR": str(OUT / "kernels" / _source_digest(tree)),
        "XDG_CACHE_HOME": str(folder),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "golden_parts.cases", name, str(out)],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise click.ClickException(f"{name} failed:\n{done.stderr[-3000:]}")
    digests: Digests = json.loads(out.read_text(encoding="utf-8"))
    return digests


def _source_digest(tree: Path) -> str:
    """Return a digest of all Python source in `tree`, which names the kernel cache.

    Compiled kernels of another source are therefore never used.
    """
    found = hashlib.blake2b(digest_size=12)
    for folder in ("lunarsim", "envs"):
        for path in sorted((tree / folder).rglob("*.py")):
            found.update(str(path.relative_to(tree)).encode() + path.read_bytes())
    return found.hexdigest()


def _machine() -> dict[str, str]:
    """Return the processor and package versions on which the bits of a result depend."""
    found = {"processor": get_host_cpu_name(), "python": platform.python_version()}
    return found | {name: version(name) for name in _PACKAGES}


if __name__ == "__main__":
    main()
