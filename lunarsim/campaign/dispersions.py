"""Dispersions of a campaign: distributions of scenario values, sampling designs.

Every draw starts from one number in (0, 1) per key. Plain Monte Carlo takes it from a stream of
the flight's own seed, so flight i draws the same values in every campaign. Latin hypercube and
Sobol designs (`scipy.stats.qmc`) fix the number of flights. Keys may be correlated by a Gaussian
copula, whose matrix is that of the normal scores.

A Saltelli design gives Sobol indices (Saltelli et al. 2010, table 2). Its flights come in blocks:
point A, A with key k as in B for each key, A in the world of B, point B. The world of a flight
(rocks, noise, navigation errors) is an additional factor; otherwise the indices of the keys would
include part of the effect of chance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.special import ndtr, ndtri
from scipy.stats import qmc, truncnorm

from lunarsim.campaign.subset_settings import SubsetSettings
from lunarsim.errors import InputError, suggestion
from lunarsim.parts import quantity, settings_of
from lunarsim.rng import RandomStreams, design_seed, flight_seed
from lunarsim.scenario.errors import input_error
from lunarsim.scenario.renamed_keys import first_path
from lunarsim.typing import Array

METHODS = ("monte-carlo", "latin-hypercube", "sobol", "saltelli", "importance", "subset")
# Methods whose flights depend on their index only, so that flights can be added later.
EXTENSIBLE_METHODS = ("monte-carlo", "importance")
# Methods that take the numbers of a flight from the flight's own streams.
_STREAM_METHODS = (*EXTENSIBLE_METHODS, "subset")
# Draws stay this far from 0 and 1, where normal scores are infinite.
_MIN_PROBABILITY = 2.0**-53
_SCALE_REMEDY = "A scale below 1 misses failures on every side."
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
    of: type = KINDS[kind]
    model = settings_of(of)
    try:
        made: Distribution = model.model_validate(values).make()
    except ValidationError as error:
        raise input_error(path, model, error, None, kind) from None
    except InputError as error:
        raise error.with_field(f"{path}.{error.field}") from None
    return made


@dataclass(frozen=True)
class Correlation:
    """Group of scenario keys whose normal scores are correlated (Gaussian copula).

    Attributes
    ----------
    keys
        Two or more keys.
    matrix
        Correlation matrix of the keys: symmetric, positive definite, unit diagonal.
    """

    keys: tuple[str, ...] = quantity(())
    matrix: tuple[tuple[float, ...], ...] = quantity(())

    def __post_init__(self) -> None:
        if len(self.keys) < 2 or len(set(self.keys)) < len(self.keys):
            raise InputError("keys", list(self.keys), "must be two or more different keys")
        try:
            matrix = np.array(self.matrix, dtype=np.float64)
        except ValueError:
            matrix = np.zeros(())
        given = [list(row) for row in self.matrix]
        count = len(self.keys)
        if matrix.shape != (count, count):
            raise InputError(
                "matrix", given, f"must be {count} rows of {count} numbers, one per key"
            )
        for i, j in zip(*np.triu_indices(count), strict=True):
            value, mirrored = float(matrix[i, j]), float(matrix[j, i])
            if i == j and not np.isclose(value, 1.0, atol=0.0):
                raise InputError(
                    f"matrix[{i}][{i}]", value, "must be 1, the correlation of a key with itself"
                )
            if value != mirrored:
                raise InputError(
                    f"matrix[{i}][{j}]", value,
                    f"must be {mirrored}, as in matrix[{j}][{i}], because the matrix is symmetric",
                )  # fmt: skip
        least = float(np.linalg.eigvalsh(matrix)[0])
        if least <= 1e-10:
            raise InputError(
                "matrix",
                given,
                f"must be positive definite, but its minimum eigenvalue is {least:.3g}",
                "Decrease the correlations.",
                show_value=False,
            )

    @cached_property
    def cholesky_factor(self) -> Array:
        """Lower Cholesky factor of the correlation matrix."""
        return np.asarray(np.linalg.cholesky(np.array(self.matrix)))


@dataclass(frozen=True)
class Importance:
    """Proposal distribution of importance sampling, for rare failures.

    Normal scores z of the keys (independent, before correlations) are drawn from a mixture: with
    probability `nominal_share` the nominal z, else shift + scale z. The weight of a flight is the
    ratio of the nominal density to the mixture density, which is at most 1 / nominal_share for any
    shifts.

    Attributes
    ----------
    shifts, scales
        Shift (sigmas) and scale by key; omitted: 0 and 1. Scales below 1 are refused: only the
        mixture would bound the ratio of the densities.
    nominal_share
        Fraction of flights drawn from the nominal distribution.
    """

    shifts: Mapping[str, float] | None = quantity(None)
    scales: Mapping[str, float] | None = quantity(None)
    nominal_share: float = quantity(
        0.1, ge=0.01, lt=1, help="fraction of flights that are drawn from the nominal distribution"
    )

    def __post_init__(self) -> None:
        for name, table in (("shifts", self.shifts), ("scales", self.scales)):
            for key, value in (table or {}).items():
                low = -8.0 if name == "shifts" else 1.0
                if not low <= value <= 8.0:
                    raise InputError(
                        name, value,
                        f"must be between {low:g} and 8, but that of {key} is {value:g}",
                        _SCALE_REMEDY if name == "scales" else "", show_value=False,
                    )  # fmt: skip
        shifts, scales = self.shifts or {}, self.scales or {}
        if not any(shifts.values()) and all(v == 1.0 for v in scales.values()):
            raise InputError(
                "shifts",
                dict(shifts),
                "must contain a shift other than 0 if all scales are 1",
                show_value=False,
            )

    def sample(self, keys: Sequence[str], uniforms: Array, is_nominal: bool) -> tuple[Array, float]:
        """Return the quantile levels of a flight's values (d,), and the flight's weight.

        `keys` are the keys of the dispersions (d,), `uniforms` independent random numbers in (0, 1)
        (d,); `is_nominal` states whether the flight is drawn from the nominal distribution.
        """
        shift = np.array([(self.shifts or {}).get(key, 0.0) for key in keys])
        scale = np.array([(self.scales or {}).get(key, 1.0) for key in keys])
        z = ndtri(uniforms) if is_nominal else shift + scale * ndtri(uniforms)
        log_ratio = np.sum(
            0.5 * (z**2 - ((z - shift) / scale) ** 2) - np.log(scale)
        )  # of the shifted density to the nominal one
        share = self.nominal_share
        return ndtr(z), float(1.0 / (share + (1.0 - share) * np.exp(log_ratio)))


@dataclass(frozen=True)
class Dispersions:
    """Random scenario values of each flight of a campaign, and how they are sampled.

    Attributes
    ----------
    distributions
        Distributions by key of the scenario, in the order of the spec.
    correlations
        Groups of correlated keys; a key is in at most one group.
    method, seed, flights
        Sampling method; root seed; number of flights, used only by methods that draw all flights
        together (Latin hypercube, Sobol, Saltelli; with method subset: flights per level).
    importance, subset
        Settings of the method of the same name; None with any other method.
    """

    distributions: Mapping[str, Distribution]
    correlations: tuple[Correlation, ...] = ()
    method: str = "monte-carlo"
    seed: int = 1
    flights: int = 1
    importance: Importance | None = None
    subset: SubsetSettings | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError("method", self.method, "is unknown", suggestion(self.method, METHODS))
        if self.method != "monte-carlo" and not self.distributions:
            raise InputError(
                "method", self.method, 'must be "monte-carlo" without a table [dispersions]',
                "Add [dispersions] or change the method.",
            )  # fmt: skip
        if self.method == "saltelli":
            self._check_blocks()
        self._check_importance()
        self._check_subset()
        seen: set[str] = set()
        for i, group in enumerate(self.correlations):
            for key in group.keys:
                field = f"correlations.{i}.keys"
                if key not in self.distributions:
                    raise InputError(
                        field, key, "must be keys of [dispersions]",
                        suggestion(key, self.distributions),
                    )  # fmt: skip
                if isinstance(self.distributions[key], Choice):
                    raise InputError(
                        field, key, "must be keys whose values have an order, not of kind 'choice'"
                    )
                if key in seen:
                    raise InputError(
                        field, key, "must be keys that are in no other [[correlations]]"
                    )
                seen.add(key)

    def _check_importance(self) -> None:
        self._check_table("importance", self.importance is not None)
        if self.importance is not None:
            for name in ("shifts", "scales"):
                for key in getattr(self.importance, name) or {}:
                    if key not in self.distributions:
                        raise InputError(
                            f"importance.{name}",
                            key,
                            "must have keys of [dispersions]",
                            suggestion(key, self.distributions),
                        )

    def _check_table(self, name: str, is_given: bool) -> None:
        """Check that the table of a sampling method is given if and only if it is used.

        `name` is the method and its table. Otherwise an `InputError` is raised.
        """
        if (self.method == name) == is_given:
            return
        problem = (
            f"is allowed only with method = {name!r}, but method is {self.method!r}"
            if is_given
            else f"is required with method = {name!r}"
        )
        remedy = f"Delete [{name}]." if is_given else f"Add a table [{name}]."
        raise InputError(name, self.method, problem, remedy, show_value=False)

    def _check_subset(self) -> None:
        self._check_table("subset", self.subset is not None)
        if self.subset is not None:
            self.subset.check_flights(self.flights)

    def _check_blocks(self) -> None:
        if self.correlations:
            keys = list(self.correlations[0].keys)
            raise InputError(
                "correlations", keys,
                "must be omitted with method = 'saltelli', which needs independent keys",
                "Or use another method: PAWN sensitivity indices allow correlations.",
                show_value=False,
            )  # fmt: skip
        blocks, rest = divmod(self.flights, self.block)
        if rest or blocks < 2 or blocks & (blocks - 1):
            below = 1 << max(1, blocks.bit_length() - 1)
            raise InputError(
                "flights", self.flights,
                f"must be a power of two (2 or more) times {self.block}, the number of dispersed "
                "keys "
                f"plus 3: for instance {self.block * below} or {2 * self.block * below}",
            )  # fmt: skip

    @property
    def block(self) -> int:
        """Number of flights in a block of a Saltelli design; 0 for other methods."""
        return len(self.distributions) + 3 if self.method == "saltelli" else 0

    def draws(self, flight: int) -> dict[str, Any]:
        """Return the random scenario values of a flight by key.

        With method subset these are the values of the nominal distribution.
        """
        return self.at(self._weighted_uniforms(flight)[0])

    def at(self, probabilities: Array) -> dict[str, Any]:
        """Return the scenario values by key at independent `probabilities` (d,)."""
        u = dict(zip(self.distributions, _clip_to_open_interval(probabilities), strict=True))
        for group in self.correlations:
            scores = group.cholesky_factor @ ndtri([u[key] for key in group.keys])
            u |= dict(zip(group.keys, _clip_to_open_interval(ndtr(scores)), strict=True))
        return {key: law.at(float(u[key])) for key, law in self.distributions.items()}

    def weight(self, flight: int) -> float:
        """Return the weight of a flight: 1 except for importance sampling."""
        return self._weighted_uniforms(flight)[1]

    def _weighted_uniforms(self, flight: int) -> tuple[Array, float]:
        """Return the quantile level of each key's value (d,), and the flight's weight."""
        u = self.uniforms(flight)
        if self.importance is None:
            return u, 1.0
        rng = RandomStreams(flight_seed(self.seed, flight)).get("importance")
        nominal = bool(rng.random() < self.importance.nominal_share)
        shifted, weight = self.importance.sample(list(self.distributions), u, nominal)
        return _clip_to_open_interval(shifted), weight

    def uniforms(self, flight: int) -> Array:
        """Return a uniform number in (0, 1) for each key (d,), before importance sampling."""
        if self.method in _STREAM_METHODS:
            streams = RandomStreams(flight_seed(self.seed, flight))
            drawn = [
                streams.get(f"dispersions.{first_path(key)}").random() for key in self.distributions
            ]
            return _clip_to_open_interval(np.array(drawn))
        return _clip_to_open_interval(self._design[flight])

    @cached_property
    def _design(self) -> Array:
        """Numbers in (0, 1) of all flights and keys in a sampling design (flights, keys)."""
        rng = np.random.default_rng(design_seed(self.seed))
        count = len(self.distributions)
        if self.method == "saltelli":
            return _saltelli_rows(qmc.Sobol(2 * count, rng=rng).random(self.flights // self.block))
        if self.method == "sobol":
            return np.asarray(qmc.Sobol(count, rng=rng).random(self.flights))
        return np.asarray(qmc.LatinHypercube(count, rng=rng).random(self.flights))


def world_index(flight: int, block: int) -> int:
    """Return the index of the flight whose seed, and therefore world, a flight uses.

    Without a Saltelli design, this is the flight itself.

    Parameters
    ----------
    flight
        Index of the flight.
    block
        Flights per block of a Saltelli design; 0 for other methods.
    """
    if not block:
        return flight
    number, place = divmod(flight, block)
    return 2 * number + (place >= block - 2)


def _saltelli_rows(points: Array) -> Array:
    """Return the points of a Saltelli design from Sobol points A and B (n, 2 d).

    The result is (n (d + 3), d): `d` is the number of keys, and each of the n blocks has d + 3
    flights.
    """
    a, b = np.hsplit(points, 2)
    keys = a.shape[1]
    rows = np.repeat(a[:, None, :], keys + 3, axis=1)
    for k in range(keys):
        rows[:, 1 + k, k] = b[:, k]
    rows[:, -1] = b
    return np.asarray(rows.reshape(-1, keys))


def _clip_to_open_interval(u: Array) -> Array:
    return np.clip(u, _MIN_PROBABILITY, 1.0 - _MIN_PROBABILITY)
