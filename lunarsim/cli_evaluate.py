"""Define the command `lunarsim evaluate` for environments and agents."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from lunarsim.atomic_files import remove_contents_on_error
from lunarsim.cli_common import (
    PATH,
    SEED,
    FloatRange,
    IntRange,
    add_to_interrupt_message,
    allow_named_modules,
    allow_options,
    progress_bar,
    wide_console,
)
from lunarsim.errors import InputError, check_folder


@click.command()
@click.argument("env")
@click.option(
    "--agent", "agents", multiple=True, required=True, metavar="[NAME=]AGENT",
    help="Agent to evaluate, in one of the forms listed above. Repeat the option for each agent.",
)  # fmt: skip
@click.option(
    "--trust-pickle", is_flag=True,
    help="Allow agents in .zip files. They contain Python pickles, which can run any code when "
    "they are loaded.",
)  # fmt: skip
@click.option(
    "--scenario", type=PATH, default=None, show_default="scenario of the environment",
    help="Scenario of the episodes: a TOML file, or a name from `lunarsim scenario list`.",
)  # fmt: skip
@click.option(
    "--set", "values", multiple=True, metavar="KEY=VALUE",
    help="Set a scenario key, for example sun.elevation_deg=5. Repeat the option for several keys.",
)  # fmt: skip
@allow_options
@click.option(
    "--perception", default=None, metavar="NAME", show_default="surrogate",
    help="Source of the hazard map in Retarget-v1: surrogate (statistical model of map errors), "
    "onboard (mappers of the scenario), truth (true safety), or one mapper: gaussian-dem, shadows, "
    "quadtree or fused.",
)  # fmt: skip
@click.option(
    "--dispersions", type=PATH, default=None, show_default="no random values",
    help="Campaign file whose table [dispersions] gives random values of each episode, for example "
    "faults of sensors. For Retarget-v1 with perception onboard.",
)  # fmt: skip
@click.option(
    "--observation", "parts", multiple=True, metavar="PART",
    show_default="observation of the environment",
    help="Component of the observation, for example hazard_map in Retarget-v1. Repeat the option "
    "for each component with which the agents were trained.",
)  # fmt: skip
@click.option(
    "--action", "decided", multiple=True, metavar="PART", show_default="site",
    help="Component of the action in Retarget-v1: site (landing site) or time_scale (factor on the "
    "time-to-go). Repeat the option for each component.",
)  # fmt: skip
@click.option(
    "--split", default=None, metavar="NAME", show_default="test",
    help="Split of the worlds: train, validation or test. No world of one split is a world of "
    "another.",
)  # fmt: skip
@click.option(
    "--worlds", type=IntRange(min=1), default=None, show_default="16 in Retarget-v1, otherwise 1",
    help="Number of worlds (simulated terrains with rocks) of the pool.",
)  # fmt: skip
@click.option(
    "--world-seed", type=IntRange(min=0), default=None, show_default="0",
    help="Root seed of the worlds of the pool.",
)  # fmt: skip
@click.option(
    "--episodes", type=IntRange(min=1), default=100, show_default=True,
    help="Number of episodes per agent.",
)  # fmt: skip
@SEED
@click.option(
    "--jobs", type=IntRange(min=1), default=os.cpu_count() or 1,
    show_default="number of cores",
    help="Number of parallel processes. It does not change the results.",
)  # fmt: skip
@click.option(
    "--within", type=FloatRange(min=0.0, min_open=True), default=10.0, show_default=True,
    help="Distance from the target up to which a landing counts as on target (m).",
)  # fmt: skip
@click.option(
    "--out", type=PATH, default=None,
    help="New folder for results.parquet and summary.json. Default: no files are written."
)  # fmt: skip
def evaluate(
    env: str, agents: tuple[str, ...], trust_pickle: bool, scenario: Path | None,
    values: tuple[str, ...], perception: str | None, dispersions: Path | None,
    parts: tuple[str, ...],
    decided: tuple[str, ...], split: str | None, worlds: int | None, world_seed: int | None,
    episodes: int, seed: int, jobs: int, within: float, out: Path | None,
) -> None:  # fmt: skip
    """Compare agents on identical episodes of an environment.

    ENV is Retarget-v1, Guidance-v1, Control-v1, or a custom environment: module:namespace/Name-v0.
    An agent is one of:

    \b
      zero, random, hover, polynomial     built-in agents
      ppo, ppo-control                    trained networks; Guidance-v1, Control-v1
      ppo-sites, few-sites                trained networks for Retarget-v1
      apollo, e-guidance, ...             `lunarsim parts guidance`; not for Retarget-v1
      safest, nearest-safe, ...           `lunarsim parts policy`; for Retarget-v1
      FILE.npz                            network, evaluated with NumPy only
      FILE.onnx                           exported network; needs the extra `onnx`
      FILE.zip                            Stable-Baselines3 model; needs --trust-pickle
      module:Name                         custom guidance law or policy, or any
                                        callable: observation, info -> action
    A name before the agent, as in wide=out/wide.npz, is its name in the tables.

    Episode i has the same world, start state and noise for every agent. Worlds are those of the
    split "test", which environments do not fly unless they are asked to. The score is the return
    without shaping rewards. The first table gives fractions with 95 % Wilson intervals and means
    with bootstrap intervals. The second gives paired differences. Their intervals (Newcombe,
    bootstrap) hold for one pair each. The p-values (McNemar test, t-test) are corrected for all
    pairs of a metric (Holm). So p can be above 0.05 while an interval excludes zero: rely on p.
    Options must match the training of the agents: --perception,
    --observation, --action and, apart from tests on other terrain, --scenario.

    \b
    Example:
      lunarsim evaluate Guidance-v1 --agent apollo --agent polynomial --episodes 50
    """  # noqa: D301
    from lunarsim.campaign.provenance import environment
    from lunarsim_envs.evaluation.parallel import WorkersDieError, check_request, fly
    from lunarsim_envs.evaluation.request import evaluation_study
    from lunarsim_envs.evaluation.results import add_on_target, agent_metrics, differences, write
    from lunarsim_envs.evaluation.tables import agents_table, differences_table

    if within == float("inf"):
        raise InputError("--within", within, "must be finite")
    if out is not None:
        check_folder(out)
    pool = {"perception": perception, "split": split, "worlds": worlds, "world_seed": world_seed}
    given: dict[str, Any] = {name: value for name, value in pool.items() if value is not None}
    given |= {} if dispersions is None else {"dispersions": str(dispersions)}
    given |= {"observation": list(parts)} if parts else {}
    given |= {"action": list(decided)} if decided else {}
    allow_named_modules(*values)
    asked = replace(
        evaluation_study(env, scenario, values, seed, **given), trust_pickle=trust_pickle
    )
    check_request(asked, agents, episodes)
    console = wide_console(170)
    with (
        add_to_interrupt_message("no file was written"),
        progress_bar(asked.env, episodes * len(agents)) as advance,
    ):
        try:
            rows = add_on_target(fly(asked, agents, episodes, jobs, advance), within)
        except WorkersDieError as error:
            raise click.ClickException(str(error)) from None
    found, between = agent_metrics(rows, seed), differences(rows, seed) if len(agents) > 1 else {}
    if out is not None:
        given |= {"env": asked.env, "episodes": episodes, "seed": seed, "within_m": within}
        given |= {"command": shlex.join(["lunarsim", *sys.argv[1:]]), "environment": environment()}
        with remove_contents_on_error(out):
            write(out, rows, given, found, between)
            if asked.scenario is not None:
                asked.scenario.save(out / "scenario.toml")
    console.print(agents_table(found, within))
    if between:
        console.print(differences_table(between))
    if out is not None:
        console.print(f"results are in {out}", soft_wrap=True)
