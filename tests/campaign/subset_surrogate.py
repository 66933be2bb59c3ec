"""Limit states that are known in closed form, as flights of subset simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import norm

from lunarsim.campaign.flying import plan_of
from lunarsim.campaign.plan import Plan, Work
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.rng import flight_seed
from tests.worlds import TINY_FLIGHT

EAST, NORTH = "start.position_m.0", "start.position_m.1"


LAWS = {
    EAST: {"kind": "normal", "mean": -600.0, "sigma": 10.0},
    NORTH: {"kind": "uniform", "low": -5.0, "high": 5.0},
}


BETA = float(norm.isf(1e-4))


COLUMNS = {"safe": "bool", "slope_deg": "float"}


def spec(flights: int = 300, seed: int = 1, **more: object) -> CampaignSpec:
    given = {
        "name": "s", "flights": flights, "seed": seed, "scenario": TINY_FLIGHT, "method": "subset",
        "dispersions": LAWS, "subset": {"metric": "slope_deg", "above": BETA},
    }  # fmt: skip
    return CampaignSpec.from_dict(given | more)


def scores(draws):
    """Return independent normal scores of both keys."""
    return np.array(
        [(draws[EAST] + 600.0) / 10.0, norm.ppf((draws[NORTH] + 5.0) / 10.0)], dtype=float
    )


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


def planned(function: str, flights: int = 300, seed: int = 1, **more: object) -> Plan:
    plan = plan_of(spec(flights, seed, **more))
    work = Work(f"tests.campaign.subset_surrogate:{function}", plan.work.study)
    return replace(plan, work=work, columns=COLUMNS)
