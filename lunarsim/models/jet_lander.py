"""Lander with on-off thrusters and a gimballed engine with throttle limits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.models.slosh import Slosh
from lunarsim.models.thrusters import Thrusters
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class DescentEngine:
    """Geometry, gimbal and throttle of the descent engine.

    The thrust range and the lag of the engine are fields of `Lander`.

    Attributes
    ----------
    pivot_depth
        Depth of the gimbal's pivot below the body's origin, m.
    gimbal_limit, gimbal_rate
        Maximum gimbal angle about body x and body y, rad, and its rate, rad/s; limit 0: no gimbal.
    throttle_step
        Quantization step of thrust, N; 0: continuous.
    dead_band
        Minimum change of the command that moves the throttle, N.
    gap_lower, gap_upper
        Forbidden throttle interval, N: the engine runs at up to `gap_lower` or exactly at
        `gap_upper`; 0 and 0: no gap.
    continuous_min
        Minimum thrust at which the engine runs continuously, N. For smaller commands it runs in
        pulses of this thrust; at the maximum thrust the engine can only be on or off. 0: no pulses.
    pulse_period, min_pulse
        Time between two pulses, and minimum time on or off within it, s.
    """

    pivot_depth: float = quantity(
        0.8, "m", ge=0, help="depth of the gimbal pivot below the body's origin"
    )
    gimbal_limit: float = quantity(
        6.0,
        "deg",
        ge=0,
        lt=45,
        help="maximum gimbal angle of the engine about body x and about body y; 0: no gimbal",
    )
    gimbal_rate: float = quantity(
        2.0, "deg/s", ge=0, help="maximum angular rate of the engine's gimbal"
    )
    throttle_step: float = quantity(
        0.0, "N", ge=0, help="quantization step of the thrust; 0: continuous"
    )
    dead_band: float = quantity(
        0.0,
        "N",
        ge=0,
        help="minimum change of the commanded thrust to which the throttle responds; 0: every "
        "change",
    )
    gap_lower: float = quantity(
        0.0,
        "N",
        ge=0,
        help="lower end of the thrust range in which the engine cannot run; 0: no such range",
    )
    gap_upper: float = quantity(
        0.0,
        "N",
        ge=0,
        help="upper end of the thrust range in which the engine cannot run. The engine runs up to "
        "gap_lower_n or at exactly gap_upper_n; 0: no such range",
    )
    continuous_min: float = quantity(
        0.0,
        "N",
        ge=0,
        help="minimum thrust at which the engine runs continuously; for smaller commands it runs "
        "in pulses of this thrust. With thrust_max_n, the engine is on or off; 0: no pulses",
    )
    pulse_period: float = quantity(
        0.1,
        "s",
        gt=0,
        le=5,
        help="time between two pulses of an engine that runs in "
        "pulses, rounded up to a multiple of the time step (simulation.step_s)",
    )
    min_pulse: float = quantity(
        0.0,
        "s",
        ge=0,
        help="minimum time on, and off, of a pulse. Shorter times are added to the next pulse",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "engine")
        if self.continuous_min > 0.0 and self.gap_upper > 0.0:
            raise InputError(
                "engine.continuous_min", self.continuous_min,
                "must be 0 for an engine with a gap in its thrust range (gap_upper_n)",
            )  # fmt: skip
        if self.min_pulse > 0.5 * self.pulse_period:
            raise InputError(
                "engine.min_pulse", self.min_pulse,
                f"must be at most half of pulse_period_s ({self.pulse_period:g})",
            )  # fmt: skip
        if self.gap_lower > 0.0 and not self.gap_lower < self.gap_upper:
            raise InputError(
                "engine.gap_upper", self.gap_upper,
                f"must be more than the lower limit of the gap, {self.gap_lower:g} N",
            )  # fmt: skip
        if self.gap_upper > 0.0 and not self.gap_lower > 0.0:
            raise InputError(
                "engine.gap_lower", self.gap_lower,
                f"must be positive, because the upper limit of the gap is {self.gap_upper:g} N",
            )  # fmt: skip

    @property
    def has_gap(self) -> bool:
        """Whether part of the throttle range is forbidden."""
        return self.gap_upper > 0.0


@dataclass(frozen=True)
class JetLander(Lander):
    """Lander with on-off thrusters, a gimballed engine and a moving centre of mass.

    Positions of pads, thrusters and pivot are relative to the body's origin: the centre of mass of
    the empty lander, unless `com_dry` places it elsewhere.

    Attributes
    ----------
    thrusters, engine
        Parameters of the thrusters and of the engine.
    com_dry, com_full
        Centre of mass with tanks empty and full (3,), body axes, m; linear in propellant mass.
    slosh
        Tanks with sloshing propellant.
    torque_max
        Maximum thruster torque about each single axis (3,), N m; computed from the layout.
    """

    thrusters: Thrusters = quantity(Thrusters(), help="thrusters for attitude control")
    engine: DescentEngine = quantity(
        DescentEngine(), help="geometry, gimbal and throttle of the engine"
    )
    com_dry: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0),
        "m",
        help="centre of mass with empty tanks, relative to the body's origin, which is "
        "com_height_m above the landing pads (body axes)",
    )
    com_full: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0),
        "m",
        help="centre of mass with full tanks, relative to the body's origin (body axes)",
    )
    slosh: Slosh = quantity(Slosh(), help="tanks with sloshing propellant")
    torque_max: tuple[float, float, float] = field(init=False, default=(0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        torques = self.thrusters.torques
        both = np.stack(
            (np.maximum(torques, 0.0).sum(axis=0), np.maximum(-torques, 0.0).sum(axis=0))
        )
        least = tuple(float(v) for v in both.min(axis=0))
        object.__setattr__(self, "torque_max", least)
        super().__post_init__()
        if self.thrusters.propellant >= self.dry_mass:
            raise InputError(
                "vehicle.thrusters.propellant_kg", self.thrusters.propellant,
                f"must be less than vehicle.dry_mass_kg, which is {self.dry_mass:g} kg and "
                "includes this propellant",
            )  # fmt: skip
        gap = self.engine
        if gap.has_gap and not self.thrust_min < gap.gap_lower:
            raise InputError(
                "vehicle.engine.gap_lower_n", gap.gap_lower,
                f"must be more than vehicle.thrust_min_n, which is {self.thrust_min:g} N",
            )  # fmt: skip
        if gap.has_gap and not gap.gap_upper <= self.thrust_max:
            raise InputError(
                "vehicle.engine.gap_upper_n", gap.gap_upper,
                f"must be at most vehicle.thrust_max_n, which is {self.thrust_max:g} N",
            )  # fmt: skip
        if gap.continuous_min and not self.thrust_min < gap.continuous_min <= self.thrust_max:
            raise InputError(
                "vehicle.engine.continuous_min_n", gap.continuous_min,
                f"must be 0, or more than vehicle.thrust_min_n ({self.thrust_min:g} N) and at most "
                f"vehicle.thrust_max_n ({self.thrust_max:g} N)",
            )  # fmt: skip
        for name in ("com_dry", "com_full"):
            self._check_com(f"vehicle.{name}_m", getattr(self, name))
        for fill in np.linspace(0.02, 1.0, 50) if self.slosh.tanks else ():
            self._check_slosh(float(fill))

    def _check_com(self, field: str, com: tuple[float, float, float]) -> None:
        """Raise InputError if the engine torque cannot be balanced for a centre of mass.

        Gimbal and thrusters balance it. `com` is in body axes, m; `field` names it in the error.
        """
        engine = self.engine
        arm = engine.pivot_depth + com[2]
        if engine.gimbal_limit > 0.0 and arm < 0.0:
            raise InputError(
                f"{field}[2]",
                com[2],
                f"must be {-engine.pivot_depth:g} m or more, because the engine's pivot is at that "
                "height",
            )
        # An offset along y causes torque about body x, and one along x causes torque about body y.
        gimbal_authority = abs(arm) * np.tan(engine.gimbal_limit)
        for i, torque in ((1, self.torque_max[0]), (0, self.torque_max[1])):
            limit = gimbal_authority + torque / self.thrust_min if self.thrust_min > 0.0 else np.inf
            if abs(com[i]) > limit:
                shown = np.floor(limit * 1e4) / 1e4  # rounded inwards
                raise InputError(
                    f"{field}[{i}]", com[i], f"must be between {-shown:g} and {shown:g} m",
                    "Farther from the engine's axis, gimbal and thrusters cannot balance the "
                    "minimum thrust.",
                )  # fmt: skip

    def _check_slosh(self, fill: float) -> None:
        """Raise InputError if the sloshing liquid has more inertia than the lander.

        `fill` is the remaining fraction of the propellant.
        """
        mass = self.dry_mass + fill * self.propellant_mass
        swinging, _, bobs = self.slosh.pendulums(fill, self.propellant_mass)
        com = self.com(mass)
        points = bobs - com
        rest = mass - swinging.sum()
        middle = -(swinging @ points) / rest
        total = np.diag(self.inertia(mass))
        remaining = total - sum(
            (
                m * (p @ p * np.eye(3) - np.outer(p, p))
                for m, p in zip(swinging, points, strict=True)
            ),
            rest * (middle @ middle * np.eye(3) - np.outer(middle, middle)),
        )
        least = float(np.linalg.eigvalsh(remaining)[0])
        if not least > 0.0:
            raise InputError(
                "vehicle.slosh.tanks_m", self.slosh.tanks,
                "must be nearer to the centre of mass, which is at "
                f"({', '.join(f'{v:.3g}' for v in com)}) m",
                f"At {100.0 * fill:.0f} % propellant the sloshing liquid has more inertia than "
                "the lander.", show_value=False,
            )  # fmt: skip

    def com(self, mass: float) -> Array:
        """Return the centre of mass (3,), body axes, m, for a total mass (kg).

        The centre moves linearly with the remaining propellant.
        """
        full = (mass - self.dry_mass) / self.propellant_mass
        dry, wet = np.asarray(self.com_dry), np.asarray(self.com_full)
        return np.asarray(dry + full * (wet - dry))
