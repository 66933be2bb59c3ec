"""The command of an external computer is checked before it takes effect."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lunarsim.interface.structs import Struct
from lunarsim.messages.measurements import Measurements
from lunarsim.onboard.external.computer import ExternalComputer
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.simulation import Simulation
from tests.interface.software import small

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
# Indices of the sensors of `small`.
IMU, FLASH = 0, 2


class Software:
    """Connection whose answers are valid, with one change."""

    def __init__(self, change: Callable[[Struct], None]) -> None:
        self._change = change

    def step(self, given: Struct, answer: Struct) -> None:
        answer.set(thrust=2000.0, attitude=UPRIGHT)
        answer.parts["estimate"].set(
            position=(1.0, 2.0, 3.0), velocity=np.zeros(3), attitude=UPRIGHT, rate=np.zeros(3),
            mass=1200.0,
        )  # fmt: skip
        self._change(answer)

    def close(self) -> None:
        pass


def updated(change: Callable[[Struct], None]) -> ExternalComputer:
    briefing = Simulation(small(), 4, "no-divert").briefing
    computer = ExternalComputer(briefing, Software(change))
    computer.update(Measurements(0.5))
    return computer


def set_task(answer: Struct, k: int = 0, sensor: int = FLASH, mount: object = None) -> None:
    answer.set(task_count=k + 1)
    answer.parts["task"][k].set(sensor=sensor, mount=np.eye(3) if mount is None else mount)


def set_two_tasks(answer: Struct) -> None:
    set_task(answer, 0)
    set_task(answer, 1)


def in_estimate(**values: object) -> Callable[[Struct], None]:
    return lambda answer: answer.parts["estimate"].set(**values)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda a: a.set(thrust=np.nan), "thrust: not finite"),
        (lambda a: a.set(thrust=-1.0), "thrust is negative"),
        (lambda a: a.set(attitude=(0.0, 0.0, np.nan, 1.0)), "attitude: not finite"),
        (lambda a: a.set(attitude=(0.0, 0.0, 0.1, 1.0)), "attitude has the norm"),
        (in_estimate(attitude=(0.0, 0.0, 0.1, 1.0)), "attitude has the norm"),
        (in_estimate(position=(np.inf, 0.0, 0.0)), "position: not finite"),
        (in_estimate(velocity=(0.0, np.nan, 0.0)), "velocity: not finite"),
        (in_estimate(attitude=(np.nan, 0.0, 0.0, 1.0)), "attitude: not finite"),
        (in_estimate(rate=(0.0, 0.0, np.nan)), "rate: not finite"),
        (in_estimate(mass=np.nan), "mass: not finite"),
        (in_estimate(mass=0.0), "mass is not positive"),
        (lambda a: a.set(task_count=9), "task_count is 9, more than 8"),
        (lambda a: set_task(a, sensor=77), "a task names sensor 77"),
        (lambda a: set_task(a, sensor=IMU), "a task names sensor 0"),
        (lambda a: set_task(a, mount=2.0 * np.eye(3)), "not a rotation"),
        (lambda a: set_task(a, mount=-np.eye(3)), "not a rotation"),
        (lambda a: set_task(a, mount=np.full((3, 3), np.nan)), "not a rotation"),
        (set_two_tasks, "two tasks name the same sensor"),
    ],
)  # fmt: skip
def test_invalid_command_is_a_failure(change, problem):
    with pytest.raises(SoftwareFailure, match=problem) as caught:
        updated(change)
    assert caught.value.reason == "invalid-output"
    assert caught.value.role == "computer"


def test_numbers_that_are_not_written_have_defaults():
    computer = updated(lambda answer: None)
    assert np.array_equal(computer.site, computer.briefing.target)
    assert computer.time_to_go == 0.0
    assert np.array_equal(computer.estimate.covariance, np.zeros((9, 9)))
    assert not computer.command().tasks
    assert not computer.command().abort


def test_command_has_the_values_of_the_software():
    def write(answer: Struct) -> None:
        set_task(answer, mount=np.diag([1.0, -1.0, -1.0]))
        answer.set(site=(7.0, 8.0, 9.0), time_to_go=12.5, abort=1)
        answer.parts["estimate"].set(covariance=np.eye(9), lost=1)

    computer = updated(write)
    command = computer.command()
    assert command.thrust == 2000.0
    assert tuple(command.attitude) == UPRIGHT
    (task,) = command.tasks
    assert task.sensor == "flash"
    assert np.array_equal(task.mount, np.diag([1.0, -1.0, -1.0]))
    assert tuple(computer.site) == (7.0, 8.0, 9.0)
    assert computer.time_to_go == 12.5
    assert tuple(computer.estimate.position) == (1.0, 2.0, 3.0)
    assert computer.estimate.mass == 1200.0
    assert np.array_equal(computer.estimate.covariance, np.eye(9))
    assert computer.navigation_lost
    assert command.abort
    assert [(time, name) for time, name, _ in computer.telemetry] == [(0.5, "abort")]
    computer.update(Measurements(0.6))
    assert len(computer.telemetry) == 1
