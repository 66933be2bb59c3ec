"""Compile kernels once, before several workers compile them at the same time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from lunarsim.campaign.cache import DiskCache
from lunarsim.campaign.engines.local import LocalEngine, WorkerStartError
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import Group, Plan
from lunarsim.campaign.spec import CampaignSpec

# Additional time limit for compilation, s.
_COMPILATION_TIME_S = 900.0


def compile_kernels(
    spec: CampaignSpec, plan: Plan, cache: DiskCache, notify: Callable[[str], None]
) -> None:
    """Compile the numerical kernels of a campaign by flying flight 0 of some arms.

    These are the arms whose components no campaign on this machine has flown yet.

    The results are discarded; the compiled kernels stay in Numba's cache beside the package. A mark
    in the cache makes later calls return immediately. An arm is a variant of the scenario.

    Parameters
    ----------
    spec, plan
        Spec and flights of the campaign.
    cache
        Cache that holds the marks.
    notify
        Function that receives messages for the user.
    """
    cold = {}
    for i, arm in enumerate(spec.arms):
        parts = "kernels " + repr(_texts_and_flags(arm.scenario.to_dict()))
        if parts not in cold and not cache.has_mark(parts):
            cold[parts] = i
    if not cold:
        return
    notify(f"Compiling kernels, once per machine and code version: {len(cold)} flights.")
    began = time.perf_counter()
    study = replace(plan.work.study, out=None, records="none", figures=False)
    limit = None if spec.head.time_limit is None else spec.head.time_limit + _COMPILATION_TIME_S
    group = Group(0, tuple(cold.values()), plan.draws(0))
    work = replace(plan.work, study=study)
    try:
        done = list(LocalEngine(1, limit).fly(work, [group], lambda: False))
    except WorkerStartError:
        return  # the campaign will raise the same error
    flown = {one.arm for one in done if one.outcome == FLOWN}
    for parts, index in cold.items():
        if index in flown:
            cache.mark(parts)
    notify(f"Kernels are ready after {time.perf_counter() - began:.0f} s.")


def _texts_and_flags(table: Any) -> Any:
    """Return nested tables with their strings and booleans only.

    Numbers are dropped, because they do not select kernels.
    """
    if isinstance(table, Mapping):
        return {k: _texts_and_flags(v) for k, v in sorted(table.items())}
    if isinstance(table, list | tuple):
        return len(table)
    return table if isinstance(table, bool | str) else None
