"""Thruster layout of a lander: positions, directions and minimum on-time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.models.lander import STANDARD_GRAVITY
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array

Points = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Thrusters:
    """Settings of identical on-off thrusters.

    The layout is four clusters of four thrusters, or custom.

    The default has the thrust-to-mass ratio of the lunar module (16 x 445 N on 7 to 15 t), scaled
    to a lander of 1.5 t. As on that module, the clusters lie 45 deg off the body axes. In each, one
    thruster pushes up, one down, and two push inward along body x and body y.

    Attributes
    ----------
    force
        Force of each thruster, N.
    specific_impulse
        Specific impulse of the thrusters, s.
    propellant
        Propellant in separate tanks, kg; included in the vehicle's dry mass.
    min_on_time
        Minimum on-time of a valve, s.
    cluster_radius, cluster_height
        Distance of the clusters from body z, and height above the body's origin, m.
    positions, directions
        Custom layout (n, 3), body axes: position (m) and force direction of each thruster.

    Raises
    ------
    InputError
        If positions and directions differ in number, a direction is zero, or the layout cannot
        turn the lander in both directions about every axis.
    """

    force: float = quantity(60.0, "N", gt=0, help="force of each thruster")
    specific_impulse: float = quantity(290.0, "s", gt=0, help="specific impulse of the thrusters")
    propellant: float = quantity(
        20.0, "kg", ge=0, help="propellant of the thrusters; dry_mass_kg includes it"
    )
    min_on_time: float = quantity(0.02, "s", gt=0, le=1, help="minimum firing time of a thruster")
    cluster_radius: float = quantity(
        1.6, "m", gt=0, help="distance of the thruster clusters from the body z axis"
    )
    cluster_height: float = quantity(
        0.0, "m", help="height of the thruster clusters above the body's origin"
    )
    positions: Points = quantity(
        (),
        "m",
        help="position of each thruster (body axes); omitted or []: four "
        "clusters of four thrusters",
    )
    directions: Points = quantity(
        (),
        help="direction of the force of each thruster (body axes); required if positions_m is "
        "given",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "thrusters")
        if len(self.positions) != len(self.directions):
            raise InputError(
                "thrusters.directions", len(self.directions),
                f"must have as many vectors as positions_m ({len(self.positions)})",
            )  # fmt: skip
        for i, d in enumerate(self.directions):
            if not np.linalg.norm(d) > 0.0:
                raise InputError(f"thrusters.directions[{i}]", d, "must not be a zero vector")
        if not _spans_all_torques(self.torques):
            raise InputError(
                "thrusters.positions",
                self.positions,
                "must allow torques in both directions about every body axis",
                "Add thrusters, or change positions and directions.",
                show_value=False,
            )

    @property
    def layout(self) -> tuple[Array, Array]:
        """Positions (n, 3), m, and unit force vectors (n, 3), of all thrusters, body axes."""
        if self.positions:
            d = np.asarray(self.directions, dtype=np.float64)
            unit = d / np.linalg.norm(d, axis=1, keepdims=True)
            return np.asarray(self.positions, dtype=np.float64), unit
        positions, directions = [], []
        for sx, sy in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)):
            arm = self.cluster_radius / np.sqrt(2.0)
            positions += [(sx * arm, sy * arm, self.cluster_height)] * 4
            directions += [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (-sx, 0.0, 0.0), (0.0, -sy, 0.0)]
        return np.array(positions), np.array(directions)

    @property
    def count(self) -> int:
        """Number of thrusters."""
        return len(self.positions) or 16

    @property
    def forces(self) -> Array:
        """Force of each open thruster (n, 3), body axes, N."""
        return np.asarray(self.force * self.layout[1])

    @property
    def torques(self) -> Array:
        """Torque (n, 3), N m, of each open thruster about the body's origin."""
        return np.asarray(np.cross(self.layout[0], self.forces))

    @property
    def propellant_flow(self) -> float:
        """Propellant flow of one open thruster, kg/s."""
        return self.force / (self.specific_impulse * STANDARD_GRAVITY)


def _spans_all_torques(torques: Array) -> bool:
    """Return whether non-negative combinations of torques (n, 3) give every torque.

    This holds if the torques span space and a strictly positive combination of them is zero.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  (loads slowly)

    scale = float(np.abs(torques).max(initial=0.0))
    if scale == 0.0 or np.linalg.matrix_rank(torques / scale, tol=1e-6) < 3:
        return False
    n = len(torques)
    found = linprog(np.ones(n), A_eq=torques.T / scale, b_eq=np.zeros(3), bounds=[(1.0, None)] * n)
    return bool(found.status == 0)
