"""Doppler velocimeter: radial speed and slant range along several beams."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lunarsim.frames import quat_rotate
from lunarsim.messages.measurements import DopplerReading
from lunarsim.models.instruments import VelocimeterInstrument
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


@dataclass(frozen=True)
class DopplerVelocimeter:
    """Settings of a Doppler velocimeter with beams on a cone around body -z.

    The defaults are typical of a coherent Doppler lidar such as NASA's Navigation Doppler Lidar: a
    few centimetres per second and a few metres from more than 5 km (Amzajerdian et al.,
    "Development of a coherent Doppler lidar for precision landing on planetary bodies", 2022).

    Attributes
    ----------
    speed_bias, speed_random_walk
        Standard deviation of each beam's initial speed bias, m/s, and of the bias's random walk
        in one second, m/s. The true bias is sampled for every flight; the navigation filter knows
        the standard deviations from the calibration.
    """

    beams: int = quantity(
        3,
        ge=3,
        le=8,
        help="number of beams, evenly spaced around body -z; the first is tilted towards body x",
    )
    cone: float = quantity(22.5, "deg", gt=0, lt=80, help="angle of each beam from body -z")
    speed_noise: float = quantity(0.03, "m/s", gt=0, help="speed noise per beam, 1 sigma")
    speed_bias: float = quantity(
        0.02,
        "m/s",
        ge=0,
        lt=10,
        help="bias of the speeds measured by each beam at the start of the flight, 1 sigma; the "
        "navigation filter knows this sigma",
    )
    speed_random_walk: float = quantity(
        0.005,
        "m/s",
        ge=0,
        lt=10,
        help="random walk of each beam's speed bias in 1 s, 1 sigma; the navigation filter knows "
        "this sigma",
    )
    range_noise: float = quantity(2.0, "m", gt=0, help="range noise per beam, 1 sigma")
    max_range: float = quantity(
        5000.0, "m", gt=0, help="maximum range at which the sensor receives a return"
    )
    max_incidence: float = quantity(
        75.0,
        "deg",
        gt=0,
        le=90,
        help="maximum angle between beam and surface normal at which the sensor receives a return",
    )

    measurement_type: ClassVar[type] = DopplerReading
    is_tasked: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_bounds(self, "velocimeter")

    def build(self, rng: np.random.Generator, step: float) -> BiasedVelocimeter:
        """Return the velocimeter of one flight; speed biases come from `rng`."""
        return BiasedVelocimeter(self, rng)

    def directions(self) -> Array:
        """Return the unit vectors of the beams (n, 3), body axes."""
        azimuth = 2.0 * np.pi * np.arange(self.beams) / self.beams
        across, down = np.sin(self.cone), np.cos(self.cone)
        return np.column_stack(
            (across * np.cos(azimuth), across * np.sin(azimuth), np.full(self.beams, -down))
        )

    def calibration(self) -> VelocimeterInstrument:
        """Return the calibration of the velocimeter for the onboard computer.

        It consists of the directions of the beams and the standard deviations of bias and random
        walk. Each reading includes the standard deviations of its noise.
        """
        beams = tuple((float(x), float(y), float(z)) for x, y, z in self.directions())
        return VelocimeterInstrument(beams, self.speed_bias, self.speed_random_walk)

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> DopplerReading:
        """Measure radial speed and slant range along each beam, with noise but no bias.

        Beams without a return give NaN; random numbers are drawn from `rng` for them too. `state`
        is the true state at `time`, s. `mount` is not used.
        """
        noise = rng.standard_normal((2, self.beams))
        beams = quat_rotate(state.attitude, self.directions())
        hit = world.cast(state.position, beams, self.max_range)
        incidence = np.arccos(np.clip(-np.einsum("ni,ni->n", hit.normal, beams), -1.0, 1.0))
        seen = incidence <= self.max_incidence  # NaN without a hit
        sheet = world.dust_sheet(state.position, state.attitude, state.thrust)
        if sheet is not None:
            seen &= sheet.passes(state.position, beams, 1.0, rng)
        speed = beams @ state.velocity + self.speed_noise * noise[0]
        distance = hit.range + self.range_noise * noise[1]
        return DopplerReading(
            time,
            np.where(seen, speed, np.nan),
            np.where(seen, distance, np.nan),
            np.where(seen, self.speed_noise, np.nan),
            np.where(seen, self.range_noise, np.nan),
        )


class BiasedVelocimeter:
    """Simulated velocimeter of one flight, with a speed bias in each beam.

    Parameters
    ----------
    params
        Parameters of the velocimeter.
    rng
        Source of its errors.

    Attributes
    ----------
    bias
        Speed bias of each beam (n,) at the last reading, m/s; a random walk.
    """

    def __init__(self, params: DopplerVelocimeter, rng: np.random.Generator) -> None:
        self.params = params
        self.bias = params.speed_bias * rng.standard_normal(params.beams)
        self._time: float | None = None

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> DopplerReading:
        """Measure radial speed and slant range along each beam, with noise and bias.

        `state` is the true state at `time`, s; beams without a return give NaN. The biases change
        by their random walk since the last call. `mount` is not used.
        """
        reading = self.params.measure(world, state, time, rng, mount)
        past = 0.0 if self._time is None else time - self._time
        self._time = time
        step = self.params.speed_random_walk * np.sqrt(past)
        self.bias = self.bias + step * rng.standard_normal(self.params.beams)
        return replace(reading, speed=reading.speed + self.bias)
