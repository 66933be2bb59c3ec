"""Delay between the measurements of a cycle and the effect of its commands."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from lunarsim.messages.commands import Command, SensorTask
from lunarsim.scenario.mission import CommandDelay

# Tolerance for a delay that is a multiple of the integration step, in steps.
_TOLERANCE_STEPS = 1e-6


class Stopwatch:
    """Sum of the wall-clock times of `with` statements.

    Attributes
    ----------
    seconds
        Sum of the times, s.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._start = 0.0

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._start


def _with_tasks(command: Command, earlier: tuple[SensorTask, ...]) -> Command:
    """Return a command with earlier measurement tasks for its other sensors."""
    sensors = {task.sensor for task in command.tasks}
    added = tuple(task for task in earlier if task.sensor not in sensors)
    return replace(command, tasks=added + command.tasks) if added else command


class CommandQueue:
    """Commands of a flight that have not taken effect yet.

    Parameters
    ----------
    settings
        Latency and jitter; None: commands take effect at once.
    rng
        Generator of the jitter.
    step
        Integration step, s.
    first
        Command that is active at the start.
    """

    def __init__(
        self, settings: CommandDelay | None, rng: np.random.Generator, step: float, first: Command
    ) -> None:
        self._settings, self._rng, self._step = settings, rng, step
        self._active, self._now = first, 0
        # Commands and the integration steps at which they take effect, in order.
        self._waiting: list[tuple[int, Command]] = []

    def add(
        self, command: Command, computing_time: float, steps: int
    ) -> tuple[Command, list[tuple[int, Command]]]:
        """Add the command of a cycle; return what is active in it.

        A command that would take effect after a newer one is dropped; its measurement tasks are
        done with the newer one.

        Parameters
        ----------
        command
            Command for the cycle that begins.
        computing_time
            Wall-clock time of its computation, s.
        steps
            Number of integration steps of the cycle.

        Returns
        -------
        active
            Command at the start of the cycle.
        changes
            Commands that replace it, each after a number of steps of the cycle.
        """
        due, before = self._now + self._delay_steps(computing_time), self._active
        for _, dropped in (one for one in self._waiting if one[0] >= due):
            command = _with_tasks(command, dropped.tasks)
        self._waiting = [one for one in self._waiting if one[0] < due] + [(due, command)]
        while self._waiting and self._waiting[0][0] <= self._now:
            self._active = self._waiting.pop(0)[1]
        active, start = self._active, self._now
        if active is before:
            active = replace(active, tasks=())  # made in an earlier cycle
        self._now += steps
        changes = []
        tasks = active.tasks
        while self._waiting and self._waiting[0][0] < self._now:
            due, self._active = self._waiting.pop(0)
            tasks = _with_tasks(self._active, tasks).tasks
            changes.append((due - start, replace(self._active, tasks=tasks)))
        return active, changes

    def _delay_steps(self, computing_time: float) -> int:
        """Return the delay of a command in integration steps, rounded up."""
        if self._settings is None:
            return 0
        delay = self._settings.latency
        if self._settings.jitter > 0.0:
            delay += self._settings.jitter * self._rng.random()
        if self._settings.measured:
            delay += computing_time
        return math.ceil(delay / self._step - _TOLERANCE_STEPS)
