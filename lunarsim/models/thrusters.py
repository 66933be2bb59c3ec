"""What the thrusters of a lander are: where they sit, along what they push, how short they fire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.lander import STANDARD_GRAVITY
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]
Points = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Thrusters:
    """On-off thrusters of one size, in four clusters of four unless a layout is given.

    The default is the lunar module's thrust for its mass (16 x 445 N on 7 to 15 t) on a lander of
    1.5 t. The clusters stand as on that module: 45 deg off the body's axes, each with one thruster
    that pushes up, one down, and two that push inward along body x and body y.

    Attributes
    ----------
    force
        Of each, N.
    specific_impulse
        s.
    propellant
        In tanks of their own, kg; the vehicle's dry mass counts it.
    minimum_on
        A valve that opens stays open so long, s.
    cluster_radius, cluster_height
        Of the four clusters from body z, and above the body's origin, m.
    positions, directions
        A layout of one's own (n, 3), body axes: where each sits (m) and along which it pushes.

    Raises
    ------
    InputError
        If positions and directions differ in number, a direction is no direction, or the layout
        cannot turn the lander both ways about every axis.
    """

    force: float = quantity(60.0, "N", gt=0, help="of each thruster")
    specific_impulse: float = quantity(290.0, "s", gt=0, help="of the thrusters")
    propellant: float = quantity(20.0, "kg", ge=0, help="of the thrusters, part of the dry mass")
    minimum_on: float = quantity(0.02, "s", gt=0, le=1, help="shortest time that a valve opens for")
    cluster_radius: float = quantity(1.6, "m", gt=0, help="of the four clusters from body z")
    cluster_height: float = quantity(0.0, "m", help="of the clusters above the body's origin")
    positions: Points = quantity((), "m", help="of each thruster; left out: four clusters of four")
    directions: Points = quantity((), help="along which each pushes; with positions")

    def __post_init__(self) -> None:
        check_bounds(self, "thrusters")
        if len(self.positions) != len(self.directions):
            raise InputError(
                "thrusters.directions", len(self.directions), f"{len(self.positions)}: one each"
            )
        for d in self.directions:
            if not np.linalg.norm(d) > 0.0:
                raise InputError("thrusters.directions", d, "a vector that is not zero")
        if not _turns_every_way(self.torques):
            raise InputError(
                "thrusters.positions",
                self.positions,
                "a layout that turns the lander both ways about every axis",
            )

    @property
    def layout(self) -> tuple[Array, Array]:
        """Where each thruster sits (n, 3), m, and along which unit vector it pushes (n, 3)."""
        if self.positions:
            d = np.asarray(self.directions, dtype=np.float64)
            unit = d / np.linalg.norm(d, axis=1, keepdims=True)
            return np.asarray(self.positions, dtype=np.float64), unit
        where, along = [], []
        for sx, sy in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)):
            arm = self.cluster_radius / np.sqrt(2.0)
            where += [(sx * arm, sy * arm, self.cluster_height)] * 4
            along += [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (-sx, 0.0, 0.0), (0.0, -sy, 0.0)]
        return np.array(where), np.array(along)

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.positions) or 16

    @property
    def forces(self) -> Array:
        """Force of each when open (n, 3), body axes, N."""
        return np.asarray(self.force * self.layout[1])

    @property
    def torques(self) -> Array:
        """Torque of each about the body's origin when open (n, 3), N m."""
        return np.asarray(np.cross(self.layout[0], self.forces))

    @property
    def flow(self) -> float:
        """Propellant that one burns, kg/s."""
        return self.force / (self.specific_impulse * STANDARD_GRAVITY)


def _turns_every_way(torques: Array) -> bool:
    """Tell whether non-negative shares of torques (n, 3) make any torque.

    They do if they span space and some strictly positive combination of them is zero.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  (loads slowly)

    scale = float(np.abs(torques).max(initial=0.0))
    if scale == 0.0 or np.linalg.matrix_rank(torques / scale, tol=1e-6) < 3:
        return False
    n = len(torques)
    found = linprog(np.ones(n), A_eq=torques.T / scale, b_eq=np.zeros(3), bounds=[(1.0, None)] * n)
    return bool(found.status == 0)
