"""How the `lunarsim` command is run: Ctrl-C ends it with one line and code 130, at any time.

Libraries swallow interrupts: what is raised within the C code of a compiler, or while an object is
freed, is lost or comes out as another error. Here an interrupt is raised again until it is heard.
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
# Until an interrupt that nobody has heard is raised again, s.
_AGAIN = 0.25

_taken: list[int] = []
_ended: list[int] = []


def heard() -> None:
    """Let the interrupt be: whoever calls this ends what it was meant to end."""
    if _taken:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _taken.clear()


def run(command: Callable[[], Any]) -> None:
    """Run a command to its end or to the first interrupt."""
    _check_process()
    # Workers start as `python -c`, which would import modules from the working folder: it may hold
    # a multiprocessing.py from somebody else. They take over the search path of this process.
    os.environ["PYTHONSAFEPATH"] = "1"
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _take)
        sys.unraisablehook = _quiet
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _take)  # a polite kill is an interrupt, as in a campaign
    # What is registered first is called last: temporary folders are gone by then.
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
        if not isinstance(error, SystemExit):  # what an interrupt in the wrong place becomes
            print("interrupted", file=sys.stderr)
        elif not error.code:
            print("interrupted: at the end, all was done", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        heard()
        if signal.getsignal(signal.SIGINT) is _take:
            # What is left is to leave: another one would make a done command a killed one.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if signal.getsignal(signal.SIGTERM) is _take:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _check_process() -> None:
    """Exit with one line if stdout is closed or the working folder is deleted."""
    if sys.stderr is None:
        # A data file must not get the number of stderr: C libraries write messages there.
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    if sys.stdout is None:
        sys.exit("error: output: stdout is closed. Redirect it to a file or to /dev/null.")
    try:
        Path.cwd()
    except OSError as error:
        sys.exit(f"error: working folder: {error.strerror}. Change to an existing folder.")


def end_of(error: KeyboardInterrupt) -> str:
    """Return the line that tells of an interrupt, and of what is there if its raiser said so."""
    return f"interrupted: {error}" if error.args else "interrupted"


def _leave() -> None:
    """End the process of an interrupted command with its code.

    An interrupt within a text that Python evaluates, as it does to make dataclasses, would end it
    by a signal although it was heard; and what compilers hold takes seconds to free.
    """
    if _ended:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(_ended[0])


def _take(number: int, frame: FrameType | None) -> None:
    """Raise the interrupt, now and later."""
    _taken.append(number)
    signal.signal(signal.SIGALRM, _raise_again)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
    raise KeyboardInterrupt


def _raise_again(number: int, frame: FrameType | None) -> None:
    """Raise the interrupt if it is lost, not where it is just making its way out."""
    error = sys.exception()
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    if error is None:
        raise KeyboardInterrupt


def _quiet(unraisable: Any) -> None:
    """Say nothing of an interrupt that was lost: it is raised again."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
