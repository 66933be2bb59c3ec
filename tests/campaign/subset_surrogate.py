"""Limit states that are known in closed form, as flights of subset simulation."""

from __future__ import annotations

from dataclasses import replace

from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.plan import Plan, Work
from lunarsim.campaign.spec import CampaignSpec
from tests.campaign.limit_states import BETA, EAST, NORTH
from tests.worlds import TINY_FLIGHT

LAWS = {
    EAST: {"kind": "normal", "mean": -600.0, "sigma": 10.0},
    NORTH: {"kind": "uniform", "low": -5.0, "high": 5.0},
}


COLUMNS = {"safe": "bool", "slope_deg": "float"}


def spec(flights: int = 300, seed: int = 1, **more: object) -> CampaignSpec:
    given = {
        "name": "s", "flights": flights, "seed": seed, "scenario": TINY_FLIGHT, "method": "subset",
        "dispersions": LAWS, "subset": {"metric": "slope_deg", "above": BETA},
    }  # fmt: skip
    return CampaignSpec.from_dict(given | more)


def planned(function: str, flights: int = 300, seed: int = 1, **more: object) -> Plan:
    plan = build_plan(spec(flights, seed, **more))
    work = Work(f"tests.campaign.limit_states:{function}", plan.work.study)
    return replace(plan, work=work, columns=COLUMNS)
