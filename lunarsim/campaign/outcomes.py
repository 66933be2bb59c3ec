"""Result of one flight, as sent from a worker to the writer."""

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


class RecordNotWrittenError(Exception):
    """A flight has metrics, but its record or plots could not be written.

    Parameters
    ----------
    metrics
        Metrics by name.
    why
        Reason.
    """

    def __init__(self, metrics: Mapping[str, Any], why: str) -> None:
        super().__init__(why)
        self.metrics = metrics


@dataclass(frozen=True)
class Finished:
    """Result of a flight of a campaign that has ended, with or without metrics.

    Attributes
    ----------
    flight, arm
        Indices of the flight and of the arm.
    outcome
        flown: the flight has metrics; error: its code raised an error; timeout: it exceeded the
        time limit; killed: its process died at every attempt.
    metrics
        Metrics by name, or None.
    error, traceback
        Error in one line and with traceback; "" for none. A flown flight with an error has metrics
        but no record.
    seconds
        Wall-clock time, s.
    finished
        Time of its end, seconds since 1970.
    worker
        Process that flew it.
    attempts
        Number of times that it was started.
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
    attempts: int = 1

    def timing(self) -> dict[str, Any]:
        """Return the wall-clock times, process and number of attempts, by column name."""
        return {
            "id": row_id(self.flight, self.arm),
            "seconds": self.seconds,
            "finished_unix_s": self.finished,
            "worker": self.worker,
            "attempts": self.attempts,
        }


def import_function(work: Work) -> Any:
    """Import the function that flies the flights of a campaign, named in its `Work`."""
    module, _, name = work.function.partition(":")
    return getattr(importlib.import_module(module), name)


def attempt(function: Any, work: Work, group: Group, arm: int, memory: dict[Any, Any]) -> Finished:
    """Fly one flight and return its result; an exception becomes the outcome "error".

    `function` is the function of `work`, `arm` the index of an arm in `group`, and `memory` a
    dictionary that persists within the group.

    A `KeyboardInterrupt` is raised again. An arm is a variant of the scenario.
    """
    began = time.perf_counter()
    metrics, error, trace = None, "", ""
    try:
        metrics = function(work.study, group, arm, memory)
    except KeyboardInterrupt:
        raise
    except RecordNotWrittenError as raised:
        # The outcome must be counted even if the disk is full.
        metrics, error, trace = raised.metrics, str(raised), traceback.format_exc()
    except BaseException as raised:  # SystemExit included: other flights must continue
        error = "".join(traceback.format_exception_only(raised)).strip().splitlines()[-1]
        trace = traceback.format_exc()
    return Finished(
        group.flight, arm, ERROR if metrics is None else FLOWN, metrics, error, trace,
        time.perf_counter() - began, time.time(), str(os.getpid()),
    )  # fmt: skip
