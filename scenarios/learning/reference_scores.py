"""Compute reference scores of lunarsim's agents in every environment.

    python scenarios/learning/reference_scores.py
    python scenarios/learning/reference_scores.py --episodes 20 --only Guidance-v1

All agents of an environment fly the same episodes; the score is the return without shaping terms.
`optimal` is the guidance law that re-solves the minimum-propellant problem in flight. With
perception "truth" the true safety of each site is known: losses of a policy there do not come from
its map.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import lunarsim_envs
from lunarsim import InputError, Scenario
from lunarsim.errors import suggestion
from lunarsim.scenario.shipped import found
from lunarsim_envs.descent.core import flat_scenario
from lunarsim_envs.evaluation.episodes import EvaluationStudy
from lunarsim_envs.evaluation.parallel import fly
from lunarsim_envs.evaluation.results import AgentMetrics, agent_metrics

# Pool for site selection; no training flies a world of the split "test".
_WORLDS = {"worlds": 24, "split": "test", "observation": ["to_go"]}
POLICIES = ("no-divert", "safest", "nearest-safe", "fuel-aware", "few-sites", "ppo-sites")
AGENTS = {
    "Guidance-v1": ("zero", "random", "hover", "polynomial", "apollo", "optimal", "ppo"),
    "Control-v1": ("zero", "random", "hover", "apollo", "ppo-control"),
    "Retarget-v1, surrogate": ("random", *POLICIES),
    "Retarget-v1, truth": ("random", *POLICIES),
}


def study_of(name: str, seed: int) -> EvaluationStudy:
    """Return the settings of the evaluation in an environment; `name` is in `AGENTS`."""
    env, _, perception = name.partition(", ")
    if not perception:
        return EvaluationStudy(f"lunarsim/{env}", flat_scenario(), {"split": "test"}, seed)
    few = Scenario.load(found(Path("few_sites")))
    return EvaluationStudy(f"lunarsim/{env}", few, _WORLDS | {"perception": perception}, seed)


def score_row(env: str, metrics: AgentMetrics) -> str:
    """Format the scores of one agent as a row of the Markdown table.

    `env` is the name of the environment.
    """
    return (
        f"| {env} | `{metrics.name}` | {metrics.score.text(3)} | {metrics.safe} | "
        f"{metrics.propellant.text(1)} | {metrics.steps.value:.0f} |"
    )


def main() -> int:
    """Fly the agents in each environment and print a table of their scores."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=100, help="number of episodes per agent")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed from which all random numbers derive"
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel processes")
    parser.add_argument(
        "--only",
        action="append",
        help="environment to run; repeat the option for several environments (default: all)",
    )
    args = parser.parse_args()
    assert lunarsim_envs.__name__
    try:
        for field, least in (("episodes", 1), ("seed", 0), ("jobs", 1)):
            if getattr(args, field) < least:
                raise InputError(f"--{field}", getattr(args, field), f"must be {least} or more")
        for name in args.only or ():
            if name not in AGENTS:
                raise InputError("--only", name, "is unknown", suggestion(name, AGENTS))
        print("| environment | agent | score [95 % interval] | safe landings [95 % interval] | "
        "propellant of safe landings (kg) |"
              " steps |\n| --- | --- | --- | --- | --- | --- |", flush=True)  # fmt: skip
        for name in args.only or AGENTS:
            rows = fly(study_of(name, args.seed), AGENTS[name], args.episodes, args.jobs)
            for agent in agent_metrics(rows, args.seed):
                print(score_row(name, agent), flush=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
