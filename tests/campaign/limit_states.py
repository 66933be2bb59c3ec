"""Limit states that are known in closed form, one flight each: all that a worker has to load."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from lunarsim.rng import flight_seed

EAST, NORTH = "start.position_m.0", "start.position_m.1"


BETA = float(-ndtri(1e-4))


def scores(draws):
    """Return independent normal scores of both keys."""
    return np.array([(draws[EAST] + 600.0) / 10.0, ndtri((draws[NORTH] + 5.0) / 10.0)], dtype=float)


def chance(study, draws):
    """Return a normal number that the world of a flight alone decides."""
    return np.random.default_rng(flight_seed(study.seed, draws["world"])).standard_normal()


def linear(study, group, arm, memory):
    """Beyond BETA once in 10,000, whatever the world."""
    score = float(scores(group.draws).sum() / np.sqrt(2.0))
    return {"safe": score < BETA, "slope_deg": score}


def noisy(study, group, arm, memory):
    """As `linear`, 0.36 of the variance being the world's."""
    score = float(0.8 * scores(group.draws).sum() / np.sqrt(2.0) + 0.6 * chance(study, group.draws))
    return {"safe": score < BETA, "slope_deg": score}


def rugged(study, group, arm, memory):
    """As `linear`, 0.9 of the variance being the world's."""
    own, world = scores(group.draws).sum() / np.sqrt(2.0), chance(study, group.draws)
    score = float(np.sqrt(0.1) * own + np.sqrt(0.9) * world)
    return {"safe": score < BETA, "slope_deg": score}


def curved(study, group, arm, memory):
    """Fails on two sides of a parabola; see `test_two_sides_...` for how often."""
    a, b = scores(group.draws)
    return {"safe": True, "slope_deg": float(abs(a) + 0.2 * b * b)}


def stepped(study, group, arm, memory):
    return {"safe": True, "slope_deg": float(round(scores(group.draws)[0] > 2.5))}


def patchy(study, group, arm, memory):
    """Raises for one flight in ten, gives no slope for another."""
    if group.flight % 10 == 3:
        raise ValueError("no")
    row = linear(study, group, arm, memory)
    return row | ({"slope_deg": None} if group.flight % 10 == 4 else {})


def clipped(study, group, arm, memory):
    """At the limit or beyond it, half of the flights each."""
    return {"safe": True, "slope_deg": max(0.0, float(scores(group.draws)[0]))}


def certain(study, group, arm, memory):
    return {"safe": False, "slope_deg": 1.0}
