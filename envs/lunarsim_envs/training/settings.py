"""Define the settings of a training of descents; they fix its result."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError, error_reason


@dataclass(frozen=True)
class PpoSettings:
    """Settings of a training by proximal policy optimisation (PPO).

    All other settings are the defaults of Stable-Baselines3 and of the environment.

    Attributes
    ----------
    environment
        "Guidance-v1" or "Control-v1".
    rate
        Action rate, Hz.
    discount_per_s
        Discount factor per second of flight.
    steps
        Total number of environment steps of all parallel flights.
    seed
        Root seed of the training.
    lanes, horizon
        Number of parallel flights, and steps of each between two updates.
    batch
        Minibatch size.
    learning_rate
        Initial learning rate; it decreases linearly to zero.
    position_sigma, velocity_sigma
        Dispersion of the start, 1 sigma per axis, m and m/s.
    """

    environment: str = "Guidance-v1"
    rate: float = 5.0
    discount_per_s: float = 0.98
    steps: int = 10_000_000
    seed: int = 0
    lanes: int = 256
    horizon: int = 128
    batch: int = 2048
    learning_rate: float = 1e-3
    position_sigma: float = 100.0 / 3.0
    velocity_sigma: float = 10.0

    def __post_init__(self) -> None:
        for name in ("steps", "lanes", "horizon", "batch"):
            if getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "must be 1 or more")
        for name in ("learning_rate", "discount_per_s"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(name, getattr(self, name), "must be between 0 and 1")

    @property
    def discount(self) -> float:
        """Discount factor per step."""
        return float(self.discount_per_s ** (1.0 / self.rate))

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

    def learning_rate_at(self, done: int) -> float:
        """Return the learning rate after `done` updates."""
        return self.learning_rate * (1.0 - done / self.updates)

    def save(self, path: Path) -> None:
        """Write the settings to a JSON file."""
        atomic_write_text(path, json.dumps(asdict(self), indent=1))

    @classmethod
    def load(cls, path: Path) -> PpoSettings:
        """Read settings written by `save`.

        Raises
        ------
        InputError
            If the file is not one of this version.
        """
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                "settings", str(path), f"must be a file of this version ({error_reason(error)})"
            ) from None


# Settings of the trainings of the supplied agents, by environment.
SETTINGS = {
    "Guidance-v1": PpoSettings(),
    "Control-v1": PpoSettings(
        environment="Control-v1", rate=10.0, steps=4_000_000, lanes=128,
        horizon=256, position_sigma=30.0, velocity_sigma=3.0,
    ),
}  # fmt: skip
