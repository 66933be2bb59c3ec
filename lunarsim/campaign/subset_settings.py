"""What a spec says of subset simulation: the metric that tells how near failure is, and levels."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.outcome import COLUMNS
from lunarsim.parts import quantity

# Chains of a level at least: fewer tell nothing of the spread between them.
_FEWEST_CHAINS = 10


@dataclass(frozen=True)
class Subset:
    """Which flights have failed, and by which steps the campaign goes towards them.

    Attributes
    ----------
    metric
        Column of numbers whose value tells how near failure a flight came.
    above, below
        Beyond it is failure: one of the two.
    keep
        Share of a level's flights that begin the chains of the next.
    levels
        At most; keep ** levels is about the least share that can be told.
    same_world
        Share of the steps of a chain that keep its world.
    """

    metric: str = quantity("touchdown_margin", help="a column of numbers: how near failure is")
    above: float | None = quantity(None, help="a metric above this is a failure")
    below: float | None = quantity(None, help="a metric below this is a failure")
    keep: float = quantity(0.1, ge=0.05, le=0.5, help="of a level's flights begin the next")
    levels: int = quantity(6, ge=1, le=20, help="at most")
    same_world: float = quantity(0.5, ge=0, le=1, help="of a chain's steps keep its world")

    def __post_init__(self) -> None:
        known = [name for name, kind in COLUMNS.items() if kind == "float"]
        if self.metric not in known:
            raise InputError("metric", self.metric, suggestion(self.metric, known))
        if (self.above is None) == (self.below is None):
            raise InputError("below", self.below, "either above or below, a number")
        if abs(self.steps * self.keep - 1.0) > 1e-9:
            raise InputError("keep", self.keep, "one over a whole number, as 0.1, 0.2 or 0.25")

    @property
    def steps(self) -> int:
        """States of a chain, the one that it begins with included."""
        return round(1.0 / self.keep)

    def check_flights(self, flights: int) -> None:
        """Raise `InputError` where the flights of a level do not make whole chains, or few."""
        least = _FEWEST_CHAINS * self.steps
        if flights % self.steps or flights < least:
            up = max(least, -(-flights // self.steps) * self.steps)
            raise InputError(
                "flights", flights,
                f"of each level, {self.steps} times a number of chains, {least} at least: {up}",
            )  # fmt: skip
