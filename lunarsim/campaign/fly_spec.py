"""Fly the flights that a campaign specification defines into a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from lunarsim.atomic_files import atomic_write_text
from lunarsim.campaign.cache import DiskCache
from lunarsim.campaign.engines.contract import Engine
from lunarsim.campaign.engines.local import LocalEngine, WorkerStartError
from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.campaign.flight_execution import build_plan, check_first_flights
from lunarsim.campaign.manifest import matching_manifest
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import Group, Plan
from lunarsim.campaign.run import IntervalWidthRule, RunResult, run
from lunarsim.campaign.spec import CampaignSpec

# Additional time limit for compilation, s.
_COMPILATION_TIME_S = 900.0


def fly_spec(
    spec: CampaignSpec,
    engine: Engine,
    out: Path,
    *,
    retry: bool = False,
    progress: Callable[[int], None] | None = None,
    cache: DiskCache | None = None,
    notify: Callable[[str], None] | None = None,
) -> RunResult:
    """Fly the flights of a campaign that a folder does not contain yet.

    Parameters
    ----------
    spec, engine, out
        Specification of the campaign, engine that runs the flights, and folder of results.
    retry, progress
        Whether to repeat flights without an outcome; function called with the number of new rows.
    cache
        Cache of the true landing safety of terrains; results do not depend on it.
    notify
        Function that receives messages while kernels are compiled first, by one process. Without
        it, without a cache, or with another engine than local, each worker compiles its kernels.

    Raises
    ------
    InputError
        If the first flight of an arm cannot be flown or sent to worker processes, or the folder
        belongs to another campaign; nothing has been written then.
    """
    plan = build_plan(spec, out, cache)
    if matching_manifest(out, plan) is None:
        check_first_flights(spec)
    if engine.name == "local":
        for arm in spec.arms:
            check_picklable(f"arm {arm.name!r}", arm.policy or arm.scenario)
        check_picklable("campaign", plan.work)
    if cache is not None and notify is not None and engine.name == "local":
        compile_kernels(spec, plan, cache, notify)
    stop = spec.stop
    rule = None if stop is None else IntervalWidthRule(stop.metric, stop.width, len(spec.arms))
    return run(
        plan, engine, out, rule=rule, time_budget=spec.head.time_budget, retry=retry,
        progress=progress, files=lambda folder: write_files(spec, folder),
    )  # fmt: skip


def write_files(spec: CampaignSpec, folder: Path) -> None:
    """Write a campaign specification and its base scenario as TOML files."""
    texts = {"scenario.toml": spec.scenario.to_toml()}
    if all(arm.policy is None for arm in spec.arms):
        texts["spec.toml"] = spec.to_toml()
    for name, text in texts.items():
        atomic_write_text(folder / name, text)


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
