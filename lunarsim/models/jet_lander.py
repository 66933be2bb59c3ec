"""A lander that is turned by thrusters and pushed by an engine that obeys within limits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.models.slosh import Slosh
from lunarsim.models.thrusters import Thrusters
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Engine:
    """How the descent engine is hung and throttled; its range and lag are the vehicle's.

    Attributes
    ----------
    pivot_depth
        Of the gimbal's pivot below the body's origin, m.
    gimbal_limit, gimbal_rate
        Greatest swing about body x and body y, rad, and its speed, rad/s; no swing with 0.
    throttle_step
        Thrust comes in whole steps of this, N; 0: smoothly.
    dead_band
        A new command that differs by less leaves the throttle alone, N.
    gap_from, gap_to
        Between these the engine must not run, N: it runs in the range below or at `gap_to` alone;
        0 and 0: no gap.
    """

    pivot_depth: float = quantity(0.8, "m", ge=0, help="of the gimbal below the body's origin")
    gimbal_limit: float = quantity(6.0, "deg", ge=0, lt=45, help="of the swing about each axis")
    gimbal_rate: float = quantity(2.0, "deg/s", ge=0, help="of the swing")
    throttle_step: float = quantity(0.0, "N", ge=0, help="whole steps of thrust; 0: smooth")
    dead_band: float = quantity(0.0, "N", ge=0, help="smaller changes leave the throttle alone")
    gap_from: float = quantity(0.0, "N", ge=0, help="above it only at gap_to; 0: no gap")
    gap_to: float = quantity(0.0, "N", ge=0, help="fixed throttle point above the gap; 0: no gap")

    def __post_init__(self) -> None:
        check_bounds(self, "engine")
        if (self.gap_from > 0.0 or self.gap_to > 0.0) and not 0.0 < self.gap_from < self.gap_to:
            raise InputError("engine.gap_to", self.gap_to, f"more than gap_from, {self.gap_from}")

    @property
    def has_gap(self) -> bool:
        """Whether part of the throttle range is forbidden."""
        return self.gap_to > 0.0


@dataclass(frozen=True)
class JetLander(Lander):
    """A lander with on-off thrusters, a gimballed engine and a centre of mass that moves.

    The body's origin is where pads, thrusters and pivot are counted from: the centre of mass of
    the empty lander, or where `com_dry` says that it is not.

    Attributes
    ----------
    thrusters, engine
        Their figures.
    com_dry, com_full
        Centre of mass with tanks empty and full (3,), body axes, m; linear in the propellant left.
    slosh
        Tanks in which the propellant swings.
    torque_max
        What the thrusters give about each axis alone (3,), N m: follows from their layout.
    """

    thrusters: Thrusters = quantity(Thrusters(), help="thrusters that turn it")
    engine: Engine = quantity(Engine(), help="how the engine is hung and throttled")
    com_dry: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", help="centre of mass, tanks empty, from the body's origin"
    )
    com_full: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", help="centre of mass, tanks full, from the body's origin"
    )
    slosh: Slosh = quantity(Slosh(), help="tanks in which the propellant swings")
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
                f"less than the dry mass of {self.dry_mass} kg, which counts it",
            )  # fmt: skip
        gap = self.engine
        if gap.has_gap and not self.thrust_min < gap.gap_from < gap.gap_to <= self.thrust_max:
            raise InputError(
                "vehicle.engine.gap_to_n", gap.gap_to,
                f"a gap within the throttle range of {self.thrust_min} to {self.thrust_max} N",
            )  # fmt: skip
        for name in ("com_dry", "com_full"):
            self._check_com(f"vehicle.{name}_m", getattr(self, name))
        for fill in np.linspace(0.02, 1.0, 50) if self.slosh.tanks else ():
            self._check_slosh(float(fill))

    def _check_com(self, field: str, com: tuple[float, float, float]) -> None:
        """Refuse a centre of mass about which the engine turns the lander whatever is done."""
        engine = self.engine
        arm = engine.pivot_depth + com[2]
        if engine.gimbal_limit > 0.0 and arm < 0.0:
            raise InputError(
                field, com, f"above the engine's pivot, which is at {-engine.pivot_depth} m"
            )
        # About body x the centre's north counts, about y its east.
        swung = abs(arm) * np.tan(engine.gimbal_limit)
        for aside, torque in ((com[1], self.torque_max[0]), (com[0], self.torque_max[1])):
            most = swung + torque / self.thrust_min if self.thrust_min > 0.0 else np.inf
            if abs(aside) > most:
                raise InputError(
                    field, com,
                    f"within {most:.3g} m of the engine's line on that side: neither gimbal nor "
                    "thrusters hold what lies beyond, even at the least thrust",
                )  # fmt: skip

    def _check_slosh(self, fill: float) -> None:
        """Refuse tanks whose swinging liquid is more than the lander has there."""
        mass = self.dry_mass + fill * self.propellant_mass
        swinging, _, bobs = self.slosh.pendulums(fill, self.propellant_mass)
        com = self.com(mass)
        points = bobs - com
        rest = mass - swinging.sum()
        middle = -(swinging @ points) / rest
        whole = np.diag(self.inertia(mass))
        still = whole - sum(
            (
                m * (p @ p * np.eye(3) - np.outer(p, p))
                for m, p in zip(swinging, points, strict=True)
            ),
            rest * (middle @ middle * np.eye(3) - np.outer(middle, middle)),
        )
        least = float(np.linalg.eigvalsh(still)[0])
        if not least > 0.0:
            raise InputError(
                "vehicle.slosh.tanks_m", self.slosh.tanks,
                f"tanks nearer to the centre of mass {tuple(float(v) for v in com)} m: with "
                f"{100.0 * fill:.0f} % of the propellant the liquid that swings in them has more "
                "moment of inertia than the lander",
            )  # fmt: skip

    def com(self, mass: float) -> Array:
        """Return the centre of mass at a mass (kg), body axes (3,), m."""
        full = (mass - self.dry_mass) / self.propellant_mass
        dry, wet = np.asarray(self.com_dry), np.asarray(self.com_full)
        return np.asarray(dry + full * (wet - dry))


def com_of(lander: Lander, mass: float) -> Array:
    """Return where the centre of mass of any lander is, from the body's origin (3,), m."""
    return lander.com(mass) if isinstance(lander, JetLander) else np.zeros(3)
