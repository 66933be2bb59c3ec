"""Run the `lunarsim` command so that Ctrl-C always ends it with one line and code 130.

Libraries swallow interrupts: a KeyboardInterrupt raised in the C code of a compiler, or while an
object is freed, is lost or becomes another error. This module raises an interrupt again every
0.25 s until a handler acknowledges it.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

INTERRUPTED = 130
# Time until an unacknowledged interrupt is raised again, s.
_AGAIN = 0.25

_taken: list[int] = []
_ended: list[int] = []


def heard() -> None:
    """Acknowledge the interrupt, so that it is not raised again."""
    if _taken:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _taken.clear()


def run(command: Callable[[], Any]) -> None:
    """Run a command until it ends or is interrupted."""
    _check_process()
    # Workers start as `python -c`, which would import modules from the working folder, for example
    # an unrelated multiprocessing.py. They use the search path of this process instead.
    os.environ["PYTHONSAFEPATH"] = "1"
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _take)
        sys.unraisablehook = _quiet
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _take)  # handle SIGTERM like Ctrl-C, as campaigns do
    # The first registered function runs last, after temporary folders have been removed.
    atexit.register(_leave)
    try:
        command()
    except KeyboardInterrupt as error:
        heard()
        _ended.append(INTERRUPTED)
        print(end_of(error), file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BaseException as error:
        if not _taken:
            if isinstance(error, SystemExit) and error.code == INTERRUPTED:
                _ended.append(INTERRUPTED)
            if isinstance(error, OSError):  # raised outside of a command, for instance by --help
                sys.exit(f"error: output: {error.strerror or error}")
            raise
        heard()
        _ended.append(INTERRUPTED)
        if not isinstance(error, SystemExit):  # an interrupt that a library has turned into this
            print("interrupted", file=sys.stderr)
        elif not error.code:
            print("interrupted: the command had already finished", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        heard()
        if signal.getsignal(signal.SIGINT) is _take:
            # Only the exit is left: another interrupt would report a finished command as killed.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if signal.getsignal(signal.SIGTERM) is _take:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _check_process() -> None:
    """Exit with one line if stdout is closed or the working folder is deleted."""
    if sys.stderr is None:
        # A data file must not get the descriptor of stderr: C libraries write messages there.
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    if sys.stdout is None:
        sys.exit("error: output: stdout is closed. Redirect it to a file or /dev/null.")
    try:
        Path.cwd()
    except OSError as error:
        sys.exit(f"error: working folder: {error.strerror}. Change to an existing folder.")


def end_of(error: KeyboardInterrupt) -> str:
    """Return the message of an interrupt, with the text that its raiser added."""
    return f"interrupted: {error}" if error.args else "interrupted"


def _leave() -> None:
    """End the process of an interrupted command with its exit code.

    Without this, an interrupt inside `exec` (which creates dataclasses) would end the process by a
    signal although it was acknowledged, and freeing the compiler's memory would take seconds.
    """
    if _ended:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(_ended[0])


def _take(number: int, frame: FrameType | None) -> None:
    """Raise the interrupt now, and again until it is acknowledged."""
    _taken.append(number)
    signal.signal(signal.SIGALRM, _raise_again)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
    raise KeyboardInterrupt


def _raise_again(number: int, frame: FrameType | None) -> None:
    """Raise the interrupt again, unless it is still propagating."""
    error = sys.exception()
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    if error is None:
        raise KeyboardInterrupt


def _quiet(unraisable: Any) -> None:
    """Ignore lost interrupts, which are raised again; report other exceptions."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
