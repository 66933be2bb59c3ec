"""Plant of the closed loop: true world, vehicle and sensors.

The plant receives commands and returns measurements. It never sees the onboard computer's data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.frames import quat_rotate
from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.models.gimbal import limit_mount
from lunarsim.onboard.component_errors import wrong_result_error
from lunarsim.sensors.faults import ActiveFaults
from lunarsim.sensors.faulty_sensor import FaultyImu, FaultySensor
from lunarsim.sensors.imu import Imu
from lunarsim.sensors.interface import Sensor, SensorPart
from lunarsim.typing import Array
from lunarsim.vehicle import Dynamics, LandingOutcome, State, evaluate_touchdown, pad_contacts
from lunarsim.vehicle.actuators import Actuators
from lunarsim.vehicle.faults import Faults
from lunarsim.vehicle.legs import Legs, RestState, evaluate_motion
from lunarsim.vehicle.touchdown import ABORTED
from lunarsim.world import World

# Pad contacts are computed only below this height above the highest terrain, m.
_MAX_CONTACT_HEIGHT_M = 40.0
# Height above the highest terrain (m) and climb rate (m/s) that complete an abort.
_ABORT_CLEAR_HEIGHT_M, _ABORT_CLIMB_SPEED_M_S = 50.0, 5.0


@dataclass(frozen=True)
class Instrument:
    """Sensor on the lander during one flight, with the generator of its noise.

    Attributes
    ----------
    sensor, rng
        Sensor, and random generator of its noise.
    is_tasked
        Whether the sensor measures only on command; else once per control cycle.
    gimbal_limit
        Maximum angle of the sensor's boresight from body -z, rad.
    part
        Settings in the scenario that the sensor was built from.
    """

    sensor: Sensor
    rng: np.random.Generator
    is_tasked: bool
    gimbal_limit: float
    part: SensorPart

    @classmethod
    def of(
        cls, part: SensorPart, rng: np.random.Generator, step: float, faults: ActiveFaults = ()
    ) -> Instrument:
        """Build a sensor for one flight from its settings in the scenario.

        `rng` generates its noise; `step` is the integration step, s. `faults` are its faults.
        """
        build = getattr(part, "build", None)
        sensor: Any = part if build is None else build(rng, step)
        if faults:
            sensor = (FaultyImu if isinstance(sensor, Imu) else FaultySensor)(sensor, faults)
        limit = getattr(part.calibration(), "gimbal_limit", np.pi)
        return cls(sensor, rng, part.is_tasked, limit, part)


class Plant:
    """True motion of the lander in the world, with its sensors, during one flight.

    Parameters
    ----------
    world, dynamics, state
        True world, dynamics of the vehicle, and initial state.
    sensors
        Settings of the sensors by name, each with the random generator of its noise.
    steps
        Integration steps per control cycle.
    max_time
        Time limit of a flight, s.
    actuators
        Thrusters, gimbal and throttle of the lander; None: torques act as commanded.
    faults
        Faults of a lander without actuators: an engine throttle that sticks.
    sensor_faults
        Faults of the sensors by the name of the sensor.
    legs
        Legs, whose simulated motion after touchdown decides the outcome; None: the state at
        touchdown decides it.

    Attributes
    ----------
    rest
        Result of the motion on the legs; None without a touchdown on legs.
    state, time, outcome
        Current state; time, s; landing outcome, None during the flight.
    """

    def __init__(
        self,
        world: World,
        dynamics: Dynamics,
        state: State,
        sensors: Mapping[str, tuple[SensorPart, np.random.Generator]],
        *,
        steps: int,
        max_time: float,
        actuators: Actuators | None = None,
        faults: Faults | None = None,
        sensor_faults: Mapping[str, ActiveFaults] | None = None,
        legs: Legs | None = None,
    ) -> None:
        self.world = world
        self.actuators = actuators
        self._faults = faults
        self._throttle: float | None = None
        self.legs = legs
        self.rest: RestState | None = None
        self.dynamics = dynamics
        self.lander = dynamics.lander
        self.state = state
        self.time = 0.0
        self.outcome: LandingOutcome | None = None
        self.steps = steps
        made = {
            name: Instrument.of(part, rng, dynamics.step, (sensor_faults or {}).get(name, ()))
            for name, (part, rng) in sensors.items()
        }
        units: list[tuple[str, Any]] = [(name, one.sensor) for name, one in made.items()]
        for name, unit in units:
            if sensors[name][0].measurement_type is InertialSamples and not isinstance(unit, Imu):
                raise InputError(
                    f"sensors.{name}",
                    type(unit).__name__,
                    "must build an Imu, because its measurements are InertialSamples",
                    "Return an Imu from its method `build`.",
                )
        self.imus: dict[str, Imu] = {n: u for n, u in units if isinstance(u, Imu)}
        self._instruments = {n: i for n, i in made.items() if n not in self.imus}
        self._max_time = max_time
        self._low, self._high = world.terrain.z_range

    def apply_throttle_faults(self, command: Command) -> Command:
        """Return a command with the thrust that a possibly stuck throttle delivers."""
        if self._faults is None:
            return command
        thrust = self._faults.throttle(self.time, self._throttle, command.thrust)
        self._throttle = thrust
        return replace(command, thrust=self._faults.delivered(self.time, thrust))

    def measure(self, tasks: Sequence[SensorTask] = ()) -> Measurements:
        """Measure with all sensors that measure every cycle, and with commanded sensors.

        `tasks` are the commanded measurements.
        """
        for instrument in self._instruments.values():
            if isinstance(instrument.sensor, FaultySensor):
                instrument.sensor.observe(self.time, self.state)
        items: list[tuple[str, object]] = [
            (name, self._measure(name, None))
            for name, instrument in self._instruments.items()
            if not instrument.is_tasked
        ]
        items += [(task.sensor, self._measure(task.sensor, task.mount)) for task in tasks]
        return Measurements(self.time, tuple(item for item in items if item[1] is not None))

    def _measure(self, name: str, mount: Array | None) -> object | None:
        """Return a measurement of a sensor by name, after a check of its type.

        None: the sensor measures on its own, and not in this cycle, or a fault makes it silent.

        `mount` (3, 3) is the commanded rotation, sensor to body, which is limited to the gimbal
        limit; None: no command.
        """
        i = self._instruments[name]
        held = None if mount is None else limit_mount(mount.copy(), i.gimbal_limit)
        found = i.sensor.measure(self.world, self.state, self.time, i.rng, held)
        if found is None and (not i.is_tasked or getattr(i.sensor, "is_silent", False)):
            return None
        if not isinstance(found, i.part.measurement_type):
            wanted = f"a measurement of type {i.part.measurement_type.__name__}"
            raise wrong_result_error(f"sensors.{name}", i.part, "measure", found, wanted, self.time)
        return found

    def adopt_motion(
        self,
        history: Array,
        gyroscopes: Mapping[str, Array],
        tasks: Sequence[SensorTask] = (),
        *,
        abort: bool = False,
    ) -> Measurements:
        """Take over the integrated motion of a control cycle; return the measurements.

        The motion is integrated outside the plant, because it is coupled with the attitude loop.

        Parameters
        ----------
        history
            State vectors after each step (n, 15); states after a touchdown are ignored.
        gyroscopes
            Gyroscope increments already sampled during the cycle, by name (n, 3), rad.
        tasks
            Commanded measurements at the end of the cycle.
        abort
            Whether the lander is aborting. The flight then ends once the lander climbs well above
            the terrain.
        """
        touched = self._first_contact(history)
        steps = len(history) if touched is None else touched + 1
        rows = np.vstack((self.state.as_vector(), history[:steps]))
        self.state = State.from_vector(rows[-1])
        self.time += steps * self.dynamics.step
        samples: list[tuple[str, object]] = []
        for name, imu in self.imus.items():
            angle = gyroscopes[name][:steps] if name in gyroscopes else None
            sensed = imu.sample_trajectory(*self.gravity_free_states(rows), self.time, angle)
            samples.append((name, sensed))
        self._evaluate_outcome(touched is not None, abort)
        measured = self.measure(tasks if self.outcome is None else ())
        return Measurements(self.time, (*samples, *measured.items))

    def gravity_free_states(self, states: Array) -> tuple[Array, float, float]:
        """Return states (n, 15), step (s) and gravity (m/s^2) as inputs of an IMU model.

        `states` (n, 15) are those before and after each integration step. An IMU model needs
        uniform gravity; if gravity varies, the velocity that it causes is removed from the
        states, and the returned gravity is 0.
        """
        step, moon = self.dynamics.step, self.world.moon
        if moon is None:
            return states, step, self.world.gravity
        middle = 0.5 * (states[1:, :6] + states[:-1, :6])
        out = states.copy()
        out[1:, 3:6] -= np.cumsum(
            step * moon.free_fall_acceleration(middle[:, :3], middle[:, 3:]), axis=0
        )
        return out, step, 0.0

    def _evaluate_outcome(self, touched: bool, abort: bool) -> None:
        """Set the landing outcome if the flight has ended.

        The flight ends if a pad is in contact (`touched`), if the lander is below the terrain, if
        an aborting lander (`abort`) climbs well above the terrain, or at the time limit.
        """
        terrain = self.world.terrain
        if touched and self.legs is not None:
            self.outcome, self.rest = evaluate_motion(self.legs, self.dynamics, self.state, terrain)
        elif touched:
            self.outcome = evaluate_touchdown(self.lander, self.state, terrain, self.world.gravity)
        elif self.world.is_below_terrain(self.state.position, self._low):
            self.outcome = LandingOutcome(False, ("off-map",), None)
        elif abort and self._is_clear_of_terrain:
            self.outcome = LandingOutcome(False, (ABORTED,), None)
        elif self.time >= self._max_time:
            self.outcome = LandingOutcome(False, ("time-limit",), None)

    @property
    def _is_clear_of_terrain(self) -> bool:
        """Whether the lander climbs well above all terrain, which completes an abort."""
        height = self.world.height(self.state.position) - self._high
        return bool(
            height > _ABORT_CLEAR_HEIGHT_M and self.state.velocity[2] > _ABORT_CLIMB_SPEED_M_S
        )

    def _first_contact(self, history: Array) -> int | None:
        """Return the index of the first state at which a pad touches the terrain.

        `history` (n, 15) has the state after each integration step. Return None if there is no
        contact.
        """
        if self.world.height(history[-1, :3]) - self._high > _MAX_CONTACT_HEIGHT_M:
            return None
        mounted = self.lander.pads - self.lander.com(float(history[0, 13]))
        pads = history[:, None, 0:3] + quat_rotate(history[:, None, 6:10], mounted)
        gap = pads[..., 2] - self.world.terrain.elevation(pads[..., :2])
        if not np.any(gap <= 2.0):
            return None
        for step, y in enumerate(history):
            pad_heights = pad_contacts(self.lander, State.from_vector(y), self.world.terrain)[:, 2]
            if np.any(pads[step, :, 2] <= pad_heights):
                return step
        return None
