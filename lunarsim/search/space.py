"""Admissible ranges of the keys of a search, and their nominal values."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.typing import Array

# Continuous values have this many significant digits, so that files of findings are readable.
_DIGITS = 4


@dataclass(frozen=True)
class ContinuousRange:
    """Admissible interval of a number.

    Attributes
    ----------
    low, high
        Bounds, in the unit of the key. Both are admissible.
    nominal
        Value of an ordinary case, between the bounds.
    is_logarithmic
        Whether the search is uniform in the logarithm of the value.

    Examples
    --------
    >>> ContinuousRange(1.0, 100.0, 10.0, is_logarithmic=True).at(0.25)
    3.162
    """

    low: float
    high: float
    nominal: float
    is_logarithmic: bool = False

    def __post_init__(self) -> None:
        for name in ("low", "high", "nominal"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(name, getattr(self, name), "must be a finite number")
        if not self.low < self.high:
            raise InputError("low", self.low, f"must be less than high, which is {self.high:g}")
        if self.is_logarithmic and self.low <= 0.0:
            raise InputError("low", self.low, "must be positive, because the range is logarithmic")
        _check_nominal(self)

    def at(self, position: float) -> float:
        """Return the value at a position from 0 (low) to 1 (high)."""
        if self.is_logarithmic:
            value = self.low * (self.high / self.low) ** position
        else:
            value = self.low + position * (self.high - self.low)
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def position(self, value: float) -> float:
        """Return the position of a value, from 0 (low) to 1 (high)."""
        if self.is_logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def toward_nominal(self, value: float, fraction: float) -> float:
        """Return a value at a fraction of the way from the nominal value to `value`."""
        start = self.position(self.nominal)
        return self.at(start + fraction * (self.position(value) - start))


@dataclass(frozen=True)
class IntegerRange:
    """Admissible integers: `low`, `high` and all integers between them.

    Attributes
    ----------
    low, high
        Bounds.
    nominal
        Value of an ordinary case, between the bounds.

    Examples
    --------
    >>> [IntegerRange(3, 4, 4).at(u) for u in (0.0, 0.49, 0.5, 1.0)]
    [3, 3, 4, 4]
    """

    low: int
    high: int
    nominal: int

    def __post_init__(self) -> None:
        for name in ("low", "high", "nominal"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int):
                raise InputError(name, value, "must be an integer")
        if not self.low < self.high:
            raise InputError("low", self.low, f"must be less than high, which is {self.high}")
        _check_nominal(self)

    def at(self, position: float) -> int:
        """Return the value at a position from 0 to 1; all values have equal intervals."""
        return min(self.low + int(position * (self.high - self.low + 1)), self.high)

    def position(self, value: int) -> float:
        """Return the middle of the interval of a value, between 0 and 1."""
        return (value - self.low + 0.5) / (self.high - self.low + 1)

    def toward_nominal(self, value: int, fraction: float) -> int:
        """Return a value at a fraction of the way from the nominal value to `value`."""
        return round(self.nominal + fraction * (value - self.nominal))


@dataclass(frozen=True)
class ChoiceRange:
    """Admissible values without an order, for example names.

    Attributes
    ----------
    values
        Admissible values, at least two, all different.
    nominal
        Value of an ordinary case, one of `values`.
    """

    values: tuple[Any, ...]
    nominal: Any

    def __post_init__(self) -> None:
        if len(self.values) < 2 or any(v in self.values[:n] for n, v in enumerate(self.values)):
            raise InputError(
                "values", list(self.values), "must be at least two values, all different"
            )
        if self.nominal not in self.values:
            raise InputError("nominal", self.nominal, f"must be one of {list(self.values)}")

    def at(self, position: float) -> Any:
        """Return the value at a position from 0 to 1; all values have equal intervals."""
        return self.values[min(int(position * len(self.values)), len(self.values) - 1)]

    def position(self, value: Any) -> float:
        """Return the middle of the interval of a value, between 0 and 1."""
        return (self.values.index(value) + 0.5) / len(self.values)

    def toward_nominal(self, value: Any, fraction: float) -> Any:
        """Return `value` for the fraction 1, and the nominal value below."""
        return value if fraction >= 1.0 else self.nominal


SearchRange = ContinuousRange | IntegerRange | ChoiceRange


def _check_nominal(one: ContinuousRange | IntegerRange) -> None:
    if not one.low <= one.nominal <= one.high:
        raise InputError("nominal", one.nominal, f"must be between {one.low:g} and {one.high:g}")


@dataclass(frozen=True)
class SearchSpace:
    """Admissible values of a search: one range per key.

    Attributes
    ----------
    ranges
        Range of each key. Keys are names, for example dotted keys of a scenario.
    """

    ranges: Mapping[str, SearchRange]

    def __post_init__(self) -> None:
        if not self.ranges:
            raise InputError("ranges", {}, "must contain at least one key")
        for key, one in self.ranges.items():
            if not isinstance(one, SearchRange):
                raise InputError(
                    f"ranges.{key}", one,
                    "must be a ContinuousRange, an IntegerRange or a ChoiceRange",
                )  # fmt: skip

    def nominal(self) -> dict[str, Any]:
        """Return the nominal value of each key."""
        return {key: one.nominal for key, one in self.ranges.items()}

    def values(self, position: ArrayLike) -> dict[str, Any]:
        """Return the value of each key at a point (keys,) of the unit cube."""
        return {
            key: one.at(float(u))
            for (key, one), u in zip(self.ranges.items(), np.asarray(position), strict=True)
        }

    def position(self, values: Mapping[str, Any]) -> Array:
        """Return the point (keys,) of the unit cube of a set of values."""
        return np.array([one.position(values[key]) for key, one in self.ranges.items()])

    def distance(self, first: Mapping[str, Any], second: Mapping[str, Any]) -> float:
        """Return the mean difference of position over all keys, between 0 and 1."""
        return float(np.abs(self.position(first) - self.position(second)).mean())

    def check(self, build: Callable[[Mapping[str, Any]], object]) -> None:
        """Check that both ends of each range are accepted, with all other keys nominal.

        Parameters
        ----------
        build
            Function that uses a set of values, and raises InputError if it is not admissible.

        Raises
        ------
        InputError
            For the first key with a value that `build` does not accept. The field is
            ``ranges.KEY``.
        """
        nominal = self.nominal()
        build(nominal)
        for key, one in self.ranges.items():
            ends = one.values if isinstance(one, ChoiceRange) else (one.low, one.high)
            for value in ends:
                try:
                    build({**nominal, key: value})
                except InputError as error:
                    raise InputError(
                        f"ranges.{key}", value, f"must be admissible, because {error}".rstrip("."),
                        "Correct the key or its range.",
                    ) from None  # fmt: skip
