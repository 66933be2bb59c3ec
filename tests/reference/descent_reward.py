"""The reward of a descent in arrays over landers, with NumPy only."""

from __future__ import annotations

import numpy as np


def potential(y, target, weights, lander, gravity):
    """Return the shaping potential (n,) of states (n, 15) with targets (n, 3)."""
    away = y[:, :3] - target
    away[:, 2] = np.maximum(away[:, 2] - lander.com_height, 0.0)
    brakes = 0.38 * (lander.thrust_max / lander.wet_mass - gravity)
    time = 4.0 + np.sqrt(np.linalg.norm(away, axis=1) / (2.0 * brakes))
    away[:, 2] += 4.0 * 0.4 * lander.vertical_speed_limit
    away[:, :2] *= (1.0 + 6.0 / time)[:, None]
    error = np.linalg.norm(y[:, 3:6] + away / time[:, None], axis=1)
    rate = np.linalg.norm(y[:, 10:13], axis=1) / lander.rate_limit
    return -weights.shaping * (
        np.log1p(error / lander.horizontal_speed_limit) + 4.0 / time * np.log1p(rate)
    )


def _excess(motion, lander):
    """Return the excess (n,) of vertical and horizontal speed, tilt and rate (n, 4)."""
    limits = np.array(
        [lander.vertical_speed_limit, lander.horizontal_speed_limit, lander.tilt_limit,
         lander.rate_limit]
    )  # fmt: skip
    folds = np.log(np.maximum(np.abs(motion) / limits, 1.0))
    return np.where(np.isfinite(folds), np.minimum(folds, 3.0), 3.0).sum(axis=1)


def terms(moved, y, target, landed, lost, safe, motion, before, weights, craft):
    """Return the reward terms (n,) of a step by name, with 0 where `moved` (n,) is false.

    `landed`, `lost` (ended without touchdown) and `safe` (n,) say how flights have ended; `motion`
    (n, 4) has vertical and horizontal speed, tilt and rate at touchdown. `before` is mass and
    potential before the step, (n,) each, and `craft` the `VehicleParams`.
    """
    w, lander, over, crash = weights, craft.dynamics.lander, landed | lost, landed & ~safe
    mass, last = before
    after = np.where(over, 0.0, potential(y, target, w, lander, craft.dynamics.gravity))
    miss = np.linalg.norm(y[:, :2] - target[:, :2], axis=1)
    far = max(np.linalg.norm(craft.start[:3]), 1.0)
    severity = np.minimum(np.linalg.norm(y[:, :3] - target, axis=1) / far, 1.0)
    found = {
        "touchdown": safe * w.safe + crash * w.crash + lost * w.no_landing,
        "propellant": -w.propellant * (mass - y[:, 13]),
        "miss": np.where(safe, -w.miss * np.minimum(miss, 50.0), 0.0),
        "excess": np.where(crash, -w.excess * _excess(motion, lander), 0.0),
        "severity": np.where(crash, -w.severity * severity, 0.0),
        "shaping": after - last,
    }
    return {name: np.where(moved, term, 0.0) for name, term in found.items()}
