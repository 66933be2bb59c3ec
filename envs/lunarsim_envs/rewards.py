"""Reward terms, each a short named function."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward terms.

    Attributes
    ----------
    safe, unsafe
        At the end of the flight, for a safe or any other end.
    propellant
        For each kilogram burnt since the last decision.
    invalid
        For choosing a site that is not available (the present one is kept).
    """

    safe: float = 1.0
    unsafe: float = -1.0
    propellant: float = -0.005
    invalid: float = -0.05


def reward_terms(
    weights: RewardWeights, *, ended: bool, safe: bool, burnt: float, invalid: bool
) -> dict[str, float]:
    """Return every term by name; their sum is the reward."""
    return {
        "touchdown": (weights.safe if safe else weights.unsafe) if ended else 0.0,
        "propellant": weights.propellant * burnt,
        "invalid": weights.invalid if invalid else 0.0,
    }
