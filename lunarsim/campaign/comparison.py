"""Compare policies or guidance laws over the same worlds, as a small campaign.

Flight i of every policy has the same world, start, sensor noise and navigation errors. They derive
from the root seed and i only, so the number of processes does not change any bit.
"""

from __future__ import annotations

import itertools
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import lunarsim
from lunarsim.atomic_files import atomic_write, atomic_write_text
from lunarsim.campaign.cache import DiskCache
from lunarsim.campaign.dispersions import Dispersions
from lunarsim.campaign.engines.contract import Engine
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine
from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.campaign.factors import Arm
from lunarsim.campaign.fly_spec import fly_spec
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import MAX_FLIGHTS
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import RunResult
from lunarsim.campaign.spec import CampaignSettings, CampaignSpec
from lunarsim.errors import InputError, check_folder
from lunarsim.onboard.policies.contract import RetargetingPolicy
from lunarsim.parts import resolve
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_values

Progress = Callable[[int], None]


@dataclass(frozen=True)
class CompareResult:
    """Result of a comparison of policies or guidance laws over the same flights.

    Attributes
    ----------
    rows
        One dictionary per flight and policy, sorted by flight, then policy; columns as in
        `lunarsim.campaign.rows`.
    seconds
        Wall-clock time of each flight, by policy, s.
    safe_share, safe_share_at_heading
        Mean fraction of the target area that is truly safe to land on: at every heading of the
        lander, and at the heading that is flown.
    complete
        False if the run was interrupted.
    failed
        Rows without an outcome: the code raised an error, or the process died.
    unrecorded
        Reason why flights have no record or plots, for instance a full disk; empty if all have.
    by_law
        Whether guidance laws are compared; rows are then identified by arm, not by policy.
    without_flights
        Names of the policies or laws that have no row, because the run was interrupted.
    """

    rows: list[dict[str, Any]]
    seconds: dict[str, list[float]]
    safe_share: float
    safe_share_at_heading: float
    complete: bool
    failed: list[dict[str, Any]]
    unrecorded: str = ""
    by_law: bool = False
    without_flights: Sequence[str] = ()

    @property
    def shown(self) -> list[dict[str, Any]]:
        """Result rows with the name that tables and plots use in the column `policy`.

        An arm is a variant of the scenario. If guidance laws are compared, this is the name of the
        arm, a pair of policy and law.
        """
        return [row | {"policy": row["arm"]} for row in self.rows] if self.by_law else self.rows


def policy_name(policy: str | RetargetingPolicy) -> str:
    """Return the name of a policy for tables and folders, without its module."""
    name = policy if isinstance(policy, str) else policy.name
    return name.rpartition(":")[2] if ":" in name else name


def guidance_name(law: str) -> str:
    """Return the name of a guidance law for tables and folders, without its module."""
    return law.rpartition(":")[2]


def check_request(
    policies: Sequence[str | RetargetingPolicy],
    flights: int,
    jobs: int,
    guidance: Sequence[str] = (),
) -> None:
    """Raise `InputError` if the arguments of `compare` are not usable.

    `guidance` are names of guidance laws; empty: the scenario's law.
    """
    for law in guidance:
        resolve("guidance", law, "--guidance")
    laws = [guidance_name(law) for law in guidance]
    if len(set(laws)) < len(laws):
        raise InputError("--guidance", ",".join(laws), "must name each guidance law only once")
    for policy in policies:
        if isinstance(policy, str):
            resolve("policy", policy, "--policies")
        elif not (hasattr(policy, "decide") and isinstance(getattr(policy, "name", None), str)):
            raise InputError(
                "policies",
                policy,
                "must be names, or objects with `name` and `decide(observation)`",
            )
    if flights > MAX_FLIGHTS:
        raise InputError("--flights", flights, f"must be at most {MAX_FLIGHTS:,}")
    if not policies:
        raise InputError(
            "--policies",
            "",
            "must name at least one policy",
            "List all policies: `lunarsim parts policy`.",
            show_value=False,
        )
    names = [policy_name(policy) for policy in policies]
    if len(set(names)) < len(names):
        raise InputError("--policies", ",".join(names), "must name each policy only once")
    if flights < 1:
        raise InputError("--flights", flights, "must be 1 or more")
    if jobs < 1:
        raise InputError("--jobs", jobs, "must be 1 or more")


def compare(
    scenario: Scenario,
    policies: Sequence[str | RetargetingPolicy],
    *,
    flights: int,
    seed: int,
    jobs: int = 1,
    out: Path | None = None,
    progress: Progress | None = None,
    figures: bool = True,
    cache: DiskCache | None = None,
    notify: Callable[[str], None] | None = None,
    separate_process: bool = False,
    guidance: Sequence[str] = (),
) -> CompareResult:
    """Fly the same flights under each policy, and with each guidance law if given.

    Parameters
    ----------
    scenario
        Scenario to fly.
    policies
        Policies: names, "module:Class", or objects (picklable if `jobs` is above 1).
    flights, seed, jobs
        Flights per policy, root seed, processes.
    out
        Folder for all results: new, or of the same comparison, which is then resumed. Omitted:
        nothing is kept. `results.parquet` holds all rows in one file.
    progress, figures
        Function called with the number of flights finished since the last call; whether to draw
        the first flight of each policy and the comparison.
    cache, notify
        Cache of worlds, and function that receives messages for the user; as in
        `lunarsim.campaign.fly_spec.fly_spec`.
    separate_process
        Whether a single job runs in a separate process; several jobs always do.
    guidance
        Guidance laws, each flown under every policy: names or "module:Class", with their default
        settings (the scenario's settings for the law that the scenario uses). Empty: the
        scenario's law.

    Raises
    ------
    InputError
        If the scenario, an argument or the folder is not usable; nothing has been written then.
    """
    check_request(policies, flights, jobs, guidance)
    if scenario.computer is not None and len(policies) * max(len(guidance), 1) > 1:
        raise InputError(
            "computer.kind", scenario.computer.kind,
            "must be omitted, because it replaces the policies and guidance laws to compare",
        )  # fmt: skip
    spec = _comparison_spec(scenario, policies, flights, seed, figures, guidance)
    if out is not None and not (out / "manifest.json").exists():
        check_folder(out)
    separate_process = separate_process or jobs > 1
    by_law = bool(guidance)
    engine: Engine = LocalEngine(min(jobs, flights)) if separate_process else InlineEngine()
    if separate_process:
        for policy in policies:
            check_picklable("policies", policy)
    fly = partial(fly_spec, engine=engine, progress=progress, cache=cache, notify=notify)
    if out is None:
        with tempfile.TemporaryDirectory(prefix="lunarsim-") as folder:
            spec_here = spec.with_settings(records="none", figures=False)
            return _fly_and_compare(spec_here, fly, Path(folder), None, by_law)
    return _fly_and_compare(spec, fly, out, out, by_law)


def _fly_and_compare(
    spec: CampaignSpec, fly: Callable[..., RunResult], folder: Path, out: Path | None, by_law: bool
) -> CompareResult:
    """Fly a campaign into `folder`; write the summary and plots into `out`, if given.

    `fly` is `fly_spec` without its arguments `spec` and `out`; `by_law` states whether guidance
    laws are compared.
    """
    run = fly(spec, out=folder)
    result = _read_result(folder, run, by_law, [arm.name for arm in spec.arms])
    if out is not None and result.rows:
        _write_result(result, out, spec)
        if spec.head.figures:
            from lunarsim.viz import draw_comparison  # noqa: PLC0415

            draw_comparison(result.shown, spec.scenario, out / "figures" / "comparison.png")
    return result


def _comparison_spec(
    scenario: Scenario,
    policies: Sequence[str | RetargetingPolicy],
    flights: int,
    seed: int,
    figures: bool,
    guidance: Sequence[str] = (),
) -> CampaignSpec:
    """Return a campaign with one arm for each combination of policy and guidance law.

    An arm is a variant of the scenario.
    """
    arms = []
    for policy, law in itertools.product(policies, guidance or (None,)):
        name = policy_name(policy)
        values: dict[str, Any] = {"policy": policy} if isinstance(policy, str) else {}
        if law is not None:
            name = guidance_name(law) if len(policies) == 1 else f"{name}, {guidance_name(law)}"
            values["guidance"] = law
        changed = with_values(scenario, values, "policies") if values else scenario
        arms.append(Arm(name, values, changed, None if isinstance(policy, str) else policy))
    head = CampaignSettings(scenario.name, flights, seed, records="all", figures=figures)
    return CampaignSpec(head, scenario, tuple(arms), Dispersions({}, seed=seed, flights=flights))


def _read_result(folder: Path, run: RunResult, by_law: bool, arms: Sequence[str]) -> CompareResult:
    """Read the results of a comparison from the folder of its campaign.

    `run` summarises the run; `by_law` states whether guidance laws are compared; `arms` are the
    names of all policies or laws.
    """
    found = load_results(folder)  # works without any flight, after an early interrupt
    rows = found.table.to_pylist()
    seconds = {time["id"]: time["seconds"] for time in found.timing.to_pylist()}
    flown = [row for row in rows if row["outcome"] == FLOWN]
    apart = "arm" if by_law else "policy"
    names = dict.fromkeys(row[apart] for row in flown)
    shares = {row["flight"]: row for row in flown}.values()
    return CompareResult(
        rows=flown,
        seconds={n: [seconds[r["id"]] for r in flown if r[apart] == n] for n in names},
        safe_share=_mean([row["safe_share"] for row in shares]),
        safe_share_at_heading=_mean([row["safe_share_at_heading"] for row in shares]),
        complete=run.complete,
        without_flights=[arm for arm in arms if arm not in names],
        failed=[row for row in rows if row["outcome"] != FLOWN],
        unrecorded=run.unrecorded,
        by_law=by_law,
    )


def _mean(values: list[float]) -> float:
    """Return the mean; NaN for an empty list."""
    return float(np.mean(values)) if values else float("nan")


def _write_result(result: CompareResult, out: Path, spec: CampaignSpec) -> None:
    """Write all results to one Parquet file and a summary to JSON, atomically."""
    table = pa.Table.from_pylist(result.rows, pq.read_schema(next((out / "results").iterdir())))
    atomic_write(out / "results.parquet", lambda p: pq.write_table(table, p))
    summary = {
        "scenario": spec.scenario.name,
        "seed": spec.head.seed,
        "version": lunarsim.__version__,
        "complete": result.complete,
        "without_outcome": len(result.failed),
        "exactly_safe_share": result.safe_share,
        "exactly_safe_share_at_heading": result.safe_share_at_heading,
        "seconds_per_flight": {p: _mean(s) for p, s in result.seconds.items()},
    }
    atomic_write_text(out / "summary.json", json.dumps(summary, indent=1))
