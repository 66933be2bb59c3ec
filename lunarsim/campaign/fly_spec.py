"""Fly the flights that a campaign specification defines into a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lunarsim.atomic_files import atomic_write_text
from lunarsim.campaign.cache import DiskCache
from lunarsim.campaign.engines.contract import Engine
from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.campaign.flight_execution import build_plan, check_first_flights
from lunarsim.campaign.kernel_compilation import compile_kernels
from lunarsim.campaign.manifest import matching_manifest
from lunarsim.campaign.run import RunResult, run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.campaign.stopping import IntervalWidthRule


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
