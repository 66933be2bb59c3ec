"""Propellant slosh, modelled by one pendulum per tank.

Small waves of the first lateral mode in an upright cylinder with a flat floor act like a pendulum
plus a mass at rest (Abramson, NASA SP-106, 1966, chapter 6; Dodge, The New Dynamic Behavior of
Liquids in Moving Containers, 2000, chapter 3). With e = 1.8412, the first zero of J1', a tank of
radius R filled to height h has a pendulum with
    fraction of liquid    2 R tanh(e h / R) / (e (e^2 - 1) h)
    length                R / (e tanh(e h / R))
    bob above the floor   h - 2 R tanh(e h / 2 R) / e
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array

Points = tuple[tuple[float, float, float], ...]

FIRST_MODE = 1.841183781340659  # first zero of the derivative of J1
# Fill fraction below which slosh is neglected.
MIN_FILL = 1e-3


@dataclass(frozen=True)
class Slosh:
    """Settings of upright cylindrical tanks with sloshing propellant.

    Attributes
    ----------
    tanks
        Centre of each tank's floor (n, 3), body axes, m; empty: no slosh.
    propellant_fractions
        Fraction of the propellant in each tank (n,); omitted: equal fractions.
    radius
        Radius of each tank, m.
    height
        Height of the liquid in a full tank, m; it is proportional to the remaining propellant.
    damping
        Damping ratio. A smooth wall gives about 0.001 to 0.01, baffles give more (NASA SP-106,
        chapter 4).

    Raises
    ------
    InputError
        If fractions and tanks differ in number, or the fractions do not add up to 1.
    """

    tanks: Points = quantity(
        (),
        "m",
        help="centre of each tank's floor, relative to the body's origin (body axes); omitted: no "
        "slosh",
    )
    propellant_fractions: tuple[float, ...] = quantity(
        (), ge=0, le=1, help="fraction of the propellant in each tank; omitted: equal fractions"
    )
    radius: float = quantity(0.3, "m", gt=0, help="radius of each tank")
    height: float = quantity(0.3, "m", gt=0, help="height of the liquid in full tanks")
    damping: float = quantity(0.005, ge=0, lt=1, help="damping ratio of the slosh mode")

    def __post_init__(self) -> None:
        check_bounds(self, "slosh")
        for place in self.tanks:
            if np.shape(place) != (3,) or not np.all(np.isfinite(place)):
                raise InputError(
                    "slosh.tanks", place, "must have three finite numbers (x, y, z) per tank"
                )
        if self.propellant_fractions and len(self.propellant_fractions) != len(self.tanks):
            raise InputError(
                "slosh.propellant_fractions",
                len(self.propellant_fractions),
                f"must have as many values as tanks_m ({len(self.tanks)})",
            )
        if self.propellant_fractions and abs(sum(self.propellant_fractions) - 1.0) > 1e-6:
            raise InputError(
                "slosh.propellant_fractions", self.propellant_fractions, "must add up to 1"
            )

    def table(self, propellant: float) -> Array:
        """Return the tanks as an array (n, 7) for the compiled equations of motion.

        The columns are floor centre (3), m; radius, m; full liquid mass, kg; full liquid height, m;
        damping ratio. `propellant` is the propellant mass in full tanks, kg.
        """
        n = len(self.tanks)
        shares = (
            np.array(self.propellant_fractions)
            if self.propellant_fractions
            else np.full(n, 1.0 / max(n, 1))
        )
        rest = np.tile([self.radius, 0.0, self.height, self.damping], (n, 1))
        rest[:, 1] = shares * propellant
        return np.ascontiguousarray(np.hstack((np.reshape(self.tanks, (n, 3)), rest)))

    def pendulums(self, fill: float, propellant: float) -> tuple[Array, Array, Array]:
        """Return the equivalent pendulum of each tank: mass, length, bob at rest.

        Parameters
        ----------
        fill
            Remaining fraction of the propellant, positive.
        propellant
            Propellant mass in full tanks, kg.

        Returns
        -------
        masses, lengths, bobs
            Masses (n,), kg, lengths (n,), m, and positions of the bobs at rest (n, 3), body axes,
            m.
        """
        rows = self.table(propellant)
        depth = fill * self.height / self.radius
        steep = np.tanh(FIRST_MODE * depth)
        share = 2.0 * steep / (FIRST_MODE * (FIRST_MODE**2 - 1.0) * depth)
        bobs = rows[:, :3].copy()
        bobs[:, 2] += self.radius * (depth - 2.0 * np.tanh(0.5 * FIRST_MODE * depth) / FIRST_MODE)
        length = np.full(len(rows), self.radius / (FIRST_MODE * steep))
        return share * fill * rows[:, 4], length, bobs
