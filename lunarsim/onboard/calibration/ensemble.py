"""Ensemble of regressions fitted to all worlds and to all but one.

Worlds differ in more than their features, and the number of sites of one world does not predict
the next world. Each fit leaves one world out (a relief, a rock distribution, a lander, a range).
The reported probability is the minimum over the fits, reduced by a margin on the log odds and by a
floor on the probability of an unsafe site. It decreases wherever all fits decrease.

It is a frequency where every fit classifies a site as almost certainly safe, or every fit as almost
certainly unsafe: then no single world decides. In between, a single world nearly always decides,
and that may change in either direction with any feature. No frequency is claimed there, even where
the fits agree, because worse evidence could otherwise enter a region of higher probability. No site
there reaches the threshold of claimed safety. The spread between fits that all classify a site as
safe is no evidence about a world that none of them includes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    ALMOST_CERTAINLY_UNSAFE_P,
    lower_bound_probability,
)
from lunarsim.onboard.calibration.logistic import Logistic
from lunarsim.onboard.calibration.monotone_splines import MonotoneSplineTerm, ensemble_bounds
from lunarsim.typing import Array, BoolArray

# Limit of the weights in a file: features are about 1.
_MAX_WEIGHT = 1e6


@dataclass(frozen=True)
class LogOddsBounds:
    """Minimum and maximum log odds of site safety over the fits of an ensemble.

    Attributes
    ----------
    low, high
        Minimum and maximum log odds of each site (n,).
    """

    low: Array
    high: Array

    def estimate(
        self,
        upper_bound: Array,
        max_unsafe_p: float = ALMOST_CERTAINLY_UNSAFE_P,
        may_be_unsafe: BoolArray | None = None,
    ) -> SafetyEstimate:
        """Return the safety probability of the sites, and whether the fits agree.

        The probability follows from the minimum log odds. The fits agree on a site if its
        probability is at least 0.95, or if the maximum over the fits is at most `max_unsafe_p`.

        Parameters
        ----------
        upper_bound
            Upper bound of the probability (n,).
        max_unsafe_p
            Probability up to which sites count as almost certainly unsafe.
        may_be_unsafe
            Mask of the sites that may count as almost certainly unsafe (n,); omitted: all.
        """
        p = lower_bound_probability(self.low, upper_bound)
        never = expit(self.high) <= max_unsafe_p
        return SafetyEstimate(
            p,
            (p >= ALMOST_CERTAINLY_SAFE_P)
            | (never if may_be_unsafe is None else never & may_be_unsafe),
        )


@dataclass(frozen=True)
class SafetyEstimate:
    """Safety probability of sites (n,), and whether the fits of the ensemble agree.

    Attributes
    ----------
    p
        Probability that each site is safe (n,): the minimum over the fits, reduced by margins.
    agreed
        Whether all fits agree that the site is almost certainly safe, or almost certainly unsafe
        (n,).
    """

    p: Array
    agreed: BoolArray


@dataclass(frozen=True)
class Ensemble:
    """Weights of logistic regressions fitted to all worlds and without each world.

    A world is a set of simulated sites with one relief, rock distribution, lander or range.

    Attributes
    ----------
    weights
        One row per fit, the first to all worlds (fits, features).
    without
        Name of the world that each other fit leaves out (fits - 1,).
    note
        Command that produced the fits.
    """

    weights: tuple[tuple[float, ...], ...]
    without: tuple[str, ...] = ()
    note: str = ""

    @property
    def digest(self) -> str:
        """Identifier of the weights: 16 hexadecimal digits of their SHA-256."""
        return hashlib.sha256(np.array(self.weights, "<f8").tobytes()).hexdigest()[:16]

    def evaluate_log_odds(
        self, free: ArrayLike, terms: Sequence[MonotoneSplineTerm]
    ) -> LogOddsBounds:
        """Return minimum and maximum log odds of sites (n,) over the fits.

        Parameters
        ----------
        free
            Features with weights of any sign, equal for all sites (f,) or for each site (n, f).
        terms
            Monotone terms of the sites; their features follow the free ones.
        """
        w, f = np.array(self.weights), np.asarray(free, dtype=np.float64)
        count = f.shape[-1]
        return LogOddsBounds(*ensemble_bounds(terms, f @ w[:, :count].T, w[:, count:]))

    def evaluate_features(self, features: ArrayLike) -> LogOddsBounds:
        """Return minimum and maximum log odds (n,) over the fits, from features (n, k)."""
        odds = np.asarray(features, dtype=np.float64) @ np.array(self.weights).T
        return LogOddsBounds(odds.min(axis=1), odds.max(axis=1))

    @classmethod
    def fit(
        cls,
        features: ArrayLike,
        outcome: ArrayLike,
        worlds: Mapping[str, BoolArray],
        note: str = "",
        *,
        rising: int = 0,
        start: Ensemble | None = None,
    ) -> Ensemble:
        """Fit logistic regressions to all sites, and to all sites except each world's.

        Parameters
        ----------
        features, outcome, note, rising
            Features (n, k); whether each site was safe (n,); command that produces the fit; number
            of last features whose weights are non-negative.
        worlds
            Mask of the sites of each world (n,), by its name. Worlds without sites are ignored.
        start
            Ensemble whose weights are the initial values of the iteration; omitted: zero weights.
        """
        x, y = np.asarray(features, dtype=np.float64), np.asarray(outcome)
        named = {name: inside for name, inside in worlds.items() if inside.any()}
        begin = {} if start is None else dict(zip(start.without, start.weights[1:], strict=True))
        first = None if start is None else start.weights[0]
        full_fit = Logistic.fit(x, y, rising=rising, start=first)
        fits = [full_fit]
        for name, inside in named.items():
            first = begin.get(name, full_fit.weights)
            fits.append(Logistic.fit(x[~inside], y[~inside], rising=rising, start=first))
        return cls(tuple(f.weights for f in fits), tuple(named), note)

    # --- files ----------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write the weights of all fits to a JSON file."""
        rows = ",\n".join(f"  {json.dumps(row)}" for row in self.weights)
        head = f'"note": {json.dumps(self.note)},\n "without": {json.dumps(self.without)}'
        atomic_write_text(path, f'{{\n {head},\n "weights": [\n{rows}\n ]\n}}\n')

    @classmethod
    def load(cls, path: Path, features: int, rising: int = 0) -> Ensemble:
        """Read an ensemble of regressions from a JSON file written by `save`.

        Parameters
        ----------
        path
            Path of the file.
        features, rising
            Number of weights per fit, and number of non-negative weights at its end.

        Raises
        ------
        InputError
            If the file is missing, is not a calibration, or has invalid numbers.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                "calibration", str(path), f"must be a readable calibration file ({error})"
            ) from None
        return cls._parsed(text, str(path), features, rising)

    @classmethod
    def packaged(cls, name: str, features: int, rising: int = 0) -> Ensemble:
        """Read the ensemble supplied with lunarsim in the JSON file `name`.

        The file is in the folder of this module. `features` is the number of weights per fit,
        `rising` the number of last weights that are non-negative.
        """
        text = (resources.files("lunarsim.onboard.calibration") / name).read_text(encoding="utf-8")
        return cls._parsed(text, name, features, rising)

    @classmethod
    def _parsed(cls, text: str, name: str, features: int, rising: int) -> Ensemble:
        try:
            data = json.loads(text)
            weights = tuple(tuple(_weight(w) for w in row) for row in data["weights"])
            worlds = data["without"]
            if not (isinstance(worlds, list) and all(isinstance(w, str) for w in worlds)):
                raise ValueError("its key 'without' must be a list of names")
            note = str(data.get("note", ""))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else error
            raise InputError(
                "calibration", name, f"must be a calibration file ({reason})"
            ) from None
        if len(weights) < 2 or len(weights) != len(worlds) + 1:
            raise InputError(
                "calibration",
                name,
                "must have one list of weights for all worlds, and one for each world in `without`",
            )
        if any(len(row) != features for row in weights):
            raise InputError("calibration", name, f"must have {features} weights per fit")
        if rising and min(min(row[-rising:]) for row in weights) < 0.0:
            raise InputError(
                "calibration",
                name,
                f"must have non-negative weights for the last {rising} features",
            )
        return cls(weights, tuple(worlds), note)


def _weight(value: object) -> float:
    """Return a weight read from a file; reject magnitudes that could overflow sums.

    A `ValueError` is raised if the value is not a number of magnitude at most 10^6.
    """
    if (
        isinstance(value, bool)
        or not isinstance(value, float | int)
        or not abs(value) <= _MAX_WEIGHT
    ):
        raise ValueError(f"weights must be numbers of magnitude at most {_MAX_WEIGHT:g}")
    return float(value)
