"""From what a site looks like on the quadtree to the probability that it is safe."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit

from lunarsim.errors import InputError

Array = NDArray[np.float64]

# Fewer exceptions than one in so many points cannot be told from none.
_LEAST_RATIO = 1e-4
# Ridge on the coefficients, so that a feature that separates the data does not run away.
_RIDGE = 1e-5


def features(slope: ArrayLike, roughness: ArrayLike, ratio: ArrayLike, near: ArrayLike) -> Array:
    """Return what the probability is computed from (n, 8).

    Parameters
    ----------
    slope, roughness
        Over the limits of the settings (n,): 1 at the limit.
    ratio, near
        Greatest exception ratio in the zone and in its middle (n,).
    """
    slope, roughness = (np.asarray(a, dtype=np.float64) for a in (slope, roughness))
    whole, middle = (
        np.log10(np.maximum(np.asarray(r, dtype=np.float64), _LEAST_RATIO) / _LEAST_RATIO)
        for r in (ratio, near)
    )
    rough = np.log(np.maximum(roughness, 1e-3))
    return np.column_stack(
        (np.ones(len(slope)), whole, middle, slope, rough, whole**2, middle**2, rough**2)
    )


@dataclass(frozen=True)
class SafetyModel:
    """Logistic regression on `features`.

    Attributes
    ----------
    weights
        One a feature.
    note
        Where they come from.
    """

    weights: tuple[float, ...]
    note: str = ""

    def probability(
        self, slope: ArrayLike, roughness: ArrayLike, ratio: ArrayLike, near: ArrayLike
    ) -> Array:
        """Return the probability of landing safely (n,); arguments as in `features`."""
        return np.asarray(expit(features(slope, roughness, ratio, near) @ np.array(self.weights)))

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> SafetyModel:
        """Read what `save` wrote."""
        return cls._parsed(path.read_text(encoding="utf-8"), str(path))

    @classmethod
    @lru_cache(maxsize=1)
    def default(cls) -> SafetyModel:
        """Return the model measured by `scenarios/quadtree_calibration.py`."""
        file = resources.files("lunarsim.hazards.quadtree") / "calibration.json"
        return cls._parsed(file.read_text(encoding="utf-8"), "calibration.json")

    @classmethod
    def _parsed(cls, text: str, name: str) -> SafetyModel:
        try:
            data = json.loads(text)
            model = cls(tuple(float(w) for w in data["weights"]), str(data.get("note", "")))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError("sites.calibration", name, f"a calibration file ({error})") from None
        if len(model.weights) != features([0], [0], [0], [0]).shape[1]:
            raise InputError("sites.calibration", name, "as many weights as there are features")
        return model


def fit_safety(
    slope: ArrayLike,
    roughness: ArrayLike,
    ratio: ArrayLike,
    near: ArrayLike,
    safe: ArrayLike,
    note: str = "",
) -> SafetyModel:
    """Fit a model to sites whose safety is known (n,), by maximum likelihood."""
    x = features(slope, roughness, ratio, near)
    y = np.asarray(safe, dtype=np.float64)
    if not 0.0 < y.mean() < 1.0:
        raise InputError("calibration.safe", float(y.mean()), "both safe and unsafe sites")

    def loss(w: Array) -> tuple[float, Array]:
        z = x @ w
        value = np.mean(np.logaddexp(0.0, z) - y * z) + 0.5 * _RIDGE * w @ w
        return float(value), x.T @ (expit(z) - y) / len(y) + _RIDGE * w

    found = minimize(loss, np.zeros(x.shape[1]), jac=True, method="BFGS")
    return SafetyModel(tuple(float(w) for w in found.x), note)
