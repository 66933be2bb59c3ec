"""Logistic regression of the safety of sites on features of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.typing import Array

# Maximum number of Newton steps, and minimum decrease of the loss for another step.
_MAX_NEWTON_STEPS, _MIN_LOSS_DECREASE = 60, 1e-9
# Ridge penalty, so that the weight of a feature that separates the data stays finite.
_RIDGE = 1e-5


@dataclass(frozen=True)
class Logistic:
    """Logistic regression: weights of features in the log odds of a safe site.

    Attributes
    ----------
    weights
        One weight per feature (k,).
    """

    weights: tuple[float, ...]

    def probability(self, features: ArrayLike) -> Array:
        """Return the probability of safety (n,) from the features of sites (n, k)."""
        return np.asarray(expit(np.asarray(features) @ np.array(self.weights)))

    @classmethod
    def fit(
        cls,
        features: ArrayLike,
        outcome: ArrayLike,
        *,
        rising: int = 0,
        start: ArrayLike | None = None,
    ) -> Logistic:
        """Fit a logistic regression of outcomes (n,) on features (n, k).

        The fit is by maximum likelihood; `outcome` is whether each site was safe.

        The weights of the last `rising` features are non-negative. The iteration starts at the
        weights `start` (k,), which must satisfy these bounds; without `start`, it starts at 0.

        Raises
        ------
        InputError
            If all outcomes are equal.
        """
        x, y = np.asarray(features, dtype=np.float64), np.asarray(outcome, dtype=np.float64)
        if not 0.0 < y.mean() < 1.0:
            raise InputError(
                "calibration.safe",
                float(y.mean()),
                "must include both safe and unsafe sites, but all sites are equal",
                show_value=False,
            )

        lower_bounds = np.r_[np.full(x.shape[1] - rising, -np.inf), np.zeros(rising)]
        w = np.zeros(x.shape[1]) if start is None else np.asarray(start, dtype=np.float64)
        before = np.inf
        for _ in range(_MAX_NEWTON_STEPS):
            loss, gradient, curvature = _likelihood(x, y, w)
            if before - loss < _MIN_LOSS_DECREASE:
                break
            before, w = loss, _newton_step(x, y, w, lower_bounds, loss, gradient, curvature)
        # Rounding leaves weights slightly below their bounds.
        return cls(tuple(float(v) for v in np.maximum(w, lower_bounds)))


def _likelihood(x: Array, y: Array, w: Array) -> tuple[float, Array, Array]:
    """Return the mean loss with a ridge penalty, its gradient and its Hessian.

    `x` (n, k) are the features, `y` (n,) the outcomes, `w` (k,) the weights.
    """
    p = expit(x @ w)
    gradient = x.T @ (p - y) / len(y) + _RIDGE * w
    curvature = (x.T * (p * (1.0 - p) / len(y))) @ x
    curvature[np.diag_indices_from(curvature)] += _RIDGE
    return _loss(x, y, w), gradient, curvature


def _loss(x: Array, y: Array, w: Array) -> float:
    z = x @ w
    return float(np.mean(np.logaddexp(0.0, z) - y * z) + 0.5 * _RIDGE * w @ w)


def _newton_step(
    x: Array,
    y: Array,
    w: Array,
    lower_bounds: Array,
    loss: float,
    gradient: Array,
    curvature: Array,
) -> Array:
    """Return the weights (k,) after a bounded Newton step with backtracking.

    `x` (n, k) are the features, `y` (n,) the outcomes, `w` (k,) the current weights, and
    `lower_bounds` (k,) their bounds; `loss`, `gradient` and `curvature` are the result of
    `_likelihood`. If no step reduces the loss, `w` is returned.
    """
    root = cholesky(curvature)
    aim = root @ w - solve_triangular(root, gradient, trans="T")
    step = lsq_linear(root, aim, (lower_bounds, np.inf), method="bvls").x - w
    share = 1.0
    while share > 1e-6 and _loss(x, y, w + share * step) > loss:
        share *= 0.5
    return np.asarray(w + share * step if share > 1e-6 else w)
