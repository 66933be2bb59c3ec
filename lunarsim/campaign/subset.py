"""Subset simulation: rare failures by way of less rare ones (Au and Beck, 2001).

Flights of the first level are drawn as declared. Those of them that came nearest to failure, a
share `keep`, begin chains whose flights stay at least as near; of these the nearest begin the
chains of the next level, until enough fail. The share of failures is the product of the shares of
the levels. A chain's step is that of Papaioannou et al. 2015 (conditional sampling): from normal
scores z to sqrt(1 - s^2) z + s xi, taken if the flight is near enough, else the chain stays where
it is. The world of a flight (rocks, noise, navigation errors) is part of the chain's state: a step
keeps it or takes that of its own index, which is a draw from all worlds. Both leave the law of
flights that are near enough as it is, so what chance does is in the share like everything else.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from lunarsim.campaign.dispersions import Choice, Dispersions
from lunarsim.campaign.plan import Group
from lunarsim.rng import Streams, flight_seed

Array = NDArray[np.float64]
Row = Mapping[str, Any]

# Columns of the rows of such a campaign.
LEVEL, CHAIN, WORLD = "level", "chain", "world"
# Scale s of the first chains, and the share of steps that should be taken (Papaioannou et al.
# 2015, section 4.2); each level's scale follows from what the one before has had.
_SCALE, _TAKEN = 0.6, 0.44
# A level that such a part of those who are not to be kept reaches is no step towards failure: the
# metric has steps. (States of chains are there more than once: a few more than asked for are kept.)
_MOST_MORE = 0.45
# Margin of a flight that is at the limit.
_LEAST = float(np.nextafter(0.0, 1.0))


@dataclass(frozen=True)
class Level:
    """What the flights of one level say.

    Attributes
    ----------
    margins
        How far each state of each chain is from failure (chains, steps); at or below 0 it fails.
        The first level has one chain a flight, of one step.
    worlds
        Index whose world each state has (chains, steps).
    threshold
        Margin that the chains of the next level stay at or below; 0 for the last.
    share
        Of the states at or below the threshold.
    taken
        Share of the steps that were taken; NaN for the first level.
    lost
        Flights without a margin: without a verdict, or without a touchdown.
    """

    margins: Array
    worlds: NDArray[np.int64]
    threshold: float
    share: float
    taken: float
    lost: int


class Chains:
    """Flights that are drawn from how earlier ones ended, and which of them can begin.

    What a flight is depends on the root seed, its index and the rows of earlier flights of its own
    chain and of the levels below; so it is the same whoever flies what when.

    Parameters
    ----------
    dispersions
        Of method subset.

    Attributes
    ----------
    levels
        Those that are complete.
    stop
        Number of flights of the whole campaign, once it is known.
    stuck
        Whether it ended because too many of a level's flights were as near as each other.
    """

    def __init__(self, dispersions: Dispersions) -> None:
        assert dispersions.subset is not None
        self.laws, self._settings = dispersions, dispersions.subset
        self.flights = dispersions.flights
        self.chains = round(self.flights * self._settings.keep)
        self.steps = self.flights // self.chains
        laws = dispersions.distributions
        self._compared = [WORLD, *(k for k, law in laws.items() if not isinstance(law, Choice))]
        self.reset()

    @property
    def most(self) -> int:
        """Number of flights if all levels are flown."""
        return self._first(self._settings.levels)

    @property
    def states(self) -> list[list[int]]:
        """Flights that are the states so far of each chain of the level that is being flown."""
        return [list(states) for states in self._states]

    def reset(self) -> None:
        """Forget all rows."""
        self.levels: list[Level] = []
        self.stop: int | None = None
        self.stuck = False
        self._scale = _SCALE
        # By flight: margin, normal scores, index of the world.
        self._margins: dict[int, float] = {}
        self.scores: dict[int, Array] = {}
        self._worlds: dict[int, int] = {}
        # Of each chain of the level that is being flown: its states so far.
        self._states: list[list[int]] = [[] for _ in range(self.flights)]
        self._left = self.flights
        self._waiting: deque[int] = deque(range(self.flights))

    # --- which flight is which ------------------------------------------------------------

    def _first(self, level: int) -> int:
        """Return the first flight of a level."""
        return 0 if level == 0 else self.flights + (level - 1) * (self.flights - self.chains)

    def _place(self, flight: int) -> tuple[int, int, int]:
        """Return level, step and chain of a flight; the first level has steps of 0."""
        if flight < self.flights:
            return 0, 0, flight
        level, rest = divmod(flight - self.flights, self.flights - self.chains)
        step, chain = divmod(rest, self.chains)
        return level + 1, step + 1, chain

    def draws(self, flight: int) -> dict[str, Any]:
        """Return the values of a flight by key, and its level, chain and world.

        Raises
        ------
        LookupError
            If flights that it follows from have not been seen.
        """
        level, step, chain = self._place(flight)
        if flight not in self.scores:
            self._draw(flight, level, step, chain)
        place = {LEVEL: level, CHAIN: chain if level else None, WORLD: self._worlds[flight]}
        return place | self.laws.at(ndtr(self.scores[flight]))

    def _draw(self, flight: int, level: int, step: int, chain: int) -> None:
        new = ndtri(self.laws.uniforms(flight))
        if level == 0:
            self.scores[flight], self._worlds[flight] = new, flight
            return
        if level != len(self.levels) or len(self._states[chain]) != step or self.stop is not None:
            raise LookupError(flight)
        now = self._states[chain][-1]
        rng = Streams(flight_seed(self.laws.seed, flight)).get("subset")
        stays = bool(rng.random() < self._settings.same_world)
        self.scores[flight] = np.sqrt(1.0 - self._scale**2) * self.scores[now] + self._scale * new
        self._worlds[flight] = self._worlds[now] if stays else flight

    # --- what has been flown --------------------------------------------------------------

    def see(self, flight: int, row: Row) -> None:
        """Take in the row of a flight whose draws were asked for."""
        level, _, chain = self._place(flight)
        if flight in self._margins or level != len(self.levels):
            return
        self._margins[flight] = self._margin(row)
        states = self._states[chain]
        near = level == 0 or self._margins[flight] <= self.levels[-1].threshold
        states.append(flight if near else states[-1])
        if level and len(states) < self.steps:
            self._waiting.append(flight + self.chains)
        self._left -= 1
        if not self._left:
            self._close()

    def _margin(self, row: Row) -> float:
        """Return how far a flight is from failure; one that has no value is taken as far away."""
        value = row.get(self._settings.metric)
        if value is None or not np.isfinite(value):
            return np.inf
        above, below = self._settings.above, self._settings.below
        margin = float(value) - below if above is None else above - float(value)  # type: ignore[operator]
        return margin or _LEAST  # at the limit is not beyond it

    def _close(self) -> None:
        """Note a complete level, and begin the next."""
        number = len(self.levels)
        states = np.array(self._states)
        margins = np.vectorize(self._margins.__getitem__, otypes=[float])(states)
        worlds = np.vectorize(self._worlds.__getitem__, otypes=[np.int64])(states)
        order = np.argsort(margins, axis=None, kind="stable")[: self.chains]
        threshold = max(0.0, float(margins.ravel()[order[-1]]))
        kept = float(np.mean(margins <= threshold))
        keep = self._settings.keep
        self.stuck = threshold > 0.0 and kept > keep + _MOST_MORE * (1.0 - keep)
        last = threshold == 0.0 or self.stuck or number == self._settings.levels - 1
        if last:
            threshold, kept = 0.0, float(np.mean(margins <= 0.0))
        first, end = self._first(number), self._first(number + 1)
        taken = float(np.mean(states[:, 1:] != states[:, :-1])) if number else np.nan
        lost = sum(self._margins[i] == np.inf for i in range(first, end))
        self.levels.append(Level(margins, worlds, threshold, kept, taken, lost))
        if last:
            self.stop = end
            return
        if number:
            self._scale = min(1.0, self._scale * float(np.exp(taken - _TAKEN)))
        if kept * margins.size > self.chains:
            # As many as are needed of those near enough, whichever they are: were the nearest
            # taken, chains would not begin by the law of all that are near enough.
            near = np.flatnonzero(margins.ravel() <= threshold)
            rng = Streams(flight_seed(self.laws.seed, end)).get("subset.seeds")
            order = np.sort(rng.choice(near, self.chains, replace=False))
        self._states = [[int(states.ravel()[i])] for i in order]
        self._left = self.flights - self.chains
        self._waiting = deque(range(end, end + self.chains))

    def resume(self, rows: Iterable[Row]) -> list[int]:
        """Take in rows of a folder, by flight; return flights that follow from none that is there.

        Parameters
        ----------
        rows
            Of the only arm.
        """
        self.reset()
        orphans: list[int] = []
        for row in rows:
            flight = row["flight"]
            try:
                drawn = self.draws(flight)
            except LookupError:
                orphans.append(flight)
                continue
            if any(drawn[key] != row.get(key) for key in self._compared):
                orphans.append(flight)
            else:
                self.see(flight, row)
        return orphans

    def value_of(self, margin: float) -> float:
        """Return the value of the metric that a margin stands for."""
        above, below = self._settings.above, self._settings.below
        return margin + below if above is None else above - margin  # type: ignore[operator]

    @property
    def metric(self) -> str:
        """The column that tells how near failure is."""
        return self._settings.metric

    def groups(self, has: Callable[[int, int], bool]) -> Iterator[Group | None]:
        """Yield flights that can begin and have no row; None while all wait for others."""
        while self.stop is None:
            if not self._waiting:
                yield None
                continue
            flight = self._waiting.popleft()
            if not has(flight, 0):
                yield Group(flight, (0,), self.draws(flight))
