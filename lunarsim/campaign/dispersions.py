"""Dispersions of a campaign: random scenario values and sampling designs.

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
from scipy.special import ndtr, ndtri

from lunarsim.campaign.distributions import (
    Choice,
    Distribution,
    build_settings,
    parse_distributions,
)
from lunarsim.campaign.factors import flatten_keys
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.flight_metrics import COLUMNS
from lunarsim.parts import quantity
from lunarsim.rng import RandomStreams, design_seed, flight_seed
from lunarsim.scenario.renamed_keys import first_path
from lunarsim.typing import Array

METHODS = ("monte-carlo", "latin-hypercube", "sobol", "saltelli", "importance", "subset")
# Methods whose flights depend on their index only, so that flights can be added later.
EXTENSIBLE_METHODS = ("monte-carlo", "importance")
# Methods that take the numbers of a flight from the flight's own streams.
_STREAM_METHODS = (*EXTENSIBLE_METHODS, "subset")
# Draws stay this far from 0 and 1, where normal scores are infinite.
_MIN_PROBABILITY = 2.0**-53
# Minimum number of chains per level of a subset simulation; fewer do not show the spread between
# chains.
_MIN_CHAINS = 10
_SCALE_REMEDY = "A scale below 1 misses failures on every side."


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
            return self._stream_uniforms(RandomStreams(flight_seed(self.seed, flight)))
        return _clip_to_open_interval(self._design[flight])

    def draws_of(self, streams: RandomStreams) -> dict[str, Any]:
        """Return the random scenario values by key from the random streams of one flight."""
        return self.at(self._stream_uniforms(streams))

    def _stream_uniforms(self, streams: RandomStreams) -> Array:
        """Return a uniform number in (0, 1) for each key (d,) from a flight's streams."""
        names = [f"dispersions.{first_path(key)}" for key in self.distributions]
        return _clip_to_open_interval(np.array([streams.get(name).random() for name in names]))

    @cached_property
    def _design(self) -> Array:
        """Numbers in (0, 1) of all flights and keys in a sampling design (flights, keys)."""
        from scipy.stats import qmc  # noqa: PLC0415  (slow to load)

        rng = np.random.default_rng(design_seed(self.seed))
        count = len(self.distributions)
        if self.method == "saltelli":
            return _saltelli_rows(qmc.Sobol(2 * count, rng=rng).random(self.flights // self.block))
        if self.method == "sobol":
            return np.asarray(qmc.Sobol(count, rng=rng).random(self.flights))
        return np.asarray(qmc.LatinHypercube(count, rng=rng).random(self.flights))


def build_dispersions(
    tables: Mapping[str, Any], method: str, seed: int, flights: int
) -> Dispersions:
    """Build the random distributions of a campaign from the tables of its file.

    The tables may also come from the identity in a campaign folder's manifest.

    Raises
    ------
    InputError
        Naming the first invalid field.
    """
    laws = parse_distributions(tables.get("dispersions") or {})
    groups, importance, subset = (tables.get(n) for n in ("correlations", "importance", "subset"))
    if not isinstance(groups, list | None):
        raise InputError(
            "correlations", groups, "must be tables [[correlations]], each with keys and matrix"
        )
    correlations = tuple(
        build_settings(f"correlations.{i}", Correlation, table)
        for i, table in enumerate(groups or ())
    )
    if isinstance(importance, Mapping):
        importance = {
            name: flatten_keys(value, f"importance.{name}", (int, float))
            if name in ("shifts", "scales")
            else value
            for name, value in importance.items()
        }
    return Dispersions(
        laws, correlations, method, seed, flights,
        None if importance is None else build_settings("importance", Importance, importance),
        None if subset is None else build_settings("subset", SubsetSettings, subset),
    )  # fmt: skip


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
