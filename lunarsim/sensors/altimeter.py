"""Radar altimeter: slant range along its boresight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_rotate
from lunarsim.messages.measurements import AltimeterReading
from lunarsim.models.instruments import FixedBeam
from lunarsim.parts.quantity import check_bounds, check_direction, quantity
from lunarsim.vehicle.state import State
from lunarsim.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RadarAltimeter:
    """An altimeter fixed to the body.

    Attributes
    ----------
    boresight
        Unit vector (3,), body axes.
    noise_ratio, noise_floor
        Standard deviation: a share of the range, and metres, added in quadrature.
    max_range
        m.
    max_incidence
        Greatest angle between beam and surface normal with a return, rad.
    """

    boresight: tuple[float, float, float] = quantity(
        (0.0, 0.0, -1.0), help="unit vector, body axes"
    )
    noise_ratio: float = quantity(0.01, ge=0, help="1 sigma over the range")
    noise_floor: float = quantity(0.1, "m", ge=0, help="1 sigma, in quadrature")
    max_range: float = quantity(3000.0, "m", gt=0, help="no return beyond")
    max_incidence: float = quantity(60.0, "deg", gt=0, le=90, help="no return beyond")

    gives: ClassVar[type] = AltimeterReading
    tasked: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_direction("altimeter.boresight", self.boresight)
        check_bounds(self, "altimeter")

    def calibration(self) -> FixedBeam:
        """Return what the onboard computer may know of it."""
        return FixedBeam(self.boresight)

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> AltimeterReading:
        """Return one reading; noise is drawn whether or not there is a return."""
        noise = float(rng.standard_normal())
        beam = quat_rotate(state.attitude, self.boresight)
        hit = world.cast(state.position, beam[None, :], self.max_range)
        incidence = np.arccos(np.clip(-hit.normal[0] @ beam, -1.0, 1.0))
        if not incidence <= self.max_incidence:  # NaN without a hit
            return AltimeterReading(time, np.nan, np.nan)
        distance = float(hit.range[0])
        sigma = float(np.hypot(self.noise_floor, self.noise_ratio * distance))
        measured = distance + sigma * noise
        # What is stated goes by what was measured: the truth stays here.
        stated = float(np.hypot(self.noise_floor, self.noise_ratio * measured))
        return AltimeterReading(time, measured, stated)
