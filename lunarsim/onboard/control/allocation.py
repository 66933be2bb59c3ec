"""Which thrusters make a torque at the least propellant: a linear programme solved beforehand.

Of all non-negative thrusts f with B f = tau the least sum is a corner of the programme: three
thrusters, one basis. A basis is the best one for every torque in the cone of its columns if no
other column costs less (its reduced costs are not negative), whatever the torque. All such bases
are found once; a torque is then served by the first whose cone holds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.thrusters import Thrusters

Array = NDArray[np.float64]


class Allocation:
    """Thrusters of a layout, and the bases that serve torques.

    Thrusters whose torques are the same form a group: they share a long firing, and one of them
    does a short one.

    Parameters
    ----------
    thrusters
        The layout.
    without
        Numbers of thrusters that are not to be used.

    Attributes
    ----------
    authority
        Torque about each axis alone that can be held (3,), N m, the lesser of both senses.
    least_impulse
        Angular impulse about each axis alone of the shortest pulses (3,), N m s, the greater of
        both senses.
    """

    def __init__(self, thrusters: Thrusters, without: Sequence[int] = ()) -> None:
        self.thrusters = thrusters
        torques = thrusters.torques
        scale = float(np.abs(torques).max())
        used = np.setdiff1d(np.arange(len(torques)), np.asarray(without, dtype=np.int64))
        _, first, group = np.unique(
            np.round(torques[used] / scale, 9), axis=0, return_index=True, return_inverse=True
        )
        self._groups = [used[group.ravel() == g] for g in range(len(first))]
        self._columns = torques[used[first]] / thrusters.force  # per newton, (groups, 3)
        self._sizes = np.array([len(g) for g in self._groups])
        self._bases, self._inverses = self._best_bases()
        self._turn = 0
        if len(self._bases) == 0:
            self.authority = self.least_impulse = np.zeros(3)
            return
        both = np.array([[self._limits(s * axis) for axis in np.eye(3)] for s in (1.0, -1.0)])
        self.authority = both[:, :, 0].min(axis=0)
        self.least_impulse = both[:, :, 1].max(axis=0)

    @property
    def complete(self) -> bool:
        """Whether every torque can be made."""
        if len(self._bases) == 0:
            return False
        axes = np.vstack((np.eye(3), -np.eye(3)))
        made = [self._columns.T @ self.group_thrust(axis) for axis in axes]
        return bool(np.allclose(made, axes, atol=1e-6))

    def _best_bases(self) -> tuple[NDArray[np.int64], Array]:
        bases, inverses = [], []
        for chosen in combinations(range(len(self._columns)), 3):
            basis = self._columns[list(chosen)].T
            if abs(np.linalg.det(basis)) < 1e-9:
                continue
            inverse = np.linalg.inv(basis)
            price = np.ones(3) @ inverse
            if np.all(1.0 - self._columns @ price > -1e-9):
                bases.append(chosen)
                inverses.append(inverse)
        return np.array(bases, dtype=np.int64), np.array(inverses)

    def _limits(self, axis: Array) -> tuple[float, float]:
        """Return greatest torque and least impulse along a unit vector."""
        share = self.group_thrust(axis)
        used = share > 1e-12
        if not used.any():
            return 0.0, 0.0
        most = float(np.min(self._sizes[used] * self.thrusters.force / share[used]))
        least = float(self.thrusters.minimum_on * self.thrusters.force / share[used].min())
        return most, least

    def group_thrust(self, torque: Array) -> Array:
        """Return the thrust of each group (groups,), N, that makes a torque (3,), N m.

        The least sum of thrusts; no group's limit is kept yet.

        Raises
        ------
        InputError
            If the torque is not finite.
        """
        if not np.isfinite(torque).all():
            raise InputError("control.torque", np.asarray(torque).tolist(), "a finite torque")
        thrust = self._inverses @ torque
        # The first basis that serves; rounding may leave a share a little below zero.
        best = int(np.argmax(thrust.min(axis=1) >= -1e-9 * max(1.0, float(np.abs(torque).max()))))
        out = np.zeros(len(self._columns))
        out[self._bases[best]] = np.maximum(thrust[best], 0.0)
        return out

    def on_times(self, torque: Array, period: float) -> Array:
        """Return for how long each thruster is to fire in a period (n,), s.

        A torque beyond what the thrusters can hold is made less, its direction kept. What is under
        half of the least on-time is left out, what is under the least one raised to it.

        Parameters
        ----------
        torque
            Mean over the period (3,), N m.
        period
            s.
        """
        force, least = self.thrusters.force, self.thrusters.minimum_on
        thrust = self.group_thrust(torque)
        over = float((thrust / (self._sizes * force)).max(initial=0.0))
        total = thrust / max(over, 1.0) / force * period
        out = np.zeros(self.thrusters.count)
        self._turn += 1
        for jets, seconds in zip(self._groups, total, strict=True):
            if seconds < 0.5 * least:
                continue
            if seconds >= len(jets) * least:
                out[jets] = seconds / len(jets)
            else:  # turn about, so that no thruster of a group is used up alone
                out[jets[self._turn % len(jets)]] = max(seconds, least)
        return np.minimum(out, period)

    def impulse(self, on_times: Array) -> Array:
        """Return the angular impulse (3,), N m s, of on-times (n,), s."""
        return np.asarray(on_times @ self.thrusters.torques)
