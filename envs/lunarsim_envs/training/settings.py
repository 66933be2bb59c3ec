"""What a training of ``Guidance-v0`` is told: everything that its result hangs on."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.whole_files import write_text_whole
from lunarsim_envs.descent.observations import PARTS
from lunarsim_envs.descent.rewards import DescentWeights

# Scales of each number of a part: over `far` all that comes is about 1; by `near` it is told apart
# near the target. See `features.TwoScales`.
SCALES: dict[str, tuple[float, float]] = {
    "position": (600.0, 3.0), "velocity": (40.0, 1.0), "attitude": (1.0, 0.1), "rate": (0.5, 0.1),
    "thrust": (4.0, 1.0), "propellant": (400.0, 400.0),
}  # fmt: skip


@dataclass(frozen=True)
class Training:
    """Settings of a training by proximal policy optimisation.

    Attributes
    ----------
    steps
        Of the environment, all lanes together.
    seed
        Of everything.
    lanes, horizon
        Flights side by side, and actions of each between two updates.
    batch, epochs
        Samples of a gradient step, and passes over what was flown.
    discount, trace
        Of the return, and of the advantage (lambda).
    rate_first, rate_last
        Learning rate, which falls linearly.
    spread, spread_last
        Logarithm of the standard deviation of actions at first, and the most that is left of it at
        the end; between them that falls linearly. Actions that scatter turn the lander faster than
        a safe touchdown allows: what is never flown calmly never learns to land.
    width
        Of the two hidden layers.
    bears
        Share of the weight that the first actions bear, on average.
    position_sigma, velocity_sigma
        Dispersion of the start an axis, m and m/s.
    nearest, shares
        Lanes start at so many different shares of the way, the nearest at this one; the last five
        at the whole.
    safe, crash, propellant, miss, severity, excess, shaping
        `DescentWeights`; the discount of shaping is `discount`.
    """

    steps: int = 15_000_000
    seed: int = 0
    lanes: int = 512
    horizon: int = 128
    batch: int = 2048
    epochs: int = 5
    discount: float = 0.995
    trace: float = 0.95
    rate_first: float = 1.5e-3
    rate_last: float = 1e-4
    spread: float = -1.5
    spread_last: float = -3.5
    width: int = 64
    bears: float = 0.9
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
                raise InputError(field.name, value, "a finite number")
        for name in ("steps", "lanes", "horizon", "batch", "epochs", "width", "shares"):
            if getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "at least 1")
        if self.lanes < self.shares:
            raise InputError("lanes", self.lanes, f"at least {self.shares}, one for each start")
        if not 0.0 < self.nearest <= 1.0:
            raise InputError("nearest", self.nearest, "above 0, at most 1")

    @property
    def weights(self) -> DescentWeights:
        """Of the reward."""
        return DescentWeights(
            safe=self.safe, crash=self.crash, propellant=self.propellant, miss=self.miss,
            severity=self.severity, excess=self.excess, shaping=self.shaping,
            discount=self.discount,
        )  # fmt: skip

    @property
    def changes(self) -> dict[str, Any]:
        """Of the scenario."""
        return {
            "start.position_sigma_m": self.position_sigma,
            "start.velocity_sigma_m_s": self.velocity_sigma,
        }

    @property
    def updates(self) -> int:
        """How many times the agent is updated."""
        return -(-self.steps // (self.lanes * self.horizon))

    def _falls(self, first: float, last: float, done: int) -> float:
        """Return what goes linearly from `first` to `last` over the updates."""
        return first + (last - first) * min(done / max(self.updates - 1, 1), 1.0)

    def learning_rate(self, done: int) -> float:
        """Return the learning rate after so many updates."""
        return self._falls(self.rate_first, self.rate_last, done)

    def most_spread(self, done: int) -> float:
        """Return the most that the logarithm of the standard deviation may be by then."""
        return self._falls(self.spread, self.spread_last, done)

    def starts(self, planned: np.ndarray) -> list[dict[str, Any]]:
        """Return options of a reset, from near the target to the whole way.

        Parameters
        ----------
        planned
            Position and velocity and their standard deviations (8,), SI; see `lanes.Craft`. At a
            share of the way the position is that share, speed its root: as if it braked evenly.
        """
        whole = max(self.shares - 5, 1)
        found = []
        for k in range(self.shares):
            way = self.nearest ** (1.0 - min(k / whole, 1.0))
            fast = float(np.sqrt(way))
            found.append({
                "position_m": (way * planned[:3]).tolist(),
                "velocity_m_s": (fast * planned[3:6]).tolist(),
                "position_sigma_m": float(way * planned[6]),
                "velocity_sigma_m_s": fast * float(planned[7]),
            })  # fmt: skip
        return found

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        write_text_whole(path, json.dumps(asdict(self), indent=1))

    @classmethod
    def load(cls, path: Path) -> Training:
        """Read what `save` wrote."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))


def scales(parts: tuple[str, ...]) -> tuple[list[float], list[float]]:
    """Return the scales far and near of every number of an observation of these parts."""
    each = [SCALES[name] for name in parts for _ in range(PARTS[name].size)]
    return [far for far, _ in each], [near for _, near in each]
