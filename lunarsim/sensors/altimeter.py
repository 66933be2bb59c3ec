"""Radar altimeter: slant range along its boresight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.frames import quat_rotate
from lunarsim.messages.measurements import AltimeterReading
from lunarsim.models.instruments import AltimeterInstrument
from lunarsim.parts.quantity import check_bounds, check_direction, quantity
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


@dataclass(frozen=True)
class RadarAltimeter:
    """Settings and simulation of a radar altimeter fixed to the body."""

    boresight: tuple[float, float, float] = quantity(
        (0.0, 0.0, -1.0), help="direction of the beam, unit vector in body axes"
    )
    noise_ratio: float = quantity(0.01, ge=0, help="range noise divided by range, 1 sigma")
    noise_floor: float = quantity(
        0.1,
        "m",
        ge=0,
        help="part of the range noise that does not depend on range, 1 sigma; added in quadrature",
    )
    max_range: float = quantity(
        3000.0, "m", gt=0, help="maximum range at which the sensor receives a return"
    )
    max_incidence: float = quantity(
        60.0,
        "deg",
        gt=0,
        le=90,
        help="maximum angle between beam and surface normal at which the sensor receives a return",
    )

    measurement_type: ClassVar[type] = AltimeterReading
    is_tasked: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_direction("altimeter.boresight", self.boresight)
        check_bounds(self, "altimeter")

    def calibration(self) -> AltimeterInstrument:
        """Return the calibration for the onboard computer: the direction of the beam.

        The noise is not part of it, because each reading includes its standard deviation.
        """
        return AltimeterInstrument(self.boresight)

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> AltimeterReading:
        """Measure the slant range along the beam, with noise; NaN without a return.

        `state` is the true state at `time`, s. Random numbers are drawn from `rng` even without a
        return. `mount` is not used.
        """
        noise = float(rng.standard_normal())
        beam = quat_rotate(state.attitude, self.boresight)
        hit = world.cast(state.position, beam[None, :], self.max_range)
        incidence = np.arccos(np.clip(-hit.normal[0] @ beam, -1.0, 1.0))
        is_seen = incidence <= self.max_incidence  # NaN without a hit
        sheet = world.dust_sheet(state.position, state.attitude, state.thrust)
        if sheet is not None:
            ratio = sheet.settings.radar_ratio
            is_seen &= sheet.passes(state.position, beam[None, :], ratio, rng)[0]
        if not is_seen:
            return AltimeterReading(time, np.nan, np.nan)
        distance = float(hit.range[0])
        sigma = float(np.hypot(self.noise_floor, self.noise_ratio * distance))
        measured = distance + sigma * noise
        # The reported sigma depends on the measured range, so that it does not reveal the true one.
        stated = float(np.hypot(self.noise_floor, self.noise_ratio * measured))
        return AltimeterReading(time, measured, stated)
