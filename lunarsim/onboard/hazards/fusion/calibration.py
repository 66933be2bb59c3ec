"""The last stage of a fused map: C of p = C[pi exp(-Lambda) prod_i (1 - r_i q_i)].

C is close to the identity and rises with the fused probability. A second map of the same returns
knows no more than the first, so the two are never multiplied; it is a feature of C instead, whose
weight worlds tell that no map is judged on:

    logit C = logit p + clip(a + (b - 1) logit p + c logit q),  b, c >= 0,

with q the second map's probability, and without the last term where it saw nothing.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit

from lunarsim.errors import InputError
from lunarsim.whole_files import read_tagged, write_text_whole

Array = NDArray[np.float64]

# Log odds are taken up to this, and changed by no more than that.
_MOST, _CHANGE = 10.0, 2.0
_FORMAT = "lunarsim fused calibration 1"
_KEYS = ("intercept", "slope", "other")


@dataclass(frozen=True)
class FusedCalibration:
    """Weights of C.

    Attributes
    ----------
    intercept, slope
        a and b; left out, the log odds stay as they are.
    other
        c, of the second map's log odds.

    Raises
    ------
    InputError
        If a weight is no finite number, or `slope` or `other` negative.
    """

    intercept: float = 0.0
    slope: float = 1.0
    other: float = 0.0

    def __post_init__(self) -> None:
        for name in _KEYS:
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"calibration.{name}", value, "a number")
            if not np.isfinite(value):
                raise InputError(f"calibration.{name}", value, "a finite number")
        for name in ("slope", "other"):
            if getattr(self, name) < 0.0:
                raise InputError(
                    f"calibration.{name}", getattr(self, name),
                    "at least 0: better evidence never makes a site less safe",
                )  # fmt: skip

    def probability(self, p: ArrayLike, other: ArrayLike, seen: ArrayLike) -> NDArray[np.float32]:
        """Return C (...); where `p` is 0 it stays so.

        Parameters
        ----------
        p, other
            Probabilities of the fused map and of the second one (...).
        seen
            Where the second one saw the ground (...).
        """
        own = np.asarray(p, np.float32)
        x, y = _log_odds(own), np.where(seen, _log_odds(other), 0.0)
        change = self.intercept + (self.slope - 1.0) * x + self.other * y
        changed = expit(x + np.clip(change, -_CHANGE, _CHANGE)).astype(np.float32)
        return np.where((own > 0.0) & (change != 0.0), changed, own)

    @classmethod
    def fit(
        cls,
        p: ArrayLike,
        other: ArrayLike,
        seen: ArrayLike,
        safe: ArrayLike,
        unsafe: ArrayLike,
        *,
        worth: float = 1.0,
    ) -> FusedCalibration:
        """Fit to kinds of sites by maximum likelihood, drawn to the identity as by one site.

        Parameters
        ----------
        p, other, seen
            Of each kind (n,), see `probability`.
        safe, unsafe
            Numbers of sites of the kind that are, and are not (n,).
        worth
            What share of a site each counts for: neighbours share their ground.

        Raises
        ------
        InputError
            If there are not both safe and unsafe sites.
        """
        x, y = _log_odds(p), np.where(seen, _log_odds(other), 0.0)
        good, bad = (worth * np.asarray(n, dtype=np.float64) for n in (safe, unsafe))
        if not (good.sum() > 0.0 and bad.sum() > 0.0):
            raise InputError(
                "calibration.safe", (good.sum(), bad.sum()), "both safe and unsafe sites"
            )
        identity = np.array([0.0, 1.0, 0.0])
        columns = np.column_stack((np.ones_like(x), x, y))

        def loss(w: Array) -> tuple[float, Array]:
            odds = columns @ w
            chance = expit(odds)
            value = good @ np.logaddexp(0.0, -odds) + bad @ np.logaddexp(0.0, odds)
            slope = columns.T @ (chance * (good + bad) - good)
            off = w - identity
            return float(value + 0.5 * off @ off), np.asarray(slope + off)

        bounds = [(None, None), (0.0, None), (0.0, None)]
        found = minimize(loss, identity, jac=True, method="L-BFGS-B", bounds=bounds)
        return cls(*(float(w) for w in found.x))

    def save(self, path: Path) -> None:
        """Write as JSON, whole or not at all."""
        write_text_whole(path, json.dumps({"format": _FORMAT, **asdict(self)}, indent=1) + "\n")

    @classmethod
    def load(cls, path: Path) -> FusedCalibration:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, is another one, or a number in it will not do.
        """
        data = read_tagged(path, "calibration", _FORMAT)
        missing = [key for key in _KEYS if key not in data]
        if missing:
            raise InputError("calibration", str(path), f"a file that gives {', '.join(missing)}")
        return cls(**{key: data[key] for key in _KEYS})


def _log_odds(p: ArrayLike) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(np.clip(logit(np.asarray(p, dtype=np.float64)), -_MOST, _MOST))
