"""Plan of a campaign: the inputs of each flight, before anything is flown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

# Column with the importance-sampling weight of a flight.
WEIGHT = "weight"
# Maximum number of flights of all arms; at 0.1 s each they take 12 days on one core.
MAX_FLIGHTS = 10_000_000


def row_id(flight: int, arm: int) -> str:
    """Return the id of a result row: indices of flight and arm, for instance ``12-0``.

    An arm is a variant of the scenario.
    """
    return f"{flight}-{arm}"


@dataclass(frozen=True)
class Group:
    """One flight index under several arms over the same terrain, flown by one worker.

    An arm is a variant of the scenario.

    Attributes
    ----------
    flight
        Index of the flight; it gives the seed, together with the root seed.
    arms
        Indices of arms.
    draws
        Random scenario values of the flight by key.
    """

    flight: int
    arms: tuple[int, ...]
    draws: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Work:
    """Function and settings with which worker processes fly flights.

    Attributes
    ----------
    function
        "module:name" of a function that returns the metrics of one flight. Its arguments are
        `study`, the group, the arm and a dictionary that persists within the group.
    study
        Picklable settings, the same for all flights.
    """

    function: str
    study: Any = None


class DependentFlights(Protocol):
    """Interface to flights whose inputs depend on the results of earlier flights.

    Subset simulation implements it: its Markov chains continue from flights near failure.

    Attributes
    ----------
    flights
        Number of flights of the first level, which depend on no others.
    stop
        Number of flights of the complete campaign; None until it is known.
    """

    flights: int
    stop: int | None

    def resume(self, rows: Iterable[Mapping[str, Any]]) -> list[int]:
        """Start again from existing result rows; return the flights that do not fit.

        The result has flight indices. A flight does not fit if a predecessor is missing, or if its
        values do not follow from its predecessors; its row is not added.
        """
        ...

    def add(self, flight: int, row: Mapping[str, Any]) -> None:
        """Add the result row of a flight."""
        ...

    def groups(self, has_result: Callable[[int, int], bool]) -> Iterator[Group | None]:
        """Yield groups that can start; None while all others wait for running flights.

        An arm is a variant of the scenario. `has_result` returns whether the result of a flight
        under an arm, given by indices, exists.
        """
        ...


@dataclass(frozen=True)
class Plan:
    """All flights of a campaign, with the inputs of each.

    Attributes
    ----------
    name, seed, flights
        Name of the campaign; root seed; number of flight indices.
    arms
        Name of each arm (variant of the scenario), and its values by scenario key.
    groups
        Indices of arms that are flown together.
    draws
        Function that returns the random scenario values of a flight index.
    columns
        Kind of every metric: bool, int, float or text.
    inputs
        Kind of every input by key: values of the arms and draws.
    work
        Function and settings that workers fly with.
    identity
        Plain tables that determine the results; another identity is another campaign.
    chains
        Dependencies between flights with method subset, else None. `draws` then knows a flight
        once its predecessors have been added, and `flights` is the maximum number.
    """

    name: str
    seed: int
    flights: int
    arms: Sequence[tuple[str, Mapping[str, Any]]]
    groups: Sequence[tuple[int, ...]]
    draws: Callable[[int], dict[str, Any]]
    columns: Mapping[str, str]
    inputs: Mapping[str, str]
    work: Work
    identity: Mapping[str, Any]
    chains: DependentFlights | None = None

    def inputs_of(self, flight: int, arm: int) -> dict[str, Any]:
        """Return the scenario values that an arm sets and a flight draws, by key.

        An arm is a variant of the scenario.
        """
        return {**self.arms[arm][1], **self.draws(flight)}

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the inputs of every flight: id, flight, arm, seed and values.

        An arm is a variant of the scenario. With method subset, only flights of the first level are
        known in advance.
        """
        for flight in range(self.flights if self.chains is None else self.chains.flights):
            drawn = self.draws(flight)
            for arm, (name, values) in enumerate(self.arms):
                yield {
                    "id": row_id(flight, arm), "flight": flight, "arm": name, "seed": self.seed,
                    **values, **drawn,
                }  # fmt: skip


def kind_of(values: Sequence[Any]) -> str:
    """Return the kind of a result column with the given values.

    Kinds are "bool", "int", "float" and "text", which includes lists and mixed types.
    """
    if all(isinstance(v, bool) for v in values):
        return "bool"
    if all(isinstance(v, int) and not isinstance(v, bool) for v in values):
        return "int"
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return "float"
    return "text"
