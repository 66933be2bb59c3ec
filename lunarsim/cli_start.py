"""Run `lunarsim` so that Ctrl-C always ends it with one line and code 130.

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
_RERAISE_INTERVAL_S = 0.25

_pending_interrupts: list[int] = []
_exit_codes: list[int] = []


def acknowledge_interrupt() -> None:
    """Acknowledge the pending interrupt (Ctrl-C), so that it is not raised again."""
    if _pending_interrupts:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _pending_interrupts.clear()


def run(command: Callable[[], Any]) -> None:
    """Run a command (a function); after an interrupt, exit with code 130 and one line."""
    _check_process()
    # Workers start as `python -c`, which would import modules from the working folder, for example
    # an unrelated multiprocessing.py. They use the search path of this process instead.
    os.environ["PYTHONSAFEPATH"] = "1"
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _raise_interrupt)
        sys.unraisablehook = _ignore_lost_interrupt
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(
            signal.SIGTERM, _raise_interrupt
        )  # handle SIGTERM like Ctrl-C, as campaigns do
    # The first registered function runs last, after temporary folders have been removed.
    atexit.register(_exit_interrupted)
    try:
        command()
    except KeyboardInterrupt as error:
        acknowledge_interrupt()
        _exit_codes.append(INTERRUPTED)
        print(interrupt_message(error), file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BaseException as error:
        if not _pending_interrupts:
            if isinstance(error, SystemExit) and error.code == INTERRUPTED:
                _exit_codes.append(INTERRUPTED)
            if isinstance(error, OSError):  # raised outside of a command, for instance by --help
                sys.exit(f"error: output: {error.strerror or error}")
            raise
        acknowledge_interrupt()
        _exit_codes.append(INTERRUPTED)
        if not isinstance(error, SystemExit):  # an interrupt that a library has turned into this
            print("interrupted", file=sys.stderr)
        elif not error.code:
            print("interrupted: the command had already finished", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        acknowledge_interrupt()
        if signal.getsignal(signal.SIGINT) is _raise_interrupt:
            # Only the exit is left: another interrupt would report a finished command as killed.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if signal.getsignal(signal.SIGTERM) is _raise_interrupt:
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


def interrupt_message(error: KeyboardInterrupt) -> str:
    """Return the message that the user sees after an interrupt.

    It contains the text of the exception, if there is any.
    """
    return f"interrupted: {error}" if error.args else "interrupted"


def _exit_interrupted() -> None:
    """End the process of an interrupted command with its exit code.

    Without this, an interrupt inside `exec` (which creates dataclasses) would end the process by a
    signal although it was acknowledged, and freeing the compiler's memory would take seconds.
    """
    if _exit_codes:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(_exit_codes[0])


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Handle SIGINT or SIGTERM: raise KeyboardInterrupt until it is acknowledged."""
    _pending_interrupts.append(number)
    signal.signal(signal.SIGALRM, _raise_again)
    signal.setitimer(signal.ITIMER_REAL, _RERAISE_INTERVAL_S, _RERAISE_INTERVAL_S)
    raise KeyboardInterrupt


def _raise_again(number: int, frame: FrameType | None) -> None:
    """Handle the timer: raise KeyboardInterrupt again, unless it still propagates."""
    error = sys.exception()
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    if error is None:
        raise KeyboardInterrupt


def _ignore_lost_interrupt(unraisable: Any) -> None:
    """Ignore an interrupt that Python could not raise; report other exceptions.

    A lost interrupt is raised again by the timer.
    """
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
