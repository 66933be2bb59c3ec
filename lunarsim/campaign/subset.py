"""Subset simulation for rare failures (Au and Beck, 2001).

Flights of the first level are drawn from the nominal distributions. The share `keep` of them that
came closest to failure are the seeds of Markov chains whose flights stay at least as close. The
closest of these are the seeds of the next level, until enough flights fail. The failure
probability is the product of the conditional probabilities of the levels. The chains use
conditional sampling (Papaioannou et al. 2015): the candidate for normal scores z is
sqrt(1 - s^2) z + s xi; it is accepted if its flight is close enough, else the state is repeated.
The world of a flight (rocks, noise, navigation errors) is part of the state: a step keeps it or
uses the world of its index, which is a draw from all worlds. Both leave the conditional
distribution invariant, so the effect of chance is included in the probability.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from lunarsim.campaign.dispersions import Dispersions
from lunarsim.campaign.distributions import Choice
from lunarsim.campaign.plan import Group
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.typing import Array, IntArray

Row = Mapping[str, Any]

# Additional result columns of such a campaign.
LEVEL, CHAIN, WORLD = "level", "chain", "world"
# Scale s of the first chains, and target acceptance rate (Papaioannou et al. 2015, section 4.2);
# the scale of each level follows from the acceptance rate of the level before.
_INITIAL_SCALE, _TARGET_ACCEPTANCE = 0.6, 0.44
# If more than this share of the flights that should not be kept reach the threshold, the metric is
# discrete and the level is no progress. (Repeated states always add a few flights.)
_MAX_EXCESS_SHARE = 0.45
# Margin of a flight exactly at the failure limit: not a failure.
_MARGIN_AT_LIMIT = float(np.nextafter(0.0, 1.0))


@dataclass(frozen=True)
class SubsetLevel:
    """Result of one level of a subset simulation.

    Attributes
    ----------
    margins
        Distance from failure, in units of the metric, of each state of each chain (chains,
        steps); a value of 0 or less is a failure. In the first level each flight is a chain of
        one state.
    worlds
        Index of the world of each state (chains, steps).
    threshold
        Maximum margin in the chains of the next level; 0 for the last level.
    share
        Fraction of the states with a margin at or below the threshold.
    acceptance_rate
        Acceptance rate of the steps; NaN for the first level.
    missing_count
        Number of flights without a margin: without an outcome or without a touchdown.
    """

    margins: Array
    worlds: IntArray
    threshold: float
    share: float
    acceptance_rate: float
    missing_count: int


class SubsetChains:
    """Markov chains of a subset simulation, and the flights that can start next.

    A flight depends on the root seed, its index and the rows of earlier flights of its chain
    and of the lower levels. It therefore does not depend on the engine or the order of execution.

    Parameters
    ----------
    dispersions
        Dispersions with method subset.

    Attributes
    ----------
    levels
        Complete levels.
    stop
        Number of flights of the complete campaign; None until it is known.
    is_stalled
        Whether the campaign ended because too many flights of a level had equal margins.
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
    def max_flights(self) -> int:
        """Number of flights of the campaign if all levels are flown."""
        return self._first_flight(self._settings.levels)

    @property
    def states(self) -> list[list[int]]:
        """Flight indices of the states of each Markov chain of the current level."""
        return [list(states) for states in self._states]

    def reset(self) -> None:
        """Forget all flights, and start with the first level."""
        self.levels: list[SubsetLevel] = []
        self.stop: int | None = None
        self.is_stalled = False
        self._scale = _INITIAL_SCALE
        # By flight: margin, normal scores, index of the world.
        self._margins: dict[int, float] = {}
        self.scores: dict[int, Array] = {}
        self._worlds: dict[int, int] = {}
        # For each chain of the current level: its states so far.
        self._states: list[list[int]] = [[] for _ in range(self.flights)]
        self._left = self.flights
        self._waiting: deque[int] = deque(range(self.flights))

    # --- which flight is which ------------------------------------------------------------

    def _first_flight(self, level: int) -> int:
        """Return the index of the first flight of a level."""
        return 0 if level == 0 else self.flights + (level - 1) * (self.flights - self.chains)

    def _locate(self, flight: int) -> tuple[int, int, int]:
        """Return level, step in the Markov chain, and chain of a flight, given by index.

        In the first level the step is 0.
        """
        if flight < self.flights:
            return 0, 0, flight
        level, rest = divmod(flight - self.flights, self.flights - self.chains)
        step, chain = divmod(rest, self.chains)
        return level + 1, step + 1, chain

    def draws(self, flight: int) -> dict[str, Any]:
        """Return the random scenario values of a flight, and its level, chain and world.

        The result has one entry per scenario key, and "level", "chain" and "world".

        Raises
        ------
        LookupError
            If the flights that it depends on have not been added.
        """
        level, step, chain = self._locate(flight)
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
        rng = RandomStreams(flight_seed(self.laws.seed, flight)).get("subset")
        stays = bool(rng.random() < self._settings.same_world)
        self.scores[flight] = np.sqrt(1.0 - self._scale**2) * self.scores[now] + self._scale * new
        self._worlds[flight] = self._worlds[now] if stays else flight

    # --- what has been flown --------------------------------------------------------------

    def add(self, flight: int, row: Row) -> None:
        """Add the result row of a flight whose values `draws` has returned."""
        level, _, chain = self._locate(flight)
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
            self._close_level()

    def _margin(self, row: Row) -> float:
        """Return the distance of a flight from failure, in units of the metric.

        It is infinite if the result row has no finite value of the metric.
        """
        value = row.get(self._settings.metric)
        if value is None or not np.isfinite(value):
            return np.inf
        above, below = self._settings.above, self._settings.below
        margin = float(value) - below if above is None else above - float(value)  # type: ignore[operator]
        return margin or _MARGIN_AT_LIMIT  # a flight at the limit is not a failure

    def _close_level(self) -> None:
        """Store the result of the complete level, and select the seeds of the next."""
        number = len(self.levels)
        states = np.array(self._states)
        margins = np.vectorize(self._margins.__getitem__, otypes=[float])(states)
        worlds = np.vectorize(self._worlds.__getitem__, otypes=[np.int64])(states)
        order = np.argsort(margins, axis=None, kind="stable")[: self.chains]
        threshold = max(0.0, float(margins.ravel()[order[-1]]))
        kept = float(np.mean(margins <= threshold))
        keep = self._settings.keep
        self.is_stalled = threshold > 0.0 and kept > keep + _MAX_EXCESS_SHARE * (1.0 - keep)
        last = threshold == 0.0 or self.is_stalled or number == self._settings.levels - 1
        if last:
            threshold, kept = 0.0, float(np.mean(margins <= 0.0))
        first, end = self._first_flight(number), self._first_flight(number + 1)
        acceptance_rate = float(np.mean(states[:, 1:] != states[:, :-1])) if number else np.nan
        missing_count = sum(self._margins[i] == np.inf for i in range(first, end))
        self.levels.append(
            SubsetLevel(margins, worlds, threshold, kept, acceptance_rate, missing_count)
        )
        if last:
            self.stop = end
            return
        if number:
            self._scale = min(
                1.0, self._scale * float(np.exp(acceptance_rate - _TARGET_ACCEPTANCE))
            )
        if kept * margins.size > self.chains:
            # Sample the seeds from all states at or below the threshold: taking the closest ones
            # would not follow the conditional distribution.
            near = np.flatnonzero(margins.ravel() <= threshold)
            rng = RandomStreams(flight_seed(self.laws.seed, end)).get("subset.seeds")
            order = np.sort(rng.choice(near, self.chains, replace=False))
        self._states = [[int(states.ravel()[i])] for i in order]
        self._left = self.flights - self.chains
        self._waiting = deque(range(end, end + self.chains))

    def resume(self, rows: Iterable[Row]) -> list[int]:
        """Start again from stored results; return the flights that do not fit.

        An arm is a variant of the scenario. A flight does not fit if a predecessor is missing, or
        if its values do not follow from its predecessors. `rows` are the result rows of the
        campaign's only arm, sorted by flight.
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
                self.add(flight, row)
        return orphans

    def value_of(self, margin: float) -> float:
        """Return the value of the metric at a distance `margin` from failure."""
        above, below = self._settings.above, self._settings.below
        return margin + below if above is None else above - margin  # type: ignore[operator]

    @property
    def metric(self) -> str:
        """Result column that measures the distance of a flight from failure."""
        return self._settings.metric

    def groups(self, has_result: Callable[[int, int], bool]) -> Iterator[Group | None]:
        """Yield flights that can start and have no result yet.

        An arm is a variant of the scenario. Yield None while all wait for running flights.
        `has_result` returns whether the result of a flight under an arm, given by indices, is
        stored.
        """
        while self.stop is None:
            if not self._waiting:
                yield None
                continue
            flight = self._waiting.popleft()
            if not has_result(flight, 0):
                yield Group(flight, (0,), self.draws(flight))
