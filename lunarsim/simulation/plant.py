"""The plant: the true world, the vehicle in it, and the sensors on the vehicle.

It takes commands and gives measurements; what the onboard computer makes of them it never sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_rotate
from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.sensors.contract import Sensor
from lunarsim.sensors.imu import Imu
from lunarsim.vehicle import Dynamics, State, Verdict, judge_touchdown, pad_contacts
from lunarsim.world import World

Array = NDArray[np.float64]

# Pads are looked for under the lander only below this height above the highest ground, m.
_CONTACT_HEIGHT = 40.0


@dataclass(frozen=True)
class Instrument:
    """A sensor on the lander.

    Attributes
    ----------
    sensor, rng
        What measures, and the source of its noise.
    tasked
        Whether it measures only when told to; else once a cycle.
    """

    sensor: Sensor
    rng: np.random.Generator
    tasked: bool


class Plant:
    """Truth in motion.

    Parameters
    ----------
    world, dynamics, state
        The world, how the vehicle moves in it, and where it starts.
    instruments
        By name.
    imu
        The inertial unit, by name, or None.
    steps
        Integration steps in a control cycle.
    max_time
        A flight that is not over by then is, s.
    """

    def __init__(
        self,
        world: World,
        dynamics: Dynamics,
        state: State,
        *,
        instruments: dict[str, Instrument],
        imu: tuple[str, Imu] | None,
        steps: int,
        max_time: float,
    ) -> None:
        self.world = world
        self.dynamics = dynamics
        self.lander = dynamics.lander
        self.state = state
        self.time = 0.0
        self.verdict: Verdict | None = None
        self._instruments = instruments
        self._imu = imu
        self._steps = steps
        self._max_time = max_time
        self._samples: tuple[str, InertialSamples] | None = None

    def sense(self) -> Measurements:
        """Return what the inertial unit gathered and what sensors that need no telling measure."""
        items: list[tuple[str, object]] = [] if self._samples is None else [self._samples]
        self._samples = None
        for name, instrument in self._instruments.items():
            if not instrument.tasked:
                items.append((name, self._measure(instrument, None)))
        return Measurements(self.time, self.state.mass, tuple(items))

    def perform(self, tasks: Sequence[SensorTask]) -> Measurements:
        """Return what pointed sensors measure when told to."""
        items = tuple(
            (task.sensor, self._measure(self._instruments[task.sensor], task.mount))
            for task in tasks
        )
        return Measurements(self.time, self.state.mass, items)

    def _measure(self, instrument: Instrument, mount: Array | None) -> object:
        return instrument.sensor.measure(self.world, self.state, self.time, instrument.rng, mount)

    def advance(self, command: Command) -> None:
        """Move for one control cycle, or until a pad touches the ground."""
        step = self.dynamics.step
        history = self.dynamics.advance(self.state, command, self._steps)
        touched = self._first_contact(history)
        steps = self._steps if touched is None else touched + 1
        rows = np.vstack((self.state.as_vector(), history[:steps]))
        self.state = State.from_vector(rows[-1])
        self.time += steps * step
        if self._imu is not None:
            name, imu = self._imu
            self._samples = (name, imu.sense(rows, step, self.world.gravity, self.time))
        if touched is not None:
            self.verdict = judge_touchdown(
                self.lander, self.state, self.world.terrain, self.world.gravity
            )
        elif self.state.position[2] < self.world.terrain.z_range[0] - 1.0:
            self.verdict = Verdict(False, ("off-map",), None)
        elif self.time >= self._max_time:
            self.verdict = Verdict(False, ("time-limit",), None)

    def _first_contact(self, history: Array) -> int | None:
        """Return the first step at which a pad is at or below the ground, or None."""
        if history[-1, 2] - self.world.terrain.z_range[1] > _CONTACT_HEIGHT:
            return None
        pads = history[:, None, 0:3] + quat_rotate(history[:, None, 6:10], self.lander.pads)
        gap = pads[..., 2] - self.world.terrain.elevation(pads[..., :2])
        if not np.any(gap <= 2.0):
            return None
        for step, y in enumerate(history):
            ground = pad_contacts(self.lander, State.from_vector(y), self.world.terrain)[:, 2]
            if np.any(pads[step, :, 2] <= ground):
                return step
        return None
