"""Domain randomization of vehicle, sensing and failures per flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array

# Random quantities of a flight, in the order of their draws.
RANDOM_QUANTITIES = (
    "payload_kg", "specific_impulse_s", "thrust_scale", "thrust_lag_s", "offset_x_m", "offset_y_m",
    "failure_time_s", "engine_effectiveness", "torque_effectiveness_x", "torque_effectiveness_y",
    "torque_effectiveness_z",
    "sensing_delay_s", "actuation_delay_s",
)  # fmt: skip


@dataclass(frozen=True)
class DomainRandomization:
    """Settings of the domain randomization of ``Guidance-v1`` and ``Control-v1``.

    Every flight has new random parameters.
    Vehicle parameters are uniform within plus or minus the half range; noise is normal.

    Attributes
    ----------
    payload
        Half range of the payload at the centre of mass, relative to the dry mass, kg.
    specific_impulse, thrust_scale, thrust_lag
        Half ranges of the engine parameters: s, fraction, s.
    thrust_offset
        Half range of the distance of the engine's axis from the centre of mass, along body x and y,
        m.
    position_noise, velocity_noise, attitude_noise, rate_noise
        Noise of each observation, 1 sigma per axis, m, m/s, rad, rad/s.
    sensing_delay, actuation_delay
        Maximum delay of observations and of commands, s.
    engine_failure, torque_failure
        Probability per flight of weak thrust, or of weak torque about one axis, from a random time
        on.
    min_remaining_fraction, latest_failure
        Minimum remaining fraction of thrust or torque; latest time of a failure, s.
    """

    payload: float = quantity(
        0.0,
        "kg",
        ge=0,
        le=1e4,
        help="maximum random change of the lander's dry mass, plus or minus; new in each flight",
    )
    specific_impulse: float = quantity(
        0.0,
        "s",
        ge=0,
        le=100,
        help="maximum random change of the specific impulse, plus or minus; new in each flight",
    )
    thrust_scale: float = quantity(
        0.0,
        ge=0,
        le=0.5,
        help="maximum random change of the thrust, plus or minus, as a fraction of its nominal "
        "value; new in each flight",
    )
    thrust_lag: float = quantity(
        0.0,
        "s",
        ge=0,
        le=2,
        help="maximum random change of the engine's time constant, plus or minus; new in each "
        "flight",
    )
    thrust_offset: float = quantity(
        0.0,
        "m",
        ge=0,
        le=0.5,
        help="maximum random offset of the engine axis from the centre of mass, along body x and "
        "body y, plus or minus; new in each flight",
    )
    position_noise: float = quantity(
        0.0, "m", ge=0, le=1e3, help="noise of the observed position, 1 sigma per axis"
    )
    velocity_noise: float = quantity(
        0.0, "m/s", ge=0, le=100, help="noise of the observed velocity, 1 sigma per axis"
    )
    attitude_noise: float = quantity(
        0.0, "deg", ge=0, le=30, help="noise of the observed attitude, 1 sigma per axis"
    )
    rate_noise: float = quantity(
        0.0, "deg/s", ge=0, le=30, help="noise of the observed angular rate, 1 sigma per axis"
    )
    sensing_delay: float = quantity(
        0.0,
        "s",
        ge=0,
        le=5,
        help="maximum delay of observations; the delay is random in each flight, between 0 and "
        "this value",
    )
    actuation_delay: float = quantity(
        0.0,
        "s",
        ge=0,
        le=5,
        help="maximum delay of commands; the delay is random in each flight, between 0 and this "
        "value",
    )
    engine_failure: float = quantity(
        0.0,
        ge=0,
        le=1,
        help="probability per flight that the engine loses part of its thrust at a random time",
    )
    torque_failure: float = quantity(
        0.0,
        ge=0,
        le=1,
        help="probability per flight that the control torque about one body axis becomes weaker at "
        "a random time",
    )
    min_remaining_fraction: float = quantity(
        0.5,
        ge=0,
        le=1,
        help="minimum fraction of thrust or torque that remains after a failure; the fraction is "
        "random, between this value and 1",
    )
    latest_failure: float = quantity(
        30.0,
        "s",
        gt=0,
        le=1e4,
        help="latest time in the flight at which a failure of thrust or torque can begin",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "domain_randomization")

    @property
    def ranges(self) -> Array:
        """Ranges (12,), SI units, from which compiled functions sample the parameters.

        They are the half ranges of payload, specific impulse, thrust scale, thrust lag and thrust
        offset (x, y); the latest time of a failure; the probabilities of engine and torque failure;
        the minimum remaining fraction; the maximum delays of observations and commands.
        """
        return np.array([
            self.payload, self.specific_impulse, self.thrust_scale, self.thrust_lag,
            self.thrust_offset,
            self.thrust_offset, self.latest_failure, self.engine_failure, self.torque_failure,
            self.min_remaining_fraction, self.sensing_delay, self.actuation_delay,
        ])  # fmt: skip

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviations of the observation noise by component: m, m/s, rad, rad/s."""
        return {
            "position": self.position_noise, "velocity": self.velocity_noise,
            "attitude": self.attitude_noise, "rate": self.rate_noise,
        }  # fmt: skip
