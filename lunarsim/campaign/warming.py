"""Kernels compiled once, before workers start that would all compile them at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from lunarsim.campaign.cache import DiskCache
from lunarsim.campaign.engines.local import LocalEngine, WorkersDieError
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import Group, Plan
from lunarsim.campaign.spec import CampaignSpec

# Compilation may take so much longer than a flight, s.
_COMPILING = 900.0


def warm(spec: CampaignSpec, plan: Plan, cache: DiskCache, say: Callable[[str], None]) -> None:
    """Fly flight 0 of arms that choose parts which no campaign on this machine has flown yet.

    Its results are thrown away; the kernels stay, in Numba's cache beside the package. What is
    done is marked in the cache, so that this takes no time the next time.

    Parameters
    ----------
    spec, plan
        What is going to be flown.
    cache
        Where it is marked.
    say
        Told what is done and how long it took.
    """
    cold = {}
    for i, arm in enumerate(spec.arms):
        parts = "kernels " + repr(_without_numbers(arm.scenario.to_dict()))
        if parts not in cold and not cache.has_mark(parts):
            cold[parts] = i
    if not cold:
        return
    say(f"compiling kernels, once for this machine and code: {len(cold)} flights are flown for it")
    began = time.perf_counter()
    study = replace(plan.work.study, out=None, records="none", figures=False)
    limit = None if spec.head.time_limit is None else spec.head.time_limit + _COMPILING
    group = Group(0, tuple(cold.values()), plan.draws(0))
    work = replace(plan.work, study=study)
    try:
        done = list(LocalEngine(1, limit).fly(work, [group], lambda: False))
    except WorkersDieError:
        return  # the campaign will meet the same, and tell
    flown = {one.arm for one in done if one.outcome == FLOWN}
    for parts, index in cold.items():
        if index in flown:
            cache.mark(parts)
    say(f"kernels are ready after {time.perf_counter() - began:.0f} s")


def _without_numbers(table: Any) -> Any:
    """Return tables with texts and switches alone: numbers choose no kernel."""
    if isinstance(table, Mapping):
        return {k: _without_numbers(v) for k, v in sorted(table.items())}
    if isinstance(table, list | tuple):
        return len(table)
    return table if isinstance(table, bool | str) else None
