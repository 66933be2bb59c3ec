"""Propellant-optimal thruster allocation by precomputed linear programs.

The minimum of the total thrust over non-negative thrusts f with B f = tau lies at a vertex of the
linear program: three thrusters form a basis. A basis is optimal for every torque in the cone of its
columns if no reduced cost is negative, independent of the torque. All such bases are found once;
the first one whose cone contains the torque is then used.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from lunarsim.models.thrusters import Thrusters
from lunarsim.typing import Array, IntArray
from lunarsim.value_checks import check_finite


class ThrusterAllocation:
    """Propellant-optimal distribution of a commanded torque to on-off thrusters.

    The optimal bases of the linear program are computed once for a thruster layout. Thrusters with
    equal torques form a group: they share a long firing, and one of them performs a short one.

    Parameters
    ----------
    thrusters
        Thruster layout.
    excluded
        Indices of thrusters that must not be used.

    Attributes
    ----------
    authority
        Maximum sustained torque about each single axis (3,), N m, the smaller of both directions of
        rotation.
    min_impulse
        Angular impulse of the shortest pulses about each single axis (3,), N m s, the larger of
        both directions of rotation.
    """

    def __init__(self, thrusters: Thrusters, excluded: Sequence[int] = ()) -> None:
        self.thrusters = thrusters
        torques = thrusters.torques
        scale = float(np.abs(torques).max())
        used = np.setdiff1d(np.arange(len(torques)), np.asarray(excluded, dtype=np.int64))
        _, first, group = np.unique(
            np.round(torques[used] / scale, 9), axis=0, return_index=True, return_inverse=True
        )
        self._groups = [used[group.ravel() == g] for g in range(len(first))]
        self._columns = torques[used[first]] / thrusters.force  # per newton, (groups, 3)
        self._sizes = np.array([len(g) for g in self._groups])
        self._bases, self._inverses = self._find_optimal_bases()
        self._alternation = 0
        if len(self._bases) == 0:
            self.authority = self.min_impulse = np.zeros(3)
            return
        both = np.array([[self._limits(s * axis) for axis in np.eye(3)] for s in (1.0, -1.0)])
        self.authority = both[:, :, 0].min(axis=0)
        self.min_impulse = both[:, :, 1].max(axis=0)

    @property
    def spans_all_torques(self) -> bool:
        """Whether the usable thrusters can produce a torque in every direction."""
        if len(self._bases) == 0:
            return False
        axes = np.vstack((np.eye(3), -np.eye(3)))
        made = [self._columns.T @ self.group_thrust(axis) for axis in axes]
        return bool(np.allclose(made, axes, atol=1e-6))

    def _find_optimal_bases(self) -> tuple[IntArray, Array]:
        """Return the optimal bases of the linear program, and their inverses.

        Each basis is the indices of three thruster groups (n, 3). Its inverse (n, 3, 3) converts a
        torque, N m, to the thrusts of these groups, N.
        """
        bases, inverses = [], []
        for chosen in combinations(range(len(self._columns)), 3):
            basis = self._columns[list(chosen)].T
            if abs(np.linalg.det(basis)) < 1e-9:
                continue
            inverse = np.linalg.inv(basis)
            dual_prices = np.ones(3) @ inverse
            if np.all(1.0 - self._columns @ dual_prices > -1e-9):
                bases.append(chosen)
                inverses.append(inverse)
        return np.array(bases, dtype=np.int64), np.array(inverses)

    def _limits(self, axis: Array) -> tuple[float, float]:
        """Return maximum torque (N m) and minimum impulse (N m s) about a unit vector."""
        thrust_per_torque = self.group_thrust(axis)
        used = thrust_per_torque > 1e-12
        if not used.any():
            return 0.0, 0.0
        most = float(np.min(self._sizes[used] * self.thrusters.force / thrust_per_torque[used]))
        least = float(
            self.thrusters.min_on_time * self.thrusters.force / thrust_per_torque[used].min()
        )
        return most, least

    def group_thrust(self, torque: Array) -> Array:
        """Return the minimum-propellant thrust of each thruster group for a torque (3,).

        The torque is in N m; the thrusts (groups,) are in N. Their sum is minimal. The maximum
        thrust of a group is not taken into account.

        Raises
        ------
        InputError
            If the torque is not finite.
        """
        check_finite("control.torque", torque)
        thrust = self._inverses @ torque
        # First basis whose cone holds the torque; rounding may leave small negative thrusts.
        best = int(np.argmax(thrust.min(axis=1) >= -1e-9 * max(1.0, float(np.abs(torque).max()))))
        out = np.zeros(len(self._columns))
        out[self._bases[best]] = np.maximum(thrust[best], 0.0)
        return out

    def on_times(self, torque: Array, period: float) -> Array:
        """Return the on-time of each thruster in one control period (n,), s.

        A torque beyond the control authority is scaled down without a change of direction. On-times
        below half of the minimum on-time are omitted; other on-times below the minimum are raised
        to it.

        Parameters
        ----------
        torque
            Mean torque over the period (3,), N m.
        period
            Duration of the period, s.
        """
        force, least = self.thrusters.force, self.thrusters.min_on_time
        thrust = self.group_thrust(torque)
        overload = float((thrust / (self._sizes * force)).max(initial=0.0))
        total = thrust / max(overload, 1.0) / force * period
        out = np.zeros(self.thrusters.count)
        self._alternation += 1
        for jets, seconds in zip(self._groups, total, strict=True):
            if seconds < 0.5 * least:
                continue
            if seconds >= len(jets) * least:
                out[jets] = seconds / len(jets)
            else:  # alternate, so that the thrusters of a group wear equally
                out[jets[self._alternation % len(jets)]] = max(seconds, least)
        return np.minimum(out, period)

    def impulse(self, on_times: Array) -> Array:
        """Return the angular impulse (3,), N m s, of thruster on-times (n,), s."""
        return np.asarray(on_times @ self.thrusters.torques)
