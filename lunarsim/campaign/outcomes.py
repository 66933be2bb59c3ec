"""What became of one flight, as it travels from a worker to the writer."""

from __future__ import annotations

import importlib
import os
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lunarsim.campaign.plan import Group, Work, row_id

FLOWN, ERROR, TIMEOUT, KILLED = "flown", "error", "timeout", "killed"


class NotKeptError(Exception):
    """A flight has its metrics, but what else of it was to be kept could not be written.

    Parameters
    ----------
    metrics
        By name.
    why
        In words.
    """

    def __init__(self, metrics: Mapping[str, Any], why: str) -> None:
        super().__init__(why)
        self.metrics = metrics


@dataclass(frozen=True)
class Finished:
    """One flight that has ended, in whatever way.

    Attributes
    ----------
    flight, arm
        Which.
    outcome
        flown: it has metrics; error: its code raised; timeout: it took longer than the time limit;
        killed: its process died each time.
    metrics
        By name, or None.
    error, traceback
        What was raised, in a line and whole; "" for nothing. A flight that was flown and has an
        error has its metrics, and no record.
    seconds
        Wall-clock time.
    finished
        When, seconds since 1970.
    worker
        Who flew it.
    tries
        How often it was begun.
    """

    flight: int
    arm: int
    outcome: str
    metrics: Mapping[str, Any] | None = None
    error: str = ""
    traceback: str = ""
    seconds: float = float("nan")
    finished: float = 0.0
    worker: str = ""
    tries: int = 1

    def timing(self) -> dict[str, Any]:
        """Return what two runs do not share."""
        return {
            "id": row_id(self.flight, self.arm),
            "seconds": self.seconds,
            "finished_unix_s": self.finished,
            "worker": self.worker,
            "tries": self.tries,
        }


def function_of(work: Work) -> Any:
    """Return the function that a work names."""
    module, _, name = work.function.partition(":")
    return getattr(importlib.import_module(module), name)


def attempt(function: Any, work: Work, group: Group, arm: int, memory: dict[Any, Any]) -> Finished:
    """Fly one flight; whatever it raises becomes its outcome.

    A `KeyboardInterrupt` is somebody else's and goes on.
    """
    began = time.perf_counter()
    metrics, error, trace = None, "", ""
    try:
        metrics = function(work.study, group, arm, memory)
    except KeyboardInterrupt:
        raise
    except NotKeptError as raised:
        # A full disk must not make a landing that failed one that nobody counts.
        metrics, error, trace = raised.metrics, str(raised), traceback.format_exc()
    except BaseException as raised:  # an exit included: one flight is no reason to end the others
        error = "".join(traceback.format_exception_only(raised)).strip().splitlines()[-1]
        trace = traceback.format_exc()
    return Finished(
        group.flight, arm, ERROR if metrics is None else FLOWN, metrics, error, trace,
        time.perf_counter() - began, time.time(), str(os.getpid()),
    )  # fmt: skip
