"""Plant: the true world, the vehicle in it, and its sensors.

The plant receives commands and returns measurements. It never sees the onboard computer's data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_rotate
from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.models.gimbal import limit_mount
from lunarsim.models.jet_lander import centre_of_mass
from lunarsim.onboard.result_checks import wrong_result_error
from lunarsim.sensors.imu import Imu
from lunarsim.sensors.interface import Sensor, SensorPart
from lunarsim.vehicle import Dynamics, LandingOutcome, State, evaluate_touchdown, pad_contacts
from lunarsim.vehicle.actuators import Actuators
from lunarsim.vehicle.faults import Faults
from lunarsim.vehicle.legs import Legs, RestState, evaluate_motion
from lunarsim.vehicle.touchdown import ABORTED
from lunarsim.world import World

Array = NDArray[np.float64]

# Pad contacts are computed only below this height above the highest terrain, m.
_MAX_CONTACT_HEIGHT_M = 40.0
# Height above the highest terrain (m) and climb rate (m/s) that complete an abort.
_ABORT_CLEAR_HEIGHT_M, _ABORT_CLIMB_SPEED_M_S = 50.0, 5.0


@dataclass(frozen=True)
class Instrument:
    """Sensor on the lander.

    Attributes
    ----------
    sensor, rng
        Sensor, and random generator of its noise.
    tasked
        Whether it measures only on command; else once per cycle.
    gimbal_limit
        Maximum angle of its boresight from body -z, rad.
    part
        Part of the scenario that it was built from.
    """

    sensor: Sensor
    rng: np.random.Generator
    tasked: bool
    gimbal_limit: float
    part: SensorPart

    @classmethod
    def of(cls, part: SensorPart, rng: np.random.Generator, step: float) -> Instrument:
        """Build the sensor for one flight; `step` is the integration step, s."""
        build = getattr(part, "build", None)
        sensor: Any = part if build is None else build(rng, step)
        limit = getattr(part.calibration(), "gimbal_limit", np.pi)
        return cls(sensor, rng, part.tasked, limit, part)


class Plant:
    """True vehicle and world in motion.

    Parameters
    ----------
    world, dynamics, state
        True world, dynamics of the vehicle, and initial state.
    sensors
        Sensor parts by name, each with its random generator.
    steps
        Integration steps per control cycle.
    max_time
        Time limit of a flight, s.
    actuators
        Valves, gimbal and throttle of a lander that has them; None: torques act as commanded.
    faults
        Faults of a lander without actuators: an engine throttle that sticks.
    legs
        Legs whose motion after touchdown gives the outcome; None: the state at touchdown does.

    Attributes
    ----------
    rest
        Result of the motion on the legs; None without a touchdown on legs.
    state, time, verdict
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
        self.verdict: LandingOutcome | None = None
        self.steps = steps
        made = {
            name: Instrument.of(part, rng, dynamics.step) for name, (part, rng) in sensors.items()
        }
        units: list[tuple[str, Any]] = [(name, one.sensor) for name, one in made.items()]
        for name, unit in units:
            if sensors[name][0].gives is InertialSamples and not isinstance(unit, Imu):
                raise InputError(
                    f"sensors.{name}",
                    type(unit).__name__,
                    "must be an inertial unit whose build returns an Imu",
                )
        self.imus: dict[str, Imu] = {n: u for n, u in units if isinstance(u, Imu)}
        self._instruments = {n: i for n, i in made.items() if n not in self.imus}
        self._max_time = max_time
        self._low, self._high = world.terrain.z_range

    def throttled(self, command: Command) -> Command:
        """Return a command with the actual thrust: the throttle may stick."""
        if self._faults is None:
            return command
        thrust = self._faults.throttle(self.time, self._throttle, command.thrust)
        self._throttle = thrust
        return replace(command, thrust=thrust)

    def measure(self, tasks: Sequence[SensorTask] = ()) -> Measurements:
        """Return the measurements of all untasked sensors, and of the tasks."""
        items: list[tuple[str, object]] = [
            (name, self._measure(name, None))
            for name, instrument in self._instruments.items()
            if not instrument.tasked
        ]
        items += [(task.sensor, self._measure(task.sensor, task.mount)) for task in tasks]
        return Measurements(self.time, tuple(items))

    def _measure(self, name: str, mount: Array | None) -> object:
        i = self._instruments[name]
        held = None if mount is None else limit_mount(mount.copy(), i.gimbal_limit)
        found = i.sensor.measure(self.world, self.state, self.time, i.rng, held)
        if not isinstance(found, i.part.gives):
            wanted = f"a measurement of type {i.part.gives.__name__}"
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
        """Adopt the motion of a control cycle; return the measurements at its end.

        Parameters
        ----------
        history
            State vectors after each step (n, 15); states after a touchdown are ignored.
        gyroscopes
            Gyroscope increments already sampled during the cycle, by name (n, 3), rad.
        tasks
            Measurements to make at the end.
        abort
            Whether the lander is aborting: the flight ends once it is clear of the terrain.
        """
        touched = self._first_contact(history)
        steps = len(history) if touched is None else touched + 1
        rows = np.vstack((self.state.as_vector(), history[:steps]))
        self.state = State.from_vector(rows[-1])
        self.time += steps * self.dynamics.step
        samples: list[tuple[str, object]] = []
        for name, imu in self.imus.items():
            angle = gyroscopes[name][:steps] if name in gyroscopes else None
            sensed = imu.sense(*self.gravity_free_states(rows), self.time, angle)
            samples.append((name, sensed))
        self._evaluate_outcome(touched is not None, abort)
        measured = self.measure(tasks if self.verdict is None else ())
        return Measurements(self.time, (*samples, *measured.items))

    def gravity_free_states(self, rows: Array) -> tuple[Array, float, float]:
        """Return states, step and downward gravity from which an inertial unit senses.

        In a gravity field that varies, the velocity gained from gravity is removed from the states,
        and the returned gravity is 0.
        """
        step, moon = self.dynamics.step, self.world.moon
        if moon is None:
            return rows, step, self.world.gravity
        middle = 0.5 * (rows[1:, :6] + rows[:-1, :6])
        out = rows.copy()
        out[1:, 3:6] -= np.cumsum(step * moon.felt(middle[:, :3], middle[:, 3:]), axis=0)
        return out, step, 0.0

    def _evaluate_outcome(self, touched: bool, abort: bool) -> None:
        """Set the landing outcome if the flight is over."""
        terrain = self.world.terrain
        if touched and self.legs is not None:
            self.verdict, self.rest = evaluate_motion(self.legs, self.dynamics, self.state, terrain)
        elif touched:
            self.verdict = evaluate_touchdown(self.lander, self.state, terrain, self.world.gravity)
        elif self.world.under(self.state.position, self._low):
            self.verdict = LandingOutcome(False, ("off-map",), None)
        elif abort and self._clear:
            self.verdict = LandingOutcome(False, (ABORTED,), None)
        elif self.time >= self._max_time:
            self.verdict = LandingOutcome(False, ("time-limit",), None)

    @property
    def _clear(self) -> bool:
        """Whether the lander climbs, well above all terrain."""
        height = self.world.height(self.state.position) - self._high
        return bool(
            height > _ABORT_CLEAR_HEIGHT_M and self.state.velocity[2] > _ABORT_CLIMB_SPEED_M_S
        )

    def _first_contact(self, history: Array) -> int | None:
        """Return the first step at which a pad touches the terrain, or None."""
        if self.world.height(history[-1, :3]) - self._high > _MAX_CONTACT_HEIGHT_M:
            return None
        mounted = self.lander.pads - centre_of_mass(self.lander, float(history[0, 13]))
        pads = history[:, None, 0:3] + quat_rotate(history[:, None, 6:10], mounted)
        gap = pads[..., 2] - self.world.terrain.elevation(pads[..., :2])
        if not np.any(gap <= 2.0):
            return None
        for step, y in enumerate(history):
            pad_heights = pad_contacts(self.lander, State.from_vector(y), self.world.terrain)[:, 2]
            if np.any(pads[step, :, 2] <= pad_heights):
                return step
        return None
