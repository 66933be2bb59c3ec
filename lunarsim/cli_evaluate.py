"""The command of environments and agents: `lunarsim evaluate`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from lunarsim.cli_common import (
    ALLOW_MODULE,
    PATH,
    SEED,
    FloatRange,
    IntRange,
    allow_typed,
    kept_if_interrupted,
    progress_bar,
    wide_console,
)
from lunarsim.errors import InputError, check_folder
from lunarsim.whole_files import filled_whole


@click.command()
@click.argument("env")
@click.option(
    "--agent", "agents", multiple=True, required=True, metavar="NAME|FILE|module:Name",
    help="Who flies; may be repeated.",
)  # fmt: skip
@click.option(
    "--trust-pickle", is_flag=True,
    help="Read agents in .zip files, which can run any code.",
)  # fmt: skip
@click.option(
    "--scenario", type=PATH, default=None, show_default="the environment's own",
    help="A TOML file, or a name of `scenario list`.",
)  # fmt: skip
@click.option(
    "--set", "values", multiple=True, metavar="KEY=VALUE",
    help="Another value of a key of the scenario; may be repeated.",
)  # fmt: skip
@ALLOW_MODULE
@click.option(
    "--perception", default=None, metavar="NAME", show_default="the environment's own",
    help="Of Retarget-v0: onboard, truth, surrogate, gaussian-dem, shadows, quadtree or fused.",
)  # fmt: skip
@click.option(
    "--observation", "parts", multiple=True, metavar="PART", show_default="the environment's own",
    help="A part of the observation that agents were trained on; may be repeated.",
)  # fmt: skip
@click.option(
    "--action", "decided", multiple=True, metavar="PART", show_default="site",
    help="Of Retarget-v0: a part of the action that agents decide on, site or stretch; may be "
    "repeated.",
)  # fmt: skip
@click.option(
    "--episodes", type=IntRange(min=1), default=100, show_default=True, help="Episodes an agent.",
)  # fmt: skip
@SEED
@click.option(
    "--jobs", type=IntRange(min=1), default=os.cpu_count() or 1,
    show_default="number of cores", help="Processes; the results do not depend on it.",
)  # fmt: skip
@click.option(
    "--within", type=FloatRange(min=0.0, min_open=True), default=10.0, show_default=True,
    help="Of the target, m: how near a safe landing is on target.",
)  # fmt: skip
@click.option(
    "--out", type=PATH, default=None, help="New folder for results.parquet and summary.json."
)  # fmt: skip
def evaluate(
    env: str, agents: tuple[str, ...], trust_pickle: bool, scenario: Path | None,
    values: tuple[str, ...], perception: str | None, parts: tuple[str, ...],
    decided: tuple[str, ...], episodes: int, seed: int, jobs: int, within: float, out: Path | None,
) -> None:  # fmt: skip
    """Fly agents over the same episodes of an environment ENV and compare them.

    ENV is Retarget-v0, Guidance-v0, Control-v0, or one of your own: module:namespace/Name-v0. An
    agent is

    \b
      zero, random, hover, polynomial     what is built in
      apollo, e-guidance, ...             `lunarsim parts guidance`; Guidance-v0
      safest, nearest-safe, ...           `lunarsim parts policy`; Retarget-v0
      FILE.npz                            a network, flown by NumPy alone
      FILE.onnx                           an exported network, with the extra `onnx`
      FILE.zip                            of Stable-Baselines3, with --trust-pickle
      module:Name                         any callable: observation, info -> action

    Episode i of every agent has the same world, start and noise. A score is the return minus
    shaping rewards. The table gives shares with 95 % Wilson intervals, means with bootstrap
    intervals, and differences on the same episodes, tested and corrected for their number.
    """  # noqa: D301
    from lunarsim_envs.evaluation.request import study
    from lunarsim_envs.evaluation.results import differences, figures, with_target, write
    from lunarsim_envs.evaluation.running import WorkersDieError, check_agents, fly
    from lunarsim_envs.evaluation.told import agents_table, differences_table

    if within == float("inf"):
        raise InputError("--within", within, "a finite number of metres")
    if out is not None:
        check_folder(out)
    given: dict[str, Any] = {} if perception is None else {"perception": perception}
    given |= {"observation": list(parts)} if parts else {}
    given |= {"action": list(decided)} if decided else {}
    allow_typed(*values)
    asked = replace(study(env, scenario, values, seed, **given), trust_pickle=trust_pickle)
    check_agents(asked, agents)
    console = wide_console(170)
    with (
        kept_if_interrupted("nothing was written"),
        progress_bar(asked.env, episodes * len(agents)) as advance,
    ):
        try:
            rows = with_target(fly(asked, agents, episodes, jobs, advance), within)
        except WorkersDieError as error:
            raise click.ClickException(str(error)) from None
    found, between = figures(rows, seed), differences(rows, seed) if len(agents) > 1 else {}
    if out is not None:
        given |= {"env": asked.env, "episodes": episodes, "seed": seed, "within_m": within}
        with filled_whole(out):
            write(out, rows, given, found, between)
            if asked.scenario is not None:
                asked.scenario.save(out / "scenario.toml")
    console.print(agents_table(found, within))
    if between:
        console.print(differences_table(between))
    if out is not None:
        console.print(f"results in {out}", soft_wrap=True)
