"""Landers side by side, a lane each: what they are, where they stand, and how they move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import STANDARD_GRAVITY, Lander
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.scenario import Scenario
from lunarsim.vehicle._kernels import WIDE
from lunarsim.vehicle.dynamics import PLAIN_RIG, Dynamics
from lunarsim.vehicle.touchdown import GROUND_SPACING, pad_disc
from lunarsim.vehicle.variation import DRAWN, Variation
from lunarsim_envs.descent import _kernels as k
from lunarsim_envs.descent.worlds import Worlds

Array = NDArray[np.float64]

FLYING, LANDED, LOST, LATE = k.FLYING, k.LANDED, k.LOST, k.LATE
# What a lane and step take, microseconds.
_STEP = 0.1
# What is drawn where all flights are alike.
_ALIKE = np.zeros(len(DRAWN))
_ALIKE[k.FAILS] = np.inf
_ALIKE[k.ENGINE : k.SEES_LATE] = 1.0
# Limits that a verdict names, in the order of its bits; see `judge_touchdown`.
LIMITS = (
    "off-map", "vertical-speed", "horizontal-speed", "tilt", "rate", "slope", "roughness", "belly",
    "tip-over",
)  # fmt: skip


@dataclass(frozen=True)
class Craft:
    """A scenario's lander, start and clock, as the kernels take them.

    Attributes
    ----------
    dynamics
        Vehicle, gravity and step.
    gains
        Of the attitude loop (3,); see `ProportionalDerivative`.
    heading, max_tilt
        Azimuth of body x and largest tilt of a commanded thrust, rad.
    start
        Planned position and velocity and their standard deviations (8,).
    aim
        Middle and half sides of the targets' scatter (4,), m.
    limit
        When a flight is over, s.
    variation
        What every flight draws anew; None: all are alike.
    """

    dynamics: Dynamics
    gains: Array
    heading: float
    max_tilt: float
    start: Array
    aim: Array
    limit: float
    variation: Variation | None = None

    @classmethod
    def of(cls, scenario: Scenario) -> Craft:
        """Return what a scenario flies.

        Raises
        ------
        InputError
            If it has thrusters, legs, a round Moon or a control law that only the whole
            simulation flies.
        """
        lander, control = scenario.vehicle.make(), scenario.control.make()
        if isinstance(lander, JetLander):
            raise InputError("vehicle.kind", "jet-lander", "a lander whose torques act as asked")
        if scenario.legs is not None:
            raise InputError("legs", "given", "left out: here the state at the touchdown counts")
        if scenario.faults is not None:
            raise InputError("faults", "given", "left out: here nothing sticks; see variation")
        if scenario.moon is not None:
            raise InputError("moon", "given", "left out: here the ground is level")
        if type(control) is not ProportionalDerivative:
            raise InputError("control.kind", type(control).__name__, "the default control law")
        lander.check_hover(scenario.gravity_m_s2)
        varied = None if scenario.variation is None else scenario.variation.make()
        _check_ranges(varied, lander, scenario.simulation.make().step)
        start, target = scenario.start.make(), scenario.target.make()
        clock, approach = scenario.simulation.make(), scenario.approach.make()
        return cls(
            Dynamics(lander, scenario.gravity_m_s2, clock.step),
            control.gains,
            start.heading,
            approach.max_tilt,
            np.array(
                [*start.position, *start.velocity, start.position_sigma, start.velocity_sigma]
            ),
            np.array([*target.position, *target.scatter]),
            clock.max_time,
            varied,
        )

    def steps(self, rate: float) -> int:
        """Return the steps of the integration between two actions.

        Raises
        ------
        InputError
            If they are not a whole number.
        """
        steps = 1.0 / (rate * self.dynamics.step)
        if not (steps >= 1.0 and abs(steps - round(steps)) < 1e-6):
            raise InputError(
                "rate_hz", rate, f"a whole number of steps of {self.dynamics.step} s between two"
            )
        return round(steps)


def _check_ranges(varied: Variation | None, lander: Lander, step: float) -> None:
    """Refuse ranges that leave nothing of what they change, or too little to integrate."""
    if varied is None:
        return
    for name, most in (
        ("load", lander.dry_mass), ("specific_impulse", lander.specific_impulse),
        ("thrust_lag", lander.thrust_lag - 2.0 * step),
    ):  # fmt: skip
        given = getattr(varied, name)
        if given > 0.0 and not given < most:
            raise InputError(
                f"variation.{name}", given, f"less than {max(most, 0.0):g}, or 0, with this lander"
            )


class Lanes:
    """Landers side by side.

    Parameters
    ----------
    count
        Number of lanes n.
    craft, worlds
        What flies, and over what.
    guided
        Whether actions are thrust accelerations, or thrust and torques; see `move`.
    rate
        Actions a second.

    Attributes
    ----------
    y
        States (n, 15): position, velocity (ENU), attitude (scalar last), body rate, mass, thrust.
    target
        Where each is to land (n, 3), m.
    world
        Index of the world that each flies over (n,).
    time
        Since the start of each flight (n,), s.
    ended
        FLYING, LANDED (a pad has touched), LOST (off the map) or LATE (n,).
    failed, told
        Limits that a landing failed, a bit each in the order of `LIMITS` (n,); its vertical and
        horizontal speed, tilt, rate, slope, roughness and tip margin (n, 7), SI.
    starts, aims
        Of each lane, as `Craft.start` (n, 8) and `Craft.aim` (n, 4).
    spans
        First of the worlds that each may meet, and how many there are (n, 2).
    has_key
        Whether each was given a key (n,).
    figures, drawn
        Gravity, exhaust velocity, thrust lag, dry and wet mass of each (n, 5), and what else its
        flight has drawn (n, 13), in the order of `variation.DRAWN`.
    """

    def __init__(
        self, count: int, craft: Craft, worlds: Worlds, *, guided: bool, rate: float
    ) -> None:
        d, lander = craft.dynamics, craft.dynamics.lander
        self.count, self.craft, self.worlds, self.guided = count, craft, worlds, guided
        self.steps = craft.steps(rate)
        self.y, self.target = np.zeros((count, 15)), np.zeros((count, 3))
        self.time, self.told = np.zeros(count), np.full((count, 7), np.nan)
        self.ended, self.failed = np.full(count, LATE), np.zeros(count, np.int64)
        self.starts, self.aims = np.tile(craft.start, (count, 1)), np.tile(craft.aim, (count, 1))
        self.spans = np.tile(worlds.span(None), (count, 1))
        self.has_key = np.zeros(count, np.bool_)
        self._keys, self._begun = np.zeros(count, np.uint64), np.zeros(count, np.int64)
        self._rate, self.world = np.zeros((count, 3)), np.zeros(count, np.int64)
        self.figures = np.tile(d.figures, (count, 1))
        self.drawn = np.tile(_ALIKE, (count, 1))
        self._counts = np.zeros(count, np.int64)
        self._upright = attitude_from_thrust([0.0, 0.0, 1.0], craft.heading)
        self._weight = np.array([lander.wet_mass, lander.wet_mass * d.gravity])
        v = lander
        control = [v.thrust_min, v.thrust_max, craft.max_tilt, *craft.gains, *v.torque_max]
        limits = [
            v.vertical_speed_limit, v.horizontal_speed_limit, v.tilt_limit, v.rate_limit,
            v.slope_limit, v.roughness_limit, v.belly_clearance,
        ]  # fmt: skip
        self._vehicle = k.Vehicle(
            self.figures, self.drawn, d.inertia, PLAIN_RIG, np.array(control), craft.heading,
            v.pads, pad_disc(0.5 * v.pad_diameter), GROUND_SPACING, np.array(limits), v.com_height,
        )  # fmt: skip
        self._grounds = k.Grounds(worlds.grounds, worlds.frame, worlds.levels)

    @property
    def _flights(self) -> k.Flights:
        return k.Flights(self.world, self.time, self.ended, self.failed, self.told)

    @property
    def keys(self) -> NDArray[np.uint64]:
        """Key of each lane (n,)."""
        return self._keys

    @property
    def begun(self) -> NDArray[np.int64]:
        """How many flights each lane has begun with its key (n,)."""
        return self._begun

    def seed(self, mask: NDArray[np.bool_], keys: NDArray[np.uint64]) -> None:
        """Give lanes their keys, from which all of their later flights are drawn."""
        self._keys[mask] = keys
        self._begun[mask] = 0
        self._counts[mask] = 0
        self.has_key[mask] = True

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Draw a new flight in every lane of `mask` (n,)."""
        w = self.worlds
        with threads_for(_STEP * self.count):
            k.begin(
                mask, self._keys, self._begun, self.y, self._rate, self.target, self.world,
                self.time, self.ended, self.starts, self.aims, self.spans, self._upright,
                self._weight, w.reliefs, w.relief_frame,
            )  # fmt: skip
            if self.craft.variation is not None:
                k.vary(
                    mask, self._keys, self._begun, self.craft.variation.ranges, STANDARD_GRAVITY,
                    self.craft.dynamics.figures, self.drawn, self.figures, self.y,
                )  # fmt: skip
        self.failed[mask] = 0
        self.told[mask] = np.nan

    def normals(self, mask: NDArray[np.bool_], size: int) -> Array:
        """Draw standard normal numbers for lanes of `mask` (n, size); 0 in the others."""
        found = np.zeros((self.count, size))
        with threads_for(0.02 * self.count * size):
            k.scatter(mask, self._keys, self._counts, found)
        return found

    def move(self, actions: Array) -> None:
        """Fly all lanes that are in flight to the next action, or to their end.

        Parameters
        ----------
        actions
            Thrust accelerations (n, 3), ENU, m/s^2, or thrust and torques (n, 4), N and N m.
        """
        step = self.craft.dynamics.step
        with threads_for(_STEP * self.count * self.steps):
            k.advance(
                self.y, self._rate, actions, self.guided, self.steps, step, self.craft.limit,
                min(WIDE, self.count), self._vehicle, self._grounds, self._flights,
            )  # fmt: skip

    def stop(self, mask: NDArray[np.bool_]) -> None:
        """End the flights that are still in the air in the lanes of `mask` (n,)."""
        self.ended[mask & (self.ended == FLYING)] = LATE

    @property
    def safe(self) -> NDArray[np.bool_]:
        """Whether each has landed within all limits (n,)."""
        return np.asarray((self.ended == LANDED) & (self.failed == 0))

    @property
    def miss(self) -> Array:
        """Distance over the ground from the target (n,), m."""
        return np.asarray(np.linalg.norm(self.y[:, :2] - self.target[:, :2], axis=1))

    @property
    def burnt(self) -> Array:
        """Propellant burnt since the start (n,), kg."""
        return np.asarray(self.figures[:, 4] - self.y[:, 13])

    def words(self, lane: int) -> tuple[str, ...]:
        """Return the limits that a lane's flight failed."""
        if self.ended[lane] == LATE:
            return ("time-limit",)
        return tuple(name for bit, name in enumerate(LIMITS) if self.failed[lane] >> bit & 1)
