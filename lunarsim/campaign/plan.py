"""What each flight of a campaign gets, before anything is flown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

# What a flight counts where draws lean to failure (importance sampling): a column of its own.
WEIGHT = "weight"
# Flights of all arms of a campaign. At 0.1 s each, so many take 12 days on one core.
MAX_FLIGHTS = 10_000_000
# Kinds of columns that a results table may have.
KINDS = ("bool", "int", "float", "text")


def row_id(flight: int, arm: int) -> str:
    """Return the name of one flight of one arm: ``12-0``."""
    return f"{flight}-{arm}"


@dataclass(frozen=True)
class Group:
    """Flights that one worker flies one after the other: one index, arms over one ground.

    Attributes
    ----------
    flight
        Index; with the root seed it gives the seed.
    arms
        Indices of arms.
    draws
        Dispersed values by key.
    """

    flight: int
    arms: tuple[int, ...]
    draws: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Work:
    """What workers fly with.

    Attributes
    ----------
    function
        "module:name" of a function of `study`, group, arm and a memory (a dictionary that lasts for
        the group) that returns the metrics of one flight.
    study
        Anything that can be pickled, the same for all flights.
    """

    function: str
    study: Any = None


class Following(Protocol):
    """Flights that are drawn from how earlier ones ended: `lunarsim.campaign.subset.Chains`.

    Attributes
    ----------
    flights
        Of the first level, which follow from none.
    stop
        Number of flights of the whole campaign, once it is known.
    """

    flights: int
    stop: int | None

    def resume(self, rows: Iterable[Mapping[str, Any]]) -> list[int]:
        """Take in what is there; return flights that follow from none that is."""
        ...

    def see(self, flight: int, row: Mapping[str, Any]) -> None:
        """Take in a row."""
        ...

    def groups(self, has: Callable[[int, int], bool]) -> Iterator[Group | None]:
        """Yield what can begin; None while all waits for flights in the air."""
        ...


@dataclass(frozen=True)
class Plan:
    """All flights of a campaign.

    Attributes
    ----------
    name, seed, flights
        Of the campaign; root seed; indices.
    arms
        Name of each arm and its values by key.
    groups
        Indices of arms that are flown together.
    draws
        Dispersed values of a flight's index.
    columns
        Kind of every metric that a flight gives: bool, int, float or text.
    inputs
        Kind of every input by key: of the arms' values and of what is drawn.
    work
        What workers fly with.
    identity
        What makes the results, as plain tables: another one is another campaign.
    chains
        Of method subset: which flights follow from which; `draws` is theirs, and knows a flight
        once those that it follows from have been seen. `flights` is then the most there can be.
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
    chains: Following | None = None

    def inputs_of(self, flight: int, arm: int) -> dict[str, Any]:
        """Return the inputs of one flight by key."""
        return {**self.arms[arm][1], **self.draws(flight)}

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield what every flight gets: id, flight, arm, seed and inputs.

        With method subset those of the first level: nobody knows the others yet.
        """
        for flight in range(self.flights if self.chains is None else self.chains.flights):
            drawn = self.draws(flight)
            for arm, (name, values) in enumerate(self.arms):
                yield {
                    "id": row_id(flight, arm), "flight": flight, "arm": name, "seed": self.seed,
                    **values, **drawn,
                }  # fmt: skip


def kind_of(values: Sequence[Any]) -> str:
    """Return the kind of a column that holds values; lists and mixtures are text."""
    if all(isinstance(v, bool) for v in values):
        return "bool"
    if all(isinstance(v, int) and not isinstance(v, bool) for v in values):
        return "int"
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return "float"
    return "text"
