"""By how much landers differ from flight to flight, and what is wrong with what they are told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]

# What a flight draws, in this order.
DRAWN = (
    "load_kg", "specific_impulse_s", "thrust_share", "thrust_lag_s", "offset_x_m", "offset_y_m",
    "fails_at_s", "engine_left", "torque_left_x", "torque_left_y", "torque_left_z",
    "sensing_delay_s", "actuation_delay_s",
)  # fmt: skip


@dataclass(frozen=True)
class Variation:
    """What every flight of ``Guidance-v0`` and ``Control-v0`` draws anew.

    Figures of the lander lie evenly within so much of their own values; noise is normal.

    Attributes
    ----------
    load
        At the centre of mass, over or under the dry mass, kg.
    specific_impulse, thrust, thrust_lag
        Of the engine: s, share, s.
    thrust_offset
        Of the engine's line from the centre of mass, along body x and y, m.
    position_noise, velocity_noise, attitude_noise, rate_noise
        Of what is shown, each time, an axis, m, m/s, rad, rad/s.
    sensing_delay, actuation_delay
        Most by which what is shown, and what is commanded, comes late, s.
    engine_failure, torque_failure
        Share of flights on which thrust, or one axis of torque, is weak from some time on.
    weakest, failure_by
        Least share that is left of it; the latest time, s.
    """

    load: float = quantity(0.0, "kg", ge=0, le=1e4, help="over or under the dry mass, half range")
    specific_impulse: float = quantity(0.0, "s", ge=0, le=100, help="half range")
    thrust: float = quantity(0.0, ge=0, le=0.5, help="share, half range")
    thrust_lag: float = quantity(0.0, "s", ge=0, le=2, help="half range")
    thrust_offset: float = quantity(
        0.0, "m", ge=0, le=0.5, help="of the engine's line from the centre of mass, half range"
    )
    position_noise: float = quantity(0.0, "m", ge=0, le=1e3, help="of what is shown, 1 sigma")
    velocity_noise: float = quantity(0.0, "m/s", ge=0, le=100, help="of what is shown, 1 sigma")
    attitude_noise: float = quantity(0.0, "deg", ge=0, le=30, help="of what is shown, 1 sigma")
    rate_noise: float = quantity(0.0, "deg/s", ge=0, le=30, help="of what is shown, 1 sigma")
    sensing_delay: float = quantity(0.0, "s", ge=0, le=5, help="the most")
    actuation_delay: float = quantity(0.0, "s", ge=0, le=5, help="the most")
    engine_failure: float = quantity(0.0, ge=0, le=1, help="share of flights")
    torque_failure: float = quantity(0.0, ge=0, le=1, help="share of flights")
    weakest: float = quantity(0.5, ge=0, le=1, help="least share left of what fails")
    failure_by: float = quantity(30.0, "s", gt=0, le=1e4, help="latest time of a failure")

    def __post_init__(self) -> None:
        check_bounds(self, "variation")

    @property
    def ranges(self) -> Array:
        """What kernels draw from (12,), SI; see `draw` of the environments' kernels."""
        return np.array([
            self.load, self.specific_impulse, self.thrust, self.thrust_lag, self.thrust_offset,
            self.thrust_offset, self.failure_by, self.engine_failure, self.torque_failure,
            self.weakest, self.sensing_delay, self.actuation_delay,
        ])  # fmt: skip

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviations of what is shown, by part: m, m/s, rad, rad/s."""
        return {
            "position": self.position_noise, "velocity": self.velocity_noise,
            "attitude": self.attitude_noise, "rate": self.rate_noise,
        }  # fmt: skip
