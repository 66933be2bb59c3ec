"""Measure the saving from shared paths of flights that differ only in policy."""

from __future__ import annotations

import time
from typing import Any

from bench_parts.common import ROOT

# Scenario, policies, number of indices.
_CASES = (
    ("hard", ("no-divert", "nearest-safe", "fuel-aware", "safest"), 4),
    ("hirise", ("no-divert", "nearest-safe", "fuel-aware", "safest"), 4),
)


def paths() -> None:
    """Time flights of several policies that share a path until their decisions differ."""
    from lunarsim.campaign.flight_execution import build_plan
    from lunarsim.campaign.spec import CampaignSpec

    for name, policies, flights in _CASES:
        path = ROOT / "scenarios" / f"{name}.toml"
        factors = {"policy": list(policies)}
        spec = CampaignSpec.from_dict(
            {"scenario": str(path), "flights": flights + 1, "seed": 21, "factors": factors}
        )
        study = build_plan(spec).work.study
        shared = apart = 0.0
        for index in range(flights + 1):
            one, other = _processor_times(study, index, len(policies))
            if index:  # the first index includes late imports
                shared, apart = shared + one, apart + other
        each = flights * len(policies)
        print(
            f"  {name}, {len(policies)} policies, truth known: {shared / each:.2f} s of core time "
            f"per flight with shared paths, {apart / each:.2f} s without: {apart / shared:.1f} "
            f"times"
        )


def _processor_times(study: Any, index: int, arms: int) -> tuple[float, float]:
    """Return the processor times of one flight with all policies, s.

    The first time is with a path shared until the decisions differ, the second without.
    `index` is the number of the flight and `arms` the number of policies.
    """
    from dataclasses import replace

    from lunarsim.campaign.flight_execution import fly
    from lunarsim.campaign.plan import Group

    memory: dict[Any, Any] = {}
    group, alone = Group(index, tuple(range(arms))), replace(study, paths=())
    fly(alone, group, 0, memory)  # computes world and truth
    took = []
    for known in (study, alone):
        began = time.process_time()
        rows = [fly(known, group, arm, memory) for arm in group.arms]
        took.append(time.process_time() - began)
        assert len(rows) == arms
    return took[0], took[1]
