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
    """Settings of subset simulation: failure metric, limit, and levels.

    Attributes
    ----------
    metric
        Numeric column that measures the distance from failure.
    above, below
        Limit of the metric above or below which a flight counts as a failure; one of the two.
    keep
        Fraction of a level's flights that are the seeds of the Markov chains of the next level.
    levels
        Maximum number of levels; keep ** levels is about the smallest resolvable probability.
    same_world
        Fraction of the steps of a Markov chain that keep its world (terrain and noise).
    """

    metric: str = quantity(
        "touchdown_margin",
        help="numeric result column that measures the distance of a flight from failure",
    )
    above: float | None = quantity(
        None, help="limit of the metric above which a flight counts as a failure"
    )
    below: float | None = quantity(
        None, help="limit of the metric below which a flight counts as a failure"
    )
    keep: float = quantity(
        0.1,
        ge=0.05,
        le=0.5,
        help="fraction of a level's flights from which the next level starts; they are those "
        "closest to failure",
    )
    levels: int = quantity(6, ge=1, le=20, help="maximum number of levels of the subset simulation")
    same_world: float = quantity(
        0.5, ge=0, le=1, help="fraction of the steps of a Markov chain that keep terrain and noise"
    )

    def __post_init__(self) -> None:
        known = [name for name, kind in COLUMNS.items() if kind == "float"]
        if self.metric not in known:
            raise InputError(
                "metric", self.metric, "must be a numeric column of the results",
                suggestion(self.metric, known),
            )  # fmt: skip
        if (self.above is None) == (self.below is None):
            raise InputError(
                "below",
                self.below,
                "is required if above is omitted"
                if self.below is None
                else "must be omitted if above is given",
                show_value=self.below is not None,
            )
        if abs(self.steps * self.keep - 1.0) > 1e-9:
            raise InputError(
                "keep", self.keep, "must be 1 divided by an integer, for instance 0.1, 0.2 or 0.25"
            )

    @property
    def steps(self) -> int:
        """Number of states of a chain, including its seed."""
        return round(1.0 / self.keep)

    def check_flights(self, flights: int) -> None:
        """Raise `InputError` if `flights` per level give incomplete or too few chains."""
        least = _MIN_CHAINS * self.steps
        if flights % self.steps or flights < least:
            up = max(least, -(-flights // self.steps) * self.steps)
            raise InputError(
                "flights", flights,
                f"must be {least} or more and a multiple of {self.steps}, which is 1 / subset.keep",
                f"Use {up}.",
            )  # fmt: skip
