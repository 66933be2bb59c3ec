"""Define the settings of a training of ``Guidance-v0``; they fix its result."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim_envs.descent.observations import PARTS
from lunarsim_envs.descent.rewards import DescentWeights

# Input scales (far, near) of each observation component for `TwoScaleFeatures`: typical magnitude
# of a flight, and resolution near the target.
SCALES: dict[str, tuple[float, float]] = {
    "position": (600.0, 3.0), "velocity": (40.0, 1.0), "attitude": (1.0, 0.1), "rate": (0.5, 0.1),
    "thrust": (4.0, 1.0), "propellant": (400.0, 400.0),
}  # fmt: skip


@dataclass(frozen=True)
class PpoSettings:
    """Settings of a training by proximal policy optimisation (PPO).

    Attributes
    ----------
    steps
        Total number of environment steps of all parallel flights.
    seed
        Root seed of the training.
    lanes, horizon
        Number of parallel flights, and steps of each between two updates.
    batch, epochs
        Minibatch size, and number of passes over each rollout.
    discount, gae_lambda
        Discount factor of the return, and lambda of the advantage estimate.
    rate_first, rate_last
        Initial and final learning rate; it decreases linearly.
    initial_log_std, final_log_std
        Initial and final bound of the log standard deviation of actions; it decreases linearly.
        With large random actions, the lander rotates faster than a safe touchdown allows, so the
        agent never experiences a safe landing.
    width
        Width of the two hidden layers.
    initial_thrust_to_weight
        Mean initial thrust over the weight.
    position_sigma, velocity_sigma
        Dispersion of the start, 1 sigma per axis, m and m/s.
    nearest, shares
        Smallest start distance as a fraction of the full distance, and number of different start
        distances. The last five start at the full distance.
    safe, crash, propellant, miss, severity, excess, shaping
        Reward weights, defined in `DescentWeights`; shaping uses `discount`.
    """

    steps: int = 15_000_000
    seed: int = 0
    lanes: int = 512
    horizon: int = 128
    batch: int = 2048
    epochs: int = 5
    discount: float = 0.995
    gae_lambda: float = 0.95
    rate_first: float = 1.5e-3
    rate_last: float = 1e-4
    initial_log_std: float = -1.5
    final_log_std: float = -3.5
    width: int = 64
    initial_thrust_to_weight: float = 0.9
    position_sigma: float = 100.0 / 3.0
    velocity_sigma: float = 10.0
    nearest: float = 0.04
    shares: int = 16
    safe: float = 10.0
    crash: float = 2.0
    propellant: float = 0.002
    miss: float = 0.1
    severity: float = 6.0
    excess: float = 0.3
    shaping: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value):
                raise InputError(field.name, value, "must be finite")
        for name in ("steps", "lanes", "horizon", "batch", "epochs", "width", "shares"):
            if getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "must be 1 or more")
        if self.lanes < self.shares:
            raise InputError(
                "lanes",
                self.lanes,
                f"must be {self.shares} or more, which is the number of start distances (shares)",
            )
        if not 0.0 < self.nearest <= 1.0:
            raise InputError("nearest", self.nearest, "must be above 0 and at most 1")

    @property
    def weights(self) -> DescentWeights:
        """Reward weights of the training environment."""
        return DescentWeights(
            safe=self.safe, crash=self.crash, propellant=self.propellant, miss=self.miss,
            severity=self.severity, excess=self.excess, shaping=self.shaping,
            discount=self.discount,
        )  # fmt: skip

    @property
    def changes(self) -> dict[str, Any]:
        """Changed scenario values by key: dispersion of the start state."""
        return {
            "start.position_sigma_m": self.position_sigma,
            "start.velocity_sigma_m_s": self.velocity_sigma,
        }

    @property
    def updates(self) -> int:
        """Total number of updates of the agent in a training."""
        return -(-self.steps // (self.lanes * self.horizon))

    def _interpolate(self, first: float, last: float, done: int) -> float:
        """Interpolate from `first` to `last` over all updates, at update number `done`."""
        return first + (last - first) * min(done / max(self.updates - 1, 1), 1.0)

    def learning_rate(self, done: int) -> float:
        """Return the learning rate after `done` updates."""
        return self._interpolate(self.rate_first, self.rate_last, done)

    def max_log_std(self, done: int) -> float:
        """Return the maximum log standard deviation of actions after `done` updates."""
        return self._interpolate(self.initial_log_std, self.final_log_std, done)

    def starts(self, planned: np.ndarray) -> list[dict[str, Any]]:
        """Return options of `reset` with starts from near the target to the full distance.

        Parameters
        ----------
        planned
            Position, velocity and their standard deviations (8,), SI (`VehicleParams.start`). At a
            fraction f of the distance, the speed is multiplied by sqrt(f), as for a constant
            deceleration.
        """
        full = max(self.shares - 5, 1)
        found = []
        for k in range(self.shares):
            way = self.nearest ** (1.0 - min(k / full, 1.0))
            fast = float(np.sqrt(way))
            found.append({
                "position_m": (way * planned[:3]).tolist(),
                "velocity_m_s": (fast * planned[3:6]).tolist(),
                "position_sigma_m": float(way * planned[6]),
                "velocity_sigma_m_s": fast * float(planned[7]),
            })  # fmt: skip
        return found

    def save(self, path: Path) -> None:
        """Write the settings to a JSON file."""
        atomic_write_text(path, json.dumps(asdict(self), indent=1))

    @classmethod
    def load(cls, path: Path) -> PpoSettings:
        """Read settings written by `save`."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))


def scales(parts: tuple[str, ...]) -> tuple[list[float], list[float]]:
    """Return the input scales `far` and `near` of every value of an observation.

    `parts` are the names of its components, in order.
    """
    each = [SCALES[name] for name in parts for _ in range(PARTS[name].size)]
    return [far for far, _ in each], [near for _, near in each]
