"""Distributions of scenario values: normal, truncated normal, uniform and choice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.special import ndtr, ndtri

from lunarsim.errors import InputError, suggestion
from lunarsim.parts import quantity, settings_of
from lunarsim.scenario.errors import input_error

# Minimum probability of a normal distribution between its bounds.
_MIN_BOUNDED_MASS = 1e-12


@dataclass(frozen=True)
class Normal:
    """Normal distribution of a scenario value.

    Attributes
    ----------
    mean, sigma
        Mean and standard deviation, in the unit of the key.
    """

    mean: float = quantity(0.0)
    sigma: float = quantity(1.0, gt=0)

    def at(self, u: float) -> float:
        """Return the quantile of the distribution at the probability `u`, in (0, 1)."""
        return float(self.mean + self.sigma * ndtri(u))


@dataclass(frozen=True)
class TruncatedNormal:
    """Normal distribution of a scenario value, truncated at one or two bounds.

    Attributes
    ----------
    mean, sigma, low, high
        Mean and standard deviation before truncation, and bounds, in the unit of the key. An
        omitted bound is infinite.
    """

    mean: float = quantity(0.0)
    sigma: float = quantity(1.0, gt=0)
    low: float | None = quantity(None)
    high: float | None = quantity(None)

    def __post_init__(self) -> None:
        if self.low is None and self.high is None:
            raise InputError(
                "low",
                None,
                "is required if high is omitted",
                'Without bounds, use kind = "normal".',
                show_value=False,
            )
        low, high = self._scores()
        if not low < high:
            raise InputError("low", self.low, f"must be less than high, which is {self.high}")
        mass = ndtr(-low) - ndtr(-high) if low > 0.0 else ndtr(high) - ndtr(low)
        if mass < _MIN_BOUNDED_MASS:
            raise InputError(
                "high" if self.low is None else "low", self.high if self.low is None else self.low,
                "must be closer to the mean, because the probability between low and high is "
                f"below {_MIN_BOUNDED_MASS:g}",
            )  # fmt: skip

    def _scores(self) -> tuple[float, float]:
        low = -np.inf if self.low is None else (self.low - self.mean) / self.sigma
        high = np.inf if self.high is None else (self.high - self.mean) / self.sigma
        return low, high

    def at(self, u: float) -> float:
        """Return the quantile of the distribution at the probability `u`, in (0, 1)."""
        from scipy.stats import truncnorm  # noqa: PLC0415  (slow to load)

        low, high = self._scores()
        return float(self.mean + self.sigma * truncnorm.ppf(u, low, high))


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution of a scenario value.

    Attributes
    ----------
    low, high
        Bounds, in the unit of the key.
    """

    low: float = quantity(0.0)
    high: float = quantity(1.0)

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise InputError("low", self.low, f"must be less than high, which is {self.high}")

    def at(self, u: float) -> float:
        """Return the quantile of the distribution at the probability `u`, in (0, 1)."""
        return float(self.low + (self.high - self.low) * u)


@dataclass(frozen=True)
class Choice:
    """Random choice of a scenario value from a list.

    Attributes
    ----------
    values
        Values that the key accepts.
    weights
        One weight per value, not all zero; omitted: equal weights.
    """

    values: tuple[Any, ...] = quantity(())
    weights: tuple[float, ...] | None = quantity(None, ge=0)

    def __post_init__(self) -> None:
        if not self.values:
            raise InputError("values", [], "must contain at least one value")
        if self.weights is not None:
            if len(self.weights) != len(self.values):
                raise InputError(
                    "weights",
                    self.weights,
                    f"must have as many weights as values ({len(self.values)})",
                )
            if not 0.0 < sum(self.weights) < np.inf:
                expected = "must have a positive and finite sum"
                raise InputError("weights", self.weights, expected)

    def at(self, u: float) -> Any:
        """Return the value whose range of cumulative, normalised weights contains `u`."""
        weights = np.ones(len(self.values)) if self.weights is None else np.array(self.weights)
        index = int(np.searchsorted(np.cumsum(weights) / weights.sum(), u, side="right"))
        return self.values[min(index, len(self.values) - 1)]


Distribution = Normal | TruncatedNormal | Uniform | Choice
KINDS: dict[str, type[Distribution]] = {
    "normal": Normal,
    "truncated-normal": TruncatedNormal,
    "uniform": Uniform,
    "choice": Choice,
}
_REQUIRED_FIELDS = {
    "normal": ("mean", "sigma"),
    "truncated-normal": ("mean", "sigma"),
    "uniform": ("low", "high"),
    "choice": ("values",),
}


def distribution(key: str, table: Any) -> Distribution:
    """Build the distribution of a scenario key from its table in the campaign file.

    Raises
    ------
    InputError
        If the table is not valid; the field is ``dispersions.KEY``.
    """
    path = f"dispersions.{key}"
    if not isinstance(table, Mapping):
        raise InputError(path, table, "must be a table with a kind: " + ", ".join(KINDS))
    values = dict(table)
    kind = values.pop("kind", None)
    if not isinstance(kind, str) or kind not in KINDS:
        if kind is None:
            known = f"Known names: {', '.join(KINDS)}."
            raise InputError(f"{path}.kind", kind, "is required", known, show_value=False)
        raise InputError(f"{path}.kind", kind, "is unknown", suggestion(str(kind), KINDS))
    for name in _REQUIRED_FIELDS[kind]:
        if name not in values:
            raise InputError(
                f"{path}.{name}", None, f"is required for kind {kind!r}", show_value=False
            )
    made: Distribution = build_settings(path, KINDS[kind], values, kind)
    return made


def parse_distributions(table: Any) -> dict[str, Any]:
    """Build the distributions in the table ``[dispersions]``, by scenario key.

    Keys of the table may be dotted or nested.

    Raises
    ------
    InputError
        If a value is not a distribution.
    """
    if not isinstance(table, Mapping):
        raise InputError("dispersions", table, "must be a table")
    found = {}
    for key, value in _distribution_tables(table):
        if key in found:
            raise InputError(
                f"dispersions.{key}", value, "must be given only once, dotted or in a table",
                show_value=False,
            )  # fmt: skip
        found[key] = distribution(key, value)
    return found


def _distribution_tables(table: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return scenario key and table of each distribution in nested tables.

    A distribution is a table with a string `kind`; a value that is not a table is returned too, and
    refused later. `prefix` precedes the keys.
    """
    found = []
    for key, value in table.items():
        name = f"{prefix}{key}"
        inner = isinstance(value, Mapping) and not isinstance(value.get("kind"), str)
        deeper = inner and value and all(isinstance(v, Mapping) for v in value.values())
        found += _distribution_tables(value, f"{name}.") if deeper else [(name, value)]
    return found


def build_settings(path: str, settings_class: type, table: Any, kind: str = "") -> Any:
    """Build and check a settings object from its table in the campaign file.

    `path` is the name of the table, "" for the top level, and `kind` the value of its key `kind`.

    Raises
    ------
    InputError
        Naming the first invalid field.
    """
    if not isinstance(table, Mapping):
        raise InputError(path, table, "must be a table")
    model = settings_of(settings_class)
    try:
        return model.model_validate(dict(table)).make()
    except ValidationError as error:
        raise input_error(path, model, error, None, kind) from None
    except InputError as error:
        raise error.with_field(f"{path}.{error.field}") from None
