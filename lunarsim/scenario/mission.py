"""Define the mission tables of a scenario: start, target and clock."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity

_MAX_CYCLES = 1_000_000
# Bounds of the start position (m) and velocity (m/s). Beyond them, an approach over flat terrain
# cannot be flown.
_MAX_DISTANCE_M, _MAX_SPEED_M_S = 1e6, 1e4


@dataclass(frozen=True)
class Start:
    """Planned start of a flight relative to the target, and its dispersion.

    Attributes
    ----------
    position, velocity
        Planned position relative to the terrain at the target, and velocity (3,), ENU, m and m/s.
    heading
        Azimuth of body x, clockwise from north, constant during the flight, rad.
    position_sigma, velocity_sigma
        Dispersion of the true start about the plan, 1 sigma per axis, m and m/s.
    """

    position: tuple[float, float, float] = quantity(
        (-600.0, 0.0, 500.0),
        "m",
        ge=-_MAX_DISTANCE_M,
        le=_MAX_DISTANCE_M,
        help="Planned start position relative to the target (ENU)",
    )
    velocity: tuple[float, float, float] = quantity(
        (28.0, 0.0, -18.0),
        "m/s",
        ge=-_MAX_SPEED_M_S,
        le=_MAX_SPEED_M_S,
        help="Planned start velocity (ENU)",
    )
    heading: float = quantity(
        90.0,
        "deg",
        help="Azimuth of the lander's x axis, clockwise from north; constant during the flight",
    )
    position_sigma: float = quantity(
        10.0,
        "m",
        ge=0,
        help="Random deviation of the true start position from the plan, 1 sigma per axis",
    )
    velocity_sigma: float = quantity(
        0.5,
        "m/s",
        ge=0,
        help="Random deviation of the true start velocity from the plan, 1 sigma per axis",
    )


@dataclass(frozen=True)
class InitialUncertainty:
    """Initial uncertainty of the onboard state estimate.

    Attributes
    ----------
    position, velocity, attitude
        Standard deviations of the initial estimate per axis, m, m/s, rad.
    target_elevation
        Standard deviation of the target elevation known to the mission, m.
    """

    position: float = quantity(
        5.0,
        "m",
        ge=0,
        le=1e5,
        help="Uncertainty of the onboard position estimate at the start, 1 sigma per axis",
    )
    velocity: float = quantity(
        0.02,
        "m/s",
        ge=0,
        le=1e3,
        help="Uncertainty of the onboard velocity estimate at the start, 1 sigma per axis",
    )
    attitude: float = quantity(
        0.03,
        "deg",
        ge=0,
        le=30,
        help="Uncertainty of the onboard attitude estimate at the start, 1 sigma per axis",
    )
    target_elevation: float = quantity(
        0.0,
        "m",
        ge=0,
        le=1e4,
        help="Uncertainty of the elevation of the planned landing site in the onboard data, 1 "
        "sigma",
    )


@dataclass(frozen=True)
class PlannedSite:
    """Planned landing site of a flight, before any divert, and its random scatter.

    Attributes
    ----------
    position
        East and north coordinate (2,), m.
    scatter
        Half widths of the target's uniform random offset, east and north (2,), m.
    """

    position: tuple[float, float] = quantity(
        (0.0, 0.0),
        "m",
        help="Coordinates of the planned landing site, east and north of the centre of the terrain",
    )
    scatter: tuple[float, float] = quantity(
        (0.0, 0.0),
        "m",
        ge=0,
        help="Maximum random offset of the planned landing site, east and north; uniform and new "
        "for each flight",
    )


@dataclass(frozen=True)
class CommandDelay:
    """Delay between the measurements of a cycle and the effect of the commands.

    Attributes
    ----------
    latency, jitter
        Constant delay, and maximum of an additional random delay, s.
    measured
        Whether the computing time of the onboard computer is added.
    """

    latency: float = quantity(
        0.0, "s", ge=0, le=10, help="Constant delay from the measurements of a control cycle until "
        "the commands computed from them take effect",
    )  # fmt: skip
    jitter: float = quantity(
        0.0, "s", ge=0, le=10, help="Maximum of an additional delay, uniform from 0 and new in "
        "each control cycle",
    )  # fmt: skip
    measured: bool = quantity(
        False, help="Whether the measured computing time of the onboard computer is added; the "
        "flight then cannot be repeated exactly",
    )  # fmt: skip


@dataclass(frozen=True)
class RecordSettings:
    """Optional content of the flight record.

    Attributes
    ----------
    measurements
        Whether all measurements except camera images are recorded.
    images
        Whether the images of all cameras are recorded.
    """

    measurements: bool = quantity(
        False, help="whether the flight record keeps all measurements except camera images"
    )
    images: bool = quantity(False, help="whether the flight record keeps the images of all cameras")


@dataclass(frozen=True)
class SimulationClock:
    """Time step, control cycle and time limit of the simulation.

    Attributes
    ----------
    step
        Time step of integration, IMU and attitude loop, s.
    cycle
        Control cycle, which is the period of the onboard computer, s.
    max_time
        Time limit of a flight, s.
    """

    step: float = quantity(
        0.01,
        "s",
        ge=1e-4,
        le=1,
        help="Time step of the integration, of the IMU and of the attitude control",
    )
    cycle: float = quantity(
        0.1, "s", gt=0, le=1, help="Period of the control cycle of the onboard computer"
    )
    max_time: float = quantity(
        300.0, "s", gt=0, le=1e5, help="Simulated time after which a flight is stopped"
    )

    def __post_init__(self) -> None:
        steps = self.cycle / self.step
        if steps < 1.0 or abs(steps - round(steps)) > 1e-6:
            raise InputError(
                "cycle", self.cycle, f"must be a multiple of step_s, which is {self.step:g} s"
            )
        if self.max_time / self.cycle > _MAX_CYCLES:
            raise InputError(
                "max_time", self.max_time,
                f"must be at most {_MAX_CYCLES * self.cycle:g}: {_MAX_CYCLES} control cycles "
                f"with cycle_s = {self.cycle:g}",
            )  # fmt: skip

    @property
    def steps(self) -> int:
        """Number of time steps per control cycle."""
        return round(self.cycle / self.step)
