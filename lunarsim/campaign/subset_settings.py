"""Settings of subset simulation: the failure metric and the levels."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.flight_metrics import COLUMNS
from lunarsim.parts import quantity

# Minimum number of chains per level; fewer do not show the spread between chains.
_MIN_CHAINS = 10


@dataclass(frozen=True)
class SubsetSettings:
    """Settings of subset simulation.

    Attributes
    ----------
    metric
        Numeric column that measures the distance from failure.
    above, below
        Failure limit of the metric: one of the two.
    keep
        Share of a level's flights that are the seeds of the chains of the next level.
    levels
        Maximum number of levels; keep ** levels is about the smallest resolvable probability.
    same_world
        Share of the steps of a chain that keep its world.
    """

    metric: str = quantity(
        "touchdown_margin", help="numeric column that measures the distance from failure"
    )
    above: float | None = quantity(None, help="a metric above this is a failure")
    below: float | None = quantity(None, help="a metric below this is a failure")
    keep: float = quantity(
        0.1, ge=0.05, le=0.5, help="share of a level's flights that are the seeds of the next level"
    )
    levels: int = quantity(6, ge=1, le=20, help="maximum number of levels")
    same_world: float = quantity(
        0.5, ge=0, le=1, help="share of the steps of a chain that keep its world"
    )

    def __post_init__(self) -> None:
        known = [name for name, kind in COLUMNS.items() if kind == "float"]
        if self.metric not in known:
            raise InputError("metric", self.metric, "is unknown", suggestion(self.metric, known))
        if (self.above is None) == (self.below is None):
            raise InputError("below", self.below, "give either above or below")
        if abs(self.steps * self.keep - 1.0) > 1e-9:
            raise InputError(
                "keep", self.keep, "must be one over an integer, for instance 0.1, 0.2 or 0.25"
            )

    @property
    def steps(self) -> int:
        """Number of states of a chain, including its seed."""
        return round(1.0 / self.keep)

    def check_flights(self, flights: int) -> None:
        """Raise `InputError` if a level has incomplete chains, or too few."""
        least = _MIN_CHAINS * self.steps
        if flights % self.steps or flights < least:
            up = max(least, -(-flights // self.steps) * self.steps)
            raise InputError(
                "flights", flights,
                f"must be a multiple of {self.steps} and {least} or more with method subset",
                f"Use {up}.",
            )  # fmt: skip
