"""Run a campaign: fly the missing flights with an engine and store their results."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from lunarsim.atomic_files import new_contents_remover
from lunarsim.campaign.engines.contract import Engine
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import Group, Plan
from lunarsim.campaign.store import Store
from lunarsim.evaluation.sequences import share_confidence_sequence

COMPLETE, STOPPED, INTERRUPTED, OUT_OF_TIME = "complete", "stopped", "interrupted", "out of time"


@dataclass(frozen=True)
class RunResult:
    """Summary of one run of a campaign: state and numbers of flights.

    Attributes
    ----------
    state
        complete; stopped: the interval is narrow enough; interrupted; out of time.
    flown, before
        Number of rows of this run, and of earlier runs.
    failed
        Number of rows of this run without an outcome.
    flights
        Number of flight indices of the campaign, or where it was stopped.
    notes
        Messages about damage found in the folder.
    unrecorded
        Reason why flights of this run lack records or plots; empty if none does.
    """

    state: str
    flown: int
    before: int
    failed: int
    flights: int
    notes: tuple[str, ...] = ()
    unrecorded: str = ""

    @property
    def complete(self) -> bool:
        """Whether the campaign is finished, so that no flight is left."""
        return self.state in (COMPLETE, STOPPED)


class IntervalWidthRule:
    """Rule that stops a campaign when the confidence sequences of all arms are narrow.

    The rule evaluates consecutive flights from 0, so the stopping index does not depend on the
    order in which flights finish. A flight without an outcome counts as a failure.

    Parameters
    ----------
    metric
        Boolean column of the results.
    width
        Required width of the 95 % confidence sequence of the fraction of flights for which the
        metric is true.
    arms
        Number of arms (variants of the scenario).

    Attributes
    ----------
    stop
        Number of flights to keep; None until the rule is satisfied.
    """

    def __init__(self, metric: str, width: float, arms: int) -> None:
        self.metric, self.width = metric, width
        self.stop: int | None = None
        self._counts = [0] * arms
        self._waiting: dict[int, dict[int, bool]] = {}
        self._next = 0

    def add(self, flight: int, arm: int, row: Mapping[str, Any]) -> None:
        """Add the result row of a flight, given by the indices of flight and arm.

        An arm is a variant of the scenario. Flights may be added in any order. `stop` is set once
        the rule is satisfied.
        """
        if self.stop is not None:
            return
        self._waiting.setdefault(flight, {})[arm] = bool(row[self.metric])
        while self.stop is None and len(self._waiting.get(self._next, {})) == len(self._counts):
            for i, hit in self._waiting.pop(self._next).items():
                self._counts[i] += hit
            self._next += 1
            intervals = (share_confidence_sequence(count, self._next) for count in self._counts)
            if all(high - low <= self.width for low, high in intervals):
                self.stop = self._next


class StopRequest:
    """Flag that is set by an interrupt (SIGINT) or a termination request (SIGTERM)."""

    def __init__(self) -> None:
        self.is_requested = False

    def __call__(self) -> bool:
        """Return whether a signal has requested to stop."""
        return self.is_requested

    @contextlib.contextmanager
    def on_signals(self, engine: Engine) -> Iterator[None]:
        """Set the flag on SIGINT and SIGTERM; a second signal raises `KeyboardInterrupt`.

        Nothing is set up for an engine that does not poll the flag, or outside the main thread.
        """
        if threading.current_thread() is not threading.main_thread() or not engine.polls_halt:
            yield
            return

        def take(number: int, frame: FrameType | None) -> None:
            if self.is_requested:
                raise KeyboardInterrupt
            self.is_requested = True

        old = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in old.items():
                signal.signal(number, handler)


def run(
    plan: Plan,
    engine: Engine,
    out: Path,
    *,
    rule: IntervalWidthRule | None = None,
    time_budget: float | None = None,
    retry: bool = False,
    progress: Callable[[int], None] | None = None,
    files: Callable[[Path], None] | None = None,
) -> RunResult:
    """Fly the flights of a campaign that its folder does not contain yet.

    Parameters
    ----------
    plan, engine, out
        Planned flights, engine that runs them, and folder: new, or of the same campaign.
    rule, time_budget
        Early-stopping rule; wall-clock time after which no flight starts, s.
    retry
        Whether flights without an outcome are flown again.
    progress, files
        Function called with the number of new rows; function that writes other files into the
        folder.

    Raises
    ------
    InputError
        If the folder belongs to another campaign; nothing has been written then.
    OSError
        If the folder cannot be written to. A new folder without a finished flight is removed.
    """
    store, remove = _open_store(out, plan, retry)
    halt = StopRequest()
    before = store.count
    try:
        if files is not None:
            files(out)
        store.save_manifest(engine=engine.name)
        if plan.chains is not None:
            _resume_chains(plan, store)
            before = store.count
        elif rule is not None:
            _replay_rows(rule, store, plan)
        if progress is not None and before:
            progress(before)
        flown, failed, in_time, lost = _fly_groups(
            plan, engine, store, halt, rule, time_budget, progress
        )
        state = _close_store(store, plan, rule, in_time)
    except OSError as error:
        store.release()
        if not store.count:
            remove()
            raise
        message = f"{error.strerror}. Finished flights are kept. Free space and repeat the command"
        raise OSError(error.errno, message, error.filename or str(out)) from error
    except BaseException:
        store.release()
        raise
    flights = int(store.manifest["flights"])
    return RunResult(state, flown, before, failed, flights, tuple(store.notes), lost)


def _open_store(out: Path, plan: Plan, retry: bool) -> tuple[Store, Callable[[], None]]:
    """Open the folder of a campaign; return its store and a function to remove it.

    The function removes the contents of a new folder after an error, and otherwise does nothing.
    `retry` states whether flights without an outcome are flown again.
    """
    is_new = not out.is_dir() or not any(out.iterdir())
    remove = new_contents_remover(out) if is_new else lambda: None
    try:
        return Store.open(out, plan, retry=retry), remove
    except OSError:
        remove()
        raise


def _fly_groups(
    plan: Plan,
    engine: Engine,
    store: Store,
    halt: StopRequest,
    rule: IntervalWidthRule | None,
    time_budget: float | None,
    progress: Callable[[int], None] | None,
) -> tuple[int, int, bool, str]:
    """Fly the missing flights of a campaign and store their results.

    Return the number of flights, the number of failed flights, whether the time budget (s) was
    sufficient, and the reason why records are missing ("" if none is).
    """
    flown = failed = 0
    not_kept: list[str] = []
    began = time.monotonic()
    in_time = True

    def groups() -> Iterator[Group | None]:
        nonlocal in_time
        for group in _missing_groups(plan, store):
            if time_budget is not None and time.monotonic() - began > time_budget:
                in_time = False
                return
            yield group

    enough = rule is not None and rule.stop is not None
    with halt.on_signals(engine), contextlib.suppress(KeyboardInterrupt):
        flights = engine.fly(plan.work, groups() if not enough else iter(()), halt)
        with contextlib.closing(flights):  # type: ignore[type-var]
            for done in flights:
                row = store.add(done)
                flown += 1
                failed += done.outcome != FLOWN
                if done.outcome == FLOWN and done.error:
                    not_kept.append(done.error)
                if plan.chains is not None:
                    plan.chains.add(done.flight, row)
                if rule is not None:
                    rule.add(done.flight, done.arm, row)
                if progress is not None:
                    progress(1)
                if rule is not None and rule.stop is not None:
                    break
    lost = f"{len(not_kept)} flights have rows but no record: {not_kept[0]}" if not_kept else ""
    return flown, failed, in_time, lost


def _missing_groups(plan: Plan, store: Store) -> Iterator[Group | None]:
    """Yield the groups of flights without a stored result, in order.

    With method subset, None means that all other groups wait for running flights.
    """
    if plan.chains is not None:
        yield from plan.chains.groups(store.has)
        return
    for flight in range(plan.flights):
        draws: dict[str, Any] | None = None
        for group in plan.groups:
            arms = tuple(arm for arm in group if not store.has(flight, arm))
            if arms:
                draws = plan.draws(flight) if draws is None else draws
                yield Group(flight, arms, draws)


def _replay_rows(rule: IntervalWidthRule, store: Store, plan: Plan) -> None:
    names = {name: i for i, (name, _) in enumerate(plan.arms)}
    for row in store.rows():
        rule.add(row["flight"], names[row["arm"]], row)


def _resume_chains(plan: Plan, store: Store) -> None:
    """Add stored results to the Markov chains of a subset simulation.

    Results of flights that do not follow from their predecessors are deleted.
    """
    assert plan.chains is not None
    orphans = plan.chains.resume(store.rows())
    if orphans:
        store.delete_rows({(flight, 0) for flight in orphans})
        store.notes.append(
            f"{len(orphans)} flights depend on flights that are missing; they are flown again."
        )


def _close_store(store: Store, plan: Plan, rule: IntervalWidthRule | None, in_time: bool) -> str:
    """Close the folder of a campaign and return the campaign's state.

    Flights after an early stop are deleted. `in_time` states whether the time budget sufficed.
    """
    state = _final_state(store, plan, rule, in_time)
    by = plan.chains if plan.chains is not None else rule
    if state in (STOPPED, COMPLETE) and by is not None and by.stop is not None:
        store.truncate(by.stop)
    store.close(state)
    return state


def _final_state(store: Store, plan: Plan, rule: IntervalWidthRule | None, in_time: bool) -> str:
    if rule is not None and rule.stop is not None:
        return STOPPED
    ended = plan.chains is not None and plan.chains.stop is not None
    if ended or store.count == plan.flights * len(plan.arms):
        return COMPLETE
    return INTERRUPTED if in_time else OUT_OF_TIME
