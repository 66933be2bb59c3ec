"""Logistic regression: from what a map says of a site to the probability that it is safe."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit

from lunarsim.errors import InputError

Array = NDArray[np.float64]

# Ridge on the coefficients, so that a feature that separates the data does not run away.
_RIDGE = 1e-5


@dataclass(frozen=True)
class Logistic:
    """Weights, and where they come from.

    Attributes
    ----------
    weights
        One a feature.
    note
        The command that measured them.
    """

    weights: tuple[float, ...]
    note: str = ""

    def probability(self, features: ArrayLike) -> Array:
        """Return the probability (n,) of features (n, k)."""
        return np.asarray(expit(np.asarray(features) @ np.array(self.weights)))

    @classmethod
    def fit(
        cls, features: ArrayLike, outcome: ArrayLike, note: str = "", *, rising: int = 0
    ) -> Logistic:
        """Fit features (n, k) to outcomes (n,) by maximum likelihood.

        The weights of the last `rising` features are kept from falling below 0.

        Raises
        ------
        InputError
            If all outcomes are the same.
        """
        x, y = np.asarray(features, dtype=np.float64), np.asarray(outcome, dtype=np.float64)
        if not 0.0 < y.mean() < 1.0:
            raise InputError("calibration.safe", float(y.mean()), "both safe and unsafe sites")

        def loss(w: Array) -> tuple[float, Array]:
            z = x @ w
            value = np.mean(np.logaddexp(0.0, z) - y * z) + 0.5 * _RIDGE * w @ w
            return float(value), x.T @ (expit(z) - y) / len(y) + _RIDGE * w

        start = np.zeros(x.shape[1])
        if rising == 0:
            found = minimize(loss, start, jac=True, method="BFGS")
        else:
            bounds = [(None, None)] * (len(start) - rising) + [(0.0, None)] * rising
            found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
        return cls(tuple(float(w) for w in found.x), note)

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path, features: int) -> Logistic:
        """Read what `save` wrote, for so many features."""
        return cls._parsed(path.read_text(encoding="utf-8"), str(path), features)

    @classmethod
    def packaged(cls, package: str, name: str, features: int) -> Logistic:
        """Read a file that comes with a package."""
        text = (resources.files(package) / name).read_text(encoding="utf-8")
        return cls._parsed(text, name, features)

    @classmethod
    def _parsed(cls, text: str, name: str, features: int) -> Logistic:
        try:
            data = json.loads(text)
            model = cls(tuple(float(w) for w in data["weights"]), str(data.get("note", "")))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError("calibration", name, f"a calibration file ({error})") from None
        if len(model.weights) != features:
            raise InputError("calibration", name, f"{features} weights, one a feature")
        return model
