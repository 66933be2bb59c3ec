"""Rotation time of a lander, and the times-to-go that it needs for diverts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.core.path_cost import initial_accelerations
from lunarsim.frames import quat_to_matrix
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.allocation import ThrusterAllocation
from lunarsim.onboard.control.phase_plane import PhasePlane
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array

# The phase-plane law brakes rotations with half of the authority (`PhasePlane.rate_change`).
_PHASE_PLANE_SHARE = 0.5


def tilt_torque(lander: Lander) -> float:
    """Return the maximum torque about the weakest horizontal body axis, N m.

    Thrusters in four clusters on the diagonals have 0.71 times the torque about a diagonal that
    they have about body x, because two clusters lie on this axis. Torques of other landers are
    limited about each body axis.
    """
    if not isinstance(lander, JetLander):
        return float(min(lander.torque_max[:2]))
    allocation, angles = ThrusterAllocation(lander.thrusters), np.linspace(0.0, 2.0 * np.pi, 17)
    # A torque beyond the authority is scaled down along its direction.
    large = 1e3 * float(np.abs(lander.thrusters.torques).sum())
    axes = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(17)))
    return min(float(allocation.impulse(allocation.on_times(large * a, 1.0)) @ a) for a in axes)


def delay_margin(k_r: float, k_v: float) -> float:
    """Return the delay (s) at which the loop ``a = -k_r x - k_v v`` is unstable.

    `k_r` is in 1/s^2 and `k_v` in 1/s. The loop gain is 1 at the frequency w with ``w^4 = k_r^2 +
    k_v^2 w^2``; the phase margin there is ``atan(k_v w / k_r)``, and the delay margin is phase over
    frequency.
    """
    w = np.sqrt(0.5 * (k_v**2 + np.sqrt(k_v**4 + 4.0 * k_r**2)))
    return float(np.arctan2(k_v * w, k_r) / w)


def guidance_delay_margin(shape: PathShape) -> float:
    """Return the delay over the time-to-go at which guidance becomes unstable.

    A law with the powers p and q of time-to-go T feeds back ``a = -k_r x / T^2 - k_v v / T`` with
    ``k_r = (p + 2) (q + 2)`` and ``k_v = p + q + 3`` (Lu 2020). At constant T, its delay margin is
    0.20 T for the Apollo law and 0.29 T for E-guidance.
    """
    return delay_margin((shape.low + 2.0) * (shape.high + 2.0), shape.low + shape.high + 3.0)


def path_shape(law: Any) -> PathShape:
    """Return the shape of a guidance law's paths; Apollo's for a law without one."""
    shape = getattr(law, "shape", None)
    return shape if isinstance(shape, PathShape) else APOLLO


@dataclass(frozen=True)
class RotationLimits:
    """Ability of a lander and its attitude control to tilt.

    Attributes
    ----------
    torque
        Usable torque about the weakest horizontal body axis, N m; inf for ideal attitude control.
    max_rate
        Maximum angular rate, rad/s; inf if the control has none.
    response_time
        Lag of the attitude behind a slowly changing command, s.
    lander
        Lander, for the moments of inertia.
    """

    torque: float
    max_rate: float
    response_time: float
    lander: Lander

    @classmethod
    def of(cls, lander: Lander, control: Any) -> RotationLimits:
        """Return the limits of a lander with the attitude control `control`.

        A control that brakes with the share s of the available torque M rotates as fast as one that
        uses the harmonic mean ``2 M s / (1 + s)`` throughout.
        """
        share = _PHASE_PLANE_SHARE if isinstance(control, PhasePlane) else 1.0
        torque = np.inf
        if getattr(control, "torques", True):
            torque = tilt_torque(lander) * 2.0 * share / (1.0 + share)
        max_rate = float(getattr(control, "slew_limit", np.inf))
        return cls(torque, max_rate, float(control.response_time), lander)

    def acceleration(self, mass: float) -> float:
        """Return the angular acceleration about the weakest horizontal axis, rad/s^2.

        `mass` is that of the lander, kg.
        """
        return self.torque / float(self.lander.inertia(mass)[:2].max())

    def time(self, angle: Array | float, mass: float) -> Array:
        """Return the shortest time of a rotation by an angle (...), rad, in s.

        The rotation is from rest to rest. A bang-bang manoeuvre takes ``2 sqrt(angle /
        acceleration)``. If its peak rate ``sqrt(angle acceleration)`` exceeds the maximum rate w,
        the lander coasts in between and needs ``angle / w + w / acceleration``. `mass` is that of
        the lander, kg.
        """
        a, w = self.acceleration(mass), self.max_rate
        angle = np.maximum(np.asarray(angle, dtype=np.float64), 0.0)
        if not np.isfinite(w):
            return np.asarray(2.0 * np.sqrt(angle / a))
        bang_bang = angle <= w * w / a
        return np.where(bang_bang, 2.0 * np.sqrt(angle / a), angle / w + w / a)

    def angle(self, time: float, mass: float) -> float:
        """Return the largest rotation (rad) from rest to rest within a time (s).

        This is the inverse of the method `time`; `mass` is that of the lander, kg.
        """
        a, w = self.acceleration(mass), self.max_rate
        if time <= 0.0:
            return 0.0
        if not np.isfinite(a):
            return w * time
        return 0.25 * a * time**2 if time <= 2.0 * w / a else w * (time - w / a)

    def min_time_to_go(self, rotation: Array, mass: float, shape: PathShape) -> Array:
        """Return the minimum time-to-go (...), s, after a first rotation (...), rad.

        A rest-to-rest rotation of duration t acts like a delay of t / 2. Guidance compensates the
        response time of the control and tolerates a further delay of `guidance_delay_margin` times
        the time-to-go T: ``t / 2 <= m T + response time``. `mass` is that of the lander, kg.
        """
        delay = 0.5 * self.time(rotation, mass) - self.response_time
        return np.asarray(delay / guidance_delay_margin(shape))

    def limit(
        self,
        cost: DivertCost,
        law: Any,
        estimate: Estimate,
        end: PhaseEnd,
        gravity: float,
        limits: PathLimits,
    ) -> DivertCost:
        """Return a divert cost in which every path leaves time for its first rotation.

        A path with too short a time-to-go is replaced by the path with the minimum one. A site
        without such a path within the limits becomes infeasible, with infinite propellant.

        Parameters
        ----------
        cost
            Cost of the paths to n ends.
        law, estimate, end, gravity, limits
            Settings of the guidance law, and the arguments of its method `cost`.
        """
        if not (np.isfinite(self.torque) or np.isfinite(self.max_rate)):
            return cost
        shape, times = path_shape(law), cost.time_to_go
        shortest = self._min_times(times, shape, estimate, end, gravity)
        late = times < shortest
        if not late.any():
            return cost
        slower = replace(cost, propellant=np.full(len(times), np.inf))
        if isinstance(law, PathLaw):  # other laws need not accept times
            given = np.where(late, shortest, np.nan)
            slower = law.cost(estimate, end, self.lander, gravity, limits, given)
        keeps = slower.feasible & (
            shortest >= self._min_times(shortest, shape, estimate, end, gravity) - 1e-9
        )
        use = [~late, keeps]
        return DivertCost(
            np.select(use, [cost.propellant, slower.propellant], np.inf),
            np.select(use, [times, shortest], np.nan),
            np.select(use, [cost.peak_thrust, slower.peak_thrust], np.nan),
            np.select(use, [cost.peak_tilt, slower.peak_tilt], np.nan),
        )  # fmt: skip

    def _min_times(
        self, times: Array, shape: PathShape, estimate: Estimate, end: PhaseEnd, gravity: float
    ) -> Array:
        """Return `min_time_to_go` (n,), s, of paths with times-to-go (n,), s, to n ends."""
        thrust = np.empty((len(times), 3))
        initial_accelerations(
            np.array([estimate.position, estimate.velocity], dtype=np.float64),
            np.ascontiguousarray(np.atleast_2d(end.position), dtype=np.float64),
            np.array([end.velocity, end.acceleration], dtype=np.float64),
            np.ascontiguousarray(times), np.array(shape.powers), thrust,
        )  # fmt: skip
        thrust[:, 2] += gravity
        axis = quat_to_matrix(estimate.attitude)[:, 2]
        cosine = thrust @ axis / np.linalg.norm(thrust, axis=1)
        rotation = np.arccos(np.clip(cosine, -1.0, 1.0))
        return self.min_time_to_go(rotation, estimate.mass, shape)
