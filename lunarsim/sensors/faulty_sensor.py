"""Sensors with faults: wrappers that change the measurements of a sensor."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from lunarsim.messages.measurements import InertialSamples
from lunarsim.sensors.faults import ActiveFaults, AdditiveFault, FrozenFault, LatencyFault
from lunarsim.sensors.imu import Imu
from lunarsim.sensors.interface import Sensor
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


class FaultySensor:
    """Sensor with faults, except an inertial unit.

    Parameters
    ----------
    sensor
        Sensor without faults.
    faults
        Faults with the generators of their random numbers.

    Attributes
    ----------
    is_silent
        Whether a fault suppressed the last measurement.
    """

    def __init__(self, sensor: Sensor, faults: ActiveFaults) -> None:
        self.sensor = sensor
        self.is_silent = False
        self._faults = faults
        # For each fault: its input at the last measurement before it acted.
        self._held: list[Any] = [None] * len(faults)
        delays = [fault.delay for fault, _ in faults if isinstance(fault, LatencyFault)]
        self._memory = sum(delays)
        self._states: deque[tuple[float, State]] = deque()

    def observe(self, time: float, state: State) -> None:
        """Store the true state at a time, s, for measurements with latency."""
        self._states.append((time, state))
        while len(self._states) > 1 and self._states[1][0] <= time - self._memory + 1e-9:
            self._states.popleft()

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> Any:
        """Return one measurement with the faults that are active at the time.

        The result is None if a fault suppresses the measurement. Parameters are those of
        `Sensor.measure`. `rng` gives the same random numbers as without faults.
        """
        active = [(fault, drawn) for fault, drawn in self._faults if fault.is_active(time)]
        delay = sum(fault.delay for fault, _ in active if isinstance(fault, LatencyFault))
        if delay > 0.0:
            state = self._state_at(time - delay)
        found = self.sensor.measure(world, state, time, rng, mount)
        self.is_silent = any(fault.is_silent for fault, _ in active)
        if self.is_silent or found is None:
            return None
        for k, (fault, drawn) in enumerate(self._faults):
            is_active = fault.is_active(time)
            if is_active:
                found = fault.apply(found, self._held[k], time, drawn)
            if self._held[k] is None or not is_active:
                self._held[k] = found
        return found

    def _state_at(self, time: float) -> State:
        """Return the last stored state at or before a time, s, or the first one."""
        past = [state for when, state in self._states if when <= time + 1e-9]
        return past[-1] if past else self._states[0][1]


class FaultyImu(Imu):
    """Inertial unit with faults.

    Parameters
    ----------
    imu
        Unit without faults.
    faults
        Faults with the generators of their random numbers.
    """

    def __init__(self, imu: Imu, faults: ActiveFaults) -> None:
        self.step = imu.step
        first, second = imu.gyroscopes, imu.accelerometers
        self.gyroscopes: Any = _FaultyTriad(first, "rate", faults)
        self.accelerometers: Any = _FaultyTriad(second, "acceleration", faults)

    def sample_trajectory(
        self, rows: Array, step: float, gravity: float, time: float, angle: Array | None = None
    ) -> InertialSamples:
        """Measure increments along a true trajectory; parameters as in `Imu`."""
        samples = super().sample_trajectory(rows, step, gravity, time, angle)
        self.gyroscopes.hold(samples.angle[-1])
        self.accelerometers.hold(samples.velocity[-1])
        return samples


class _FaultyTriad:
    """Three gyroscopes or accelerometers with faults.

    `channel` is their quantity in faults: "rate" or "acceleration". The attribute `matrix` is that
    of the samples that `offsets` has sampled last.
    """

    def __init__(self, triad: Any, channel: str, faults: ActiveFaults) -> None:
        self.triad = triad
        self.errors, self.step, self.remainder = triad.errors, triad.step, triad.remainder
        self.matrix = triad.matrix
        self._channel = channel
        self._samples = 0
        self._faults = [
            (fault, drawn)
            for fault, drawn in faults
            if isinstance(fault, FrozenFault)
            or (isinstance(fault, AdditiveFault) and (fault.channel or "rate") == channel)
        ]
        # For each fault: the increment (3,) that it repeats if it is a freeze, whether it repeats
        # one, and the errors (3,) that later faults added to the last sample.
        self._held: list[Array | None] = [None] * len(self._faults)
        self._is_frozen = [False] * len(self._faults)
        self._later = np.zeros((len(self._faults), 3))

    def offsets(self, n: int) -> Array:
        """Sample the additive errors (n, 3) of the next n increments, with faults.

        Frozen sensors repeat the last increment of the cycle before.
        """
        out: Array = self.triad.offsets(n)
        times = self.step * (self._samples + 1 + np.arange(n))
        self._samples += n
        self.matrix = self.triad.matrix
        self._later[:] = 0.0
        for k, (fault, drawn) in enumerate(self._faults):
            if isinstance(fault, FrozenFault):
                held = self._held[k]
                self._is_frozen[k] = held is not None and fault.is_active(times[0])
                if held is not None and self._is_frozen[k]:
                    self.matrix, out = np.zeros((3, 3)), np.tile(held, (n, 1))
                continue
            for i in np.flatnonzero([fault.is_active(time) for time in times]):
                added = self.step * fault.offset(self._channel, times[i], (3,), drawn)
                out[i] += added
                if i == n - 1:
                    self._later[:k] += added
        return out

    def hold(self, increment: Array) -> None:
        """Store the last measured increment (3,) of a cycle for faults that begin later."""
        for k, is_frozen in enumerate(self._is_frozen):
            if not is_frozen:
                self._held[k] = increment - self._later[k]

    def increments(self, truth: Array) -> Array:
        """Return measured increments (n, 3) for true increments (n, 3), rad or m/s."""
        return np.asarray(self.triad.with_offsets(truth, self.offsets(len(truth)), self.matrix))
