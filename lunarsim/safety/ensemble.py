"""Regressions fitted to all worlds and to all but one: what a single world decides is not known.

Worlds differ in more than their features say, and no count of sites of one world tells how the
next will be. Each fit leaves one world out (a relief, a rock law, a lander, a range). What is told
is the lowest of them, less a margin on the odds and the little that no world can tell: it falls
wherever all of them do.

It is a frequency where every fit calls a site surely safe, or every fit surely not: then no world
by itself decides. In between there is nearly always one that does, and whether there is may change
with any feature either way; so no frequency is claimed there at all, even where fits happen to
agree: else worse evidence could enter where more is told; and nothing there counts as surely safe.
How near fits lie to each other where all call a site safe says little of a world that none of them
has seen.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.safety.bends import Term, extremes
from lunarsim.safety.logistic import Logistic

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# A world unlike all others may double the odds that a site is unsafe.
MARGIN = float(np.log(2.0))
# Half of the worlds of the fits have fewer than 750 sites that are surely safe. Among so many, a
# world in which one of 250 is unsafe, whatever the evidence, shows none in one case of twenty: no
# site is told to be safer than that leaves.
UNTOLD = 0.004
# Sites are surely safe from this probability on, and surely not up to that.
SURE, HOPELESS = 0.95, 0.05
# No fit gives a feature, which is about 1, more log odds than this.
_HEAVIEST = 1e6


@dataclass(frozen=True)
class Odds:
    """What the fits say of sites (n,).

    Attributes
    ----------
    low, high
        Least and greatest log odds.
    """

    low: Array
    high: Array

    def verdict(
        self, most: Array, hopeless: float = HOPELESS, doomed: BoolArray | None = None
    ) -> Verdict:
        """Return what is told of the sites (n,).

        Parameters
        ----------
        most
            None is safer than this (n,).
        hopeless
            Sites are surely not safe up to this probability.
        doomed
            Where they may be called so at all (n,); left out: anywhere.
        """
        p = told(self.low, most)
        never = expit(self.high) <= hopeless
        return Verdict(p, (p >= SURE) | (never if doomed is None else never & doomed))


@dataclass(frozen=True)
class Verdict:
    """What is told of sites (n,).

    Attributes
    ----------
    p
        Probability that they are safe: the lowest.
    agreed
        Where every fit calls them surely safe, or every one surely not.
    """

    p: Array
    agreed: BoolArray


def told(low: Array, most: Array, margin: float = MARGIN) -> Array:
    """Return the probability (n,) by the lowest log odds (n,) less a margin, at most `most`.

    `UNTOLD` of it is taken off.
    """
    return np.asarray(np.minimum((1.0 - UNTOLD) * expit(low - margin), most))


def doubted(low: Array, most: Array, least: Array, margin: float) -> Array:
    """Return the probability of sites (n,) where it is no frequency: never more than `SURE`.

    Parameters are those of `cautious`.
    """
    return np.asarray(SURE * np.minimum(told(low, most, margin), least))


def cautious(
    low: Array, most: Array, least: Array, known: BoolArray, margin: float = MARGIN
) -> Array:
    """Return the probability of sites (n,): as told where surely safe, else no more than a bound.

    Parameters
    ----------
    low
        Lowest log odds (n,).
    most, least
        What it cannot exceed anywhere, and where it is no frequency (n,).
    known
        Where the fits have seen the like (n,).
    margin
        Of the log odds where it is no frequency.
    """
    plain = told(low, most)
    return np.where(known & (plain >= SURE), plain, doubted(low, most, least, margin))


@dataclass(frozen=True)
class Ensemble:
    """Weights of several regressions on the same features.

    Attributes
    ----------
    weights
        One row a fit, the first to all worlds (fits, features).
    without
        The world that each other fit was made without (fits - 1,).
    note
        The command that measured them.
    """

    weights: tuple[tuple[float, ...], ...]
    without: tuple[str, ...] = ()
    note: str = ""

    @property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that tell these weights from others."""
        return hashlib.sha256(np.array(self.weights, "<f8").tobytes()).hexdigest()[:16]

    def judge(self, free: ArrayLike, terms: Sequence[Term]) -> Odds:
        """Return what the fits say of sites.

        Parameters
        ----------
        free
            Features on which weights have any sign, of all sites (f,) or each (n, f).
        terms
            What speaks for and against the sites; their features follow the free ones.
        """
        w, f = np.array(self.weights), np.asarray(free, dtype=np.float64)
        count = f.shape[-1]
        return Odds(*extremes(terms, f @ w[:, :count].T, w[:, count:]))

    def of_features(self, features: ArrayLike) -> Odds:
        """Return what the fits say of sites with features (n, k)."""
        odds = np.asarray(features, dtype=np.float64) @ np.array(self.weights).T
        return Odds(odds.min(axis=1), odds.max(axis=1))

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
        """Fit features (n, k) to outcomes (n,), to all and to all without each world.

        Parameters
        ----------
        features, outcome, note, rising
            As for `Logistic.fit`.
        worlds
            Which sites belong to a world (n,), by its name. One without any site says nothing.
        start
            Where steps begin; left out, at 0. It saves time where fits are alike.
        """
        x, y = np.asarray(features, dtype=np.float64), np.asarray(outcome)
        named = {name: inside for name, inside in worlds.items() if inside.any()}
        begin = {} if start is None else dict(zip(start.without, start.weights[1:], strict=True))
        first = None if start is None else start.weights[0]
        whole = Logistic.fit(x, y, rising=rising, start=first)
        fits = [whole]
        for name, inside in named.items():
            first = begin.get(name, whole.weights)
            fits.append(Logistic.fit(x[~inside], y[~inside], rising=rising, start=first))
        return cls(tuple(f.weights for f in fits), tuple(named), note)

    # --- files ----------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write as JSON, a fit a line."""
        rows = ",\n".join(f"  {json.dumps(row)}" for row in self.weights)
        head = f'"note": {json.dumps(self.note)},\n "without": {json.dumps(self.without)}'
        path.write_text(f'{{\n {head},\n "weights": [\n{rows}\n ]\n}}\n', encoding="utf-8")

    @classmethod
    def load(cls, path: Path, features: int, rising: int = 0) -> Ensemble:
        """Read what `save` wrote.

        Parameters
        ----------
        path
            The file.
        features, rising
            Number of weights of a fit, and of the last of them that are not negative.

        Raises
        ------
        InputError
            If it is missing, is another file, or its numbers will not do.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError("calibration", str(path), f"a calibration file ({error})") from None
        return cls._parsed(text, str(path), features, rising)

    @classmethod
    def packaged(cls, package: str, name: str, features: int, rising: int = 0) -> Ensemble:
        """Read a file that comes with a package; see `load`."""
        text = (resources.files(package) / name).read_text(encoding="utf-8")
        return cls._parsed(text, name, features, rising)

    @classmethod
    def _parsed(cls, text: str, name: str, features: int, rising: int) -> Ensemble:
        try:
            data = json.loads(text)
            weights = tuple(tuple(_weight(w) for w in row) for row in data["weights"])
            worlds = data["without"]
            if not (isinstance(worlds, list) and all(isinstance(w, str) for w in worlds)):
                raise ValueError("without is a list of names")
            note = str(data.get("note", ""))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise InputError("calibration", name, f"a calibration file ({error})") from None
        if len(weights) < 2 or len(weights) != len(worlds) + 1:
            raise InputError("calibration", name, "a fit to all worlds, and one without each named")
        if any(len(row) != features for row in weights):
            raise InputError("calibration", name, f"rows of {features} weights, one a feature")
        if rising and min(min(row[-rising:]) for row in weights) < 0.0:
            raise InputError("calibration", name, f"a last {rising} of weights of at least 0")
        return cls(weights, tuple(worlds), note)


def _weight(value: object) -> float:
    """Return a weight of a file: a number that no sum of features makes overflow."""
    if isinstance(value, bool) or not isinstance(value, float | int) or not abs(value) <= _HEAVIEST:
        raise ValueError(f"weights are numbers of at most {_HEAVIEST:g}")
    return float(value)
