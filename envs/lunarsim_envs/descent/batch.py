"""Simulate many landers in parallel: vehicle parameters, states and motion.

A lane is one lander of the batch with its current flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.core.touchdown import VALUES
from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import STANDARD_GRAVITY, Lander
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.scenario import Scenario
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.vehicle._kernels import SIMD_BATCH
from lunarsim.vehicle.domain_randomization import RANDOM_QUANTITIES, DomainRandomization
from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.touchdown import (
    TERRAIN_SAMPLE_SPACING_M,
    pad_disc,
    touchdown_params,
    violated_limits,
)
from lunarsim_envs.arguments import FAULTS_REMEDY
from lunarsim_envs.descent import _kernels as k
from lunarsim_envs.descent.worlds import WorldPool

FLYING, LANDED, LOST, LATE, AWAY = k.FLYING, k.LANDED, k.LOST, k.LATE, k.AWAY
# Compute time per lane and step, microseconds.
_STEP = 0.1
# Values of the randomized parameters without domain randomization.
_ALIKE = np.zeros(len(RANDOM_QUANTITIES))
_ALIKE[k.FAILS] = np.inf
_ALIKE[k.ENGINE : k.SEES_LATE] = 1.0


@dataclass(frozen=True)
class VehicleParams:
    """Parameters of lander, start, target and time limit, in the form for kernels.

    Attributes
    ----------
    dynamics
        Nominal vehicle, gravity and time step.
    true_lander
        Vehicle with the deviations of `[truth.vehicle]`.
    gains
        Gains of the attitude loop (3,), defined in `ProportionalDerivative`.
    heading, max_tilt
        Azimuth of body x, and maximum tilt of a commanded thrust, rad.
    start
        Planned position (3,) and velocity (3,), and their standard deviations per axis (8,), m and
        m/s.
    target_area
        Centre and half widths of the target area, east and north (4,), m.
    time_limit
        Time limit of a flight, s.
    domain_randomization
        Ranges of the randomized parameters; None disables domain randomization.
    """

    dynamics: Dynamics
    true_lander: Lander
    gains: Array
    heading: float
    max_tilt: float
    start: Array
    target_area: Array
    time_limit: float
    domain_randomization: DomainRandomization | None = None

    @classmethod
    def of(cls, scenario: Scenario) -> VehicleParams:
        """Read the parameters from a scenario.

        Raises
        ------
        InputError
            If the scenario has thrusters, legs, faults, a round Moon or another control law, which
            only the full simulation supports.
        """
        lander, control = scenario.vehicle.make(), scenario.control.make()
        if isinstance(lander, JetLander):
            raise InputError("vehicle.kind", "jet-lander", "must be 'lander' in this environment")
        for table, remedy in (
            ("legs", ""), ("faults", FAULTS_REMEDY), ("sensor_faults", FAULTS_REMEDY), ("moon", ""),
            ("dust", ""),
        ):  # fmt: skip
            if getattr(scenario, table) not in (None, {}):
                raise InputError(
                    table, None, "must be omitted, because this environment does not support it",
                    remedy, show_value=False,
                )  # fmt: skip
        if type(control) is not ProportionalDerivative:
            raise InputError(
                "control.kind", type(control).__name__, "must be 'pd' in this environment"
            )
        scenario.check_hover()
        true_lander = scenario.true_lander()
        randomization = (
            None if scenario.domain_randomization is None else scenario.domain_randomization.make()
        )
        _check_ranges(randomization, true_lander, scenario.simulation.make().step)
        start, target = scenario.start.make(), scenario.target.make()
        clock, approach = scenario.simulation.make(), scenario.approach.make()
        return cls(
            Dynamics(lander, scenario.gravity_m_s2, clock.step),
            true_lander,
            control.gains,
            start.heading,
            approach.max_tilt,
            np.array(
                [*start.position, *start.velocity, start.position_sigma, start.velocity_sigma]
            ),
            np.array([*target.position, *target.scatter]),
            clock.max_time,
            randomization,
        )

    def steps(self, rate: float) -> int:
        """Return the number of integration steps between two actions at `rate` Hz.

        Raises
        ------
        InputError
            If that number is not an integer.
        """
        steps = 1.0 / (rate * self.dynamics.step)
        if not (steps >= 1.0 and abs(steps - round(steps)) < 1e-6):
            raise InputError(
                "rate_hz", rate,
                f"must have a period (1 / rate_hz) that is a multiple of simulation.step_s "
                f"({self.dynamics.step:g} s)",
            )  # fmt: skip
        return round(steps)


def _check_ranges(
    randomization: DomainRandomization | None, lander: Lander, time_step: float
) -> None:
    """Check that random payload, specific impulse and thrust lag fit a lander.

    Masses and impulses must stay positive, and the lag above two time steps (`time_step`, s).
    """
    if randomization is None:
        return
    two_steps = 2.0 * time_step
    for key, value, maximum, limit in (
        ("payload_kg", randomization.payload, lander.dry_mass, "vehicle.dry_mass_kg"),
        ("specific_impulse_s", randomization.specific_impulse, lander.specific_impulse,
         "vehicle.specific_impulse_s"),
        ("thrust_lag_s", randomization.thrust_lag, lander.thrust_lag - two_steps,
         f"vehicle.thrust_lag_s minus {two_steps:g} s"),
    ):  # fmt: skip
        if value > 0.0 and not value < maximum:
            raise InputError(
                f"domain_randomization.{key}",
                value,
                f"must be 0, or less than {limit} ({max(maximum, 0.0):g})",
            )


class DescentBatch:
    """States and flights of many landers that are simulated in parallel.

    A lane is one lander of the batch with its current flight.

    Parameters
    ----------
    count
        Number of lanes n.
    craft, worlds
        Vehicle parameters, and pool of worlds.
    guided
        Whether actions are thrust accelerations (true), or thrust and torques (false).
    rate
        Action rate, Hz.

    Attributes
    ----------
    y
        States (n, 15), SI: position, velocity (ENU), attitude (scalar last), body rate, mass and
        thrust.
    target
        Target positions (n, 3), m.
    world
        Index of the world of each lane (n,).
    time
        Time since the start of each flight (n,), s.
    ended
        State of the flight: FLYING, LANDED (a pad has touched), LOST (below the terrain, outside
        the stored map), LATE (time limit) or AWAY (too far from the target) (n,).
    failed
        Violated touchdown limits (n,), one bit each in the order of `core.touchdown.CAUSES`.
    touchdown_values
        Values at touchdown (n, values) in the order of `core.touchdown.VALUES`, SI.
    starts, target_areas
        Start and target parameters of each lane, as `VehicleParams.start` (n, 8) and
        `VehicleParams.target_area` (n, 4).
    world_ranges
        Index of the first world that each lane may use, and number of these worlds (n, 2).
    max_distance
        Distance of each lander from its target at which the flight ends (n,), m. It is the distance
        at the start, at least the planned one, times `max_distance_ratio`.
    has_key
        Whether each lane has a random key (n,).
    params
        Gravity, exhaust velocity, thrust lag, dry mass and wet mass of each lane (n, 5), SI.
    randomized
        Other randomized parameters of each flight (n, 13), in the order of
        `domain_randomization.RANDOM_QUANTITIES`.
    """

    max_distance_ratio: ClassVar[float] = 1.5

    def __init__(
        self, count: int, craft: VehicleParams, worlds: WorldPool, *, guided: bool, rate: float
    ) -> None:
        d = replace(craft.dynamics, lander=craft.true_lander)
        self.count, self.craft, self.worlds, self.guided = count, craft, worlds, guided
        self.steps = craft.steps(rate)
        self.y, self.target = np.zeros((count, 15)), np.zeros((count, 3))
        self.time, self.touchdown_values = np.zeros(count), np.full((count, len(VALUES)), np.nan)
        self.ended, self.failed = np.full(count, LATE), np.zeros(count, np.int64)
        self.starts = np.tile(craft.start, (count, 1))
        self.max_distance = np.full(count, np.inf)
        self.target_areas = np.tile(craft.target_area, (count, 1))
        self.world_ranges = np.tile(worlds.span(None), (count, 1))
        self.has_key = np.zeros(count, np.bool_)
        self._keys, self._flight_counts = np.zeros(count, np.uint64), np.zeros(count, np.int64)
        self._rate, self.world = np.zeros((count, 3)), np.zeros(count, np.int64)
        self._true_params = d.params
        self.params = np.tile(d.params, (count, 1))
        self.randomized = np.tile(_ALIKE, (count, 1))
        self._counts = np.zeros(count, np.int64)
        self._upright = attitude_from_thrust([0.0, 0.0, 1.0], craft.heading)
        v = craft.true_lander
        weight = v.thrust_scale * craft.dynamics.lander.wet_mass * d.gravity
        self._weight = np.array([v.wet_mass, weight])
        control = [v.thrust_min, v.thrust_max, craft.max_tilt, *craft.gains, *v.torque_max]
        self._vehicle = k.Vehicle(
            self.params, self.randomized, d.inertia, d.plain_rig, np.array(control), craft.heading,
            v.pads - v.com_offset, pad_disc(0.5 * v.pad_diameter), TERRAIN_SAMPLE_SPACING_M,
            touchdown_params(v, d.gravity).limits,
            v.com_height + v.com_offset[2], craft.dynamics.inertia,
            v.wet_mass - craft.dynamics.lander.wet_mass, v.thrust_scale, v.torque_scale,
        )  # fmt: skip
        rise = 0.5 * v.pad_diameter * worlds.max_slopes + 1e-3  # 1 mm for rounding
        self._terrains = k.TerrainRasters(worlds.terrains, worlds.frame, worlds.levels, rise)

    @property
    def _flights(self) -> k.Flights:
        return k.Flights(
            self.world, self.time, self.ended, self.failed, self.touchdown_values, self.target,
            self.max_distance,
        )  # fmt: skip

    @property
    def keys(self) -> NDArray[np.uint64]:
        """Random key of each lander (n,)."""
        return self._keys

    @property
    def flight_counts(self) -> IntArray:
        """Number of flights that each lander has started with its key (n,)."""
        return self._flight_counts

    def seed(self, mask: BoolArray, keys: NDArray[np.uint64]) -> None:
        """Set the random keys of the landers of `mask` (n,), one key per selected lander.

        The key, a 64-bit integer, fixes all later flights of its lander.
        """
        self._keys[mask] = keys
        self._flight_counts[mask] = 0
        self._counts[mask] = 0
        self.has_key[mask] = True

    def begin(self, mask: BoolArray) -> None:
        """Start new flights of the landers of `mask` (n,).

        Start, target and world of each flight are random.
        """
        w = self.worlds
        k.begin.run_loop(
            self.count, _STEP,
            mask, self._keys, self._flight_counts, self.y, self._rate, self.target, self.world,
            self.time, self.ended, self.starts, self.target_areas, self.world_ranges,
            self._upright, self._weight, w.rock_free_terrains, w.rock_free_frame,
        )  # fmt: skip
        if self.craft.domain_randomization is not None:
            k.randomize.run_loop(
                self.count, _STEP,
                mask, self._keys, self._flight_counts, self.craft.domain_randomization.ranges,
                STANDARD_GRAVITY, self._true_params, self.randomized, self.params, self.y,
            )  # fmt: skip
        planned = np.linalg.norm(self.craft.start[:3])
        start = np.linalg.norm(self.y[mask, :3] - self.target[mask], axis=1)
        self.max_distance[mask] = self.max_distance_ratio * np.maximum(start, planned)
        self.failed[mask] = 0
        self.touchdown_values[mask] = np.nan

    def normals(self, mask: BoolArray, size: int) -> Array:
        """Return `size` standard normal numbers per lander of `mask` (n, size).

        Landers outside the mask get 0.
        """
        found = np.zeros((self.count, size))
        k.sample_normals.run_loop(self.count, 0.02 * size, mask, self._keys, self._counts, found)
        return found

    def move(self, actions: Array) -> None:
        """Fly all landers that have not ended until the next action is due, or to the end.

        Parameters
        ----------
        actions
            Thrust accelerations (n, 3), ENU, m/s^2, or thrust and torques (n, 4), N and N m.
        """
        step = self.craft.dynamics.step
        k.advance.run_loop(
            self.count, _STEP * self.steps,
            self.y, self._rate, actions, self.guided, self.steps, step, self.craft.time_limit,
            min(SIMD_BATCH, self.count), self._vehicle, self._terrains, self._flights,
        )  # fmt: skip

    def stop(self, mask: BoolArray) -> None:
        """End the flights of `mask` (n,) that are still flying, as if by the time limit."""
        self.ended[mask & (self.ended == FLYING)] = LATE

    @property
    def safe(self) -> BoolArray:
        """Whether each lander has landed within all limits (n,)."""
        return np.asarray((self.ended == LANDED) & (self.failed == 0))

    @property
    def miss(self) -> Array:
        """Horizontal distance of each lander from its target (n,), m."""
        return np.asarray(np.linalg.norm(self.y[:, :2] - self.target[:, :2], axis=1))

    @property
    def propellant_used(self) -> Array:
        """Propellant that each lander has used since its start (n,), kg."""
        return np.asarray(self.params[:, 4] - self.y[:, 13])

    def failure_causes(self, lane: int) -> tuple[str, ...]:
        """Return why the flight of a lander failed: the names of the violated limits.

        `lane` is the index of the lander. A flight that reached the time limit gives
        ``("time-limit",)``, one too far from its target ``("flown-away",)``, a safe landing ``()``.
        """
        if self.ended[lane] in (LATE, AWAY):
            return ("time-limit" if self.ended[lane] == LATE else "flown-away",)
        return violated_limits(int(self.failed[lane]))
