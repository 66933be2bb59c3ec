"""Compare agent rankings on the surrogate and the real mapper (held-out terrains).

    python scenarios/learning/ranking.py --flights 300

All site-selecting policies and the agent supplied with lunarsim fly the same episodes twice, on
maps of the surrogate (the fast statistical substitute of the mapper) and of the Gaussian DEM. The
report gives safe-landing rates and propellant on both, the paired difference of mapper and
surrogate, and which agent of each pair is better on either. The two rankings contradict each other
if both intervals exclude zero on opposite sides.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import combinations
from pathlib import Path

import numpy as np
from flights import AgentFlights, fly_agent

import lunarsim_envs
from lunarsim import InputError, Scenario
from lunarsim.evaluation.comparisons import Difference, mean_difference, share_difference
from lunarsim.scenario.shipped import found
from lunarsim.studies import Proportion
from lunarsim_envs.agents.registry import check, label

AGENTS = ("random", "no-divert", "safest", "nearest-safe", "fuel-aware", "few-sites")
# The model first, then the mapper that it approximates.
PERCEPTIONS = ("surrogate", "gaussian-dem")


def sign_of_difference(difference: Difference) -> int:
    """Return the sign of a difference (1 or -1); 0 if its interval contains zero."""
    return int(difference.low > 0.0) - int(difference.high < 0.0)


def is_contradiction(on_surrogate: Difference, on_mapper: Difference) -> bool:
    """Return whether surrogate and mapper rank two agents in opposite order.

    The arguments are the differences of the agents with both kinds of maps. Their intervals must
    exclude zero on opposite sides.
    """
    return sign_of_difference(on_surrogate) * sign_of_difference(on_mapper) < 0


def print_agent_results(
    results: dict[tuple[str, str], AgentFlights], agents: tuple[str, ...]
) -> None:
    """Print safe fraction and propellant of each agent on surrogate and mapper.

    The table also has the paired difference between mapper and surrogate. `results` holds the
    flights by agent and perception.
    """
    print("| agent | safe, surrogate [95 % interval] | safe, mapper | mapper minus surrogate | "
    "propellant, mean (kg), both |\n"
          "| --- | --- | --- | --- | --- |")  # fmt: skip
    for agent in agents:
        ours, theirs = (results[agent, perception] for perception in PERCEPTIONS)
        d = share_difference(ours.safe, theirs.safe, PERCEPTIONS)
        both = [str(Proportion(int(one.safe.sum()), len(one.safe))) for one in (ours, theirs)]
        print(f"| `{label(agent)}` | {both[0]} | {both[1]} | {d.value:+.3f} [{d.low:+.3f}, "
              f"{d.high:+.3f}] | {ours.burnt.mean():.2f}, {theirs.burnt.mean():.2f} |")  # fmt: skip


def count_contradictions(
    results: dict[tuple[str, str], AgentFlights], agents: tuple[str, ...]
) -> dict[str, list[int]]:
    """Count the pairs of agents that surrogate and mapper rank in opposite order.

    `results` holds the flights by agent and perception. Returns, by metric, the number of
    contradicting pairs, of pairs with the same sign of difference (0 if the interval contains
    zero), and of all pairs.
    """
    counts = {"safe": [0, 0, 0], "propellant": [0, 0, 0]}
    for pair in combinations(agents, 2):
        both: dict[str, list[Difference]] = {"safe": [], "propellant": []}
        for perception in PERCEPTIONS:
            a, b = (results[agent, perception] for agent in pair)
            rng = np.random.default_rng(1)
            both["safe"].append(share_difference(a.safe, b.safe, pair))
            both["propellant"].append(mean_difference(a.burnt, b.burnt, pair, rng))
        for name, (ours, theirs) in both.items():
            counts[name][0] += is_contradiction(ours, theirs)
            counts[name][1] += sign_of_difference(ours) == sign_of_difference(theirs)
            counts[name][2] += 1
    return counts


def main() -> int:
    """Fly the agents on surrogate and mapper; print and compare the two rankings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scenario",
        default="few_sites",
        help="scenario: TOML file, or a name from `lunarsim scenario list`",
    )
    parser.add_argument("--flights", type=int, default=300, help="number of flights per agent")
    parser.add_argument(
        "--worlds",
        type=int,
        default=24,
        help="number of random terrains over which the flights are distributed",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=7001,
        help="seed from which the random numbers of terrains and flights derive",
    )
    parser.add_argument(
        "--agent",
        action="append",
        help="agent to compare; repeat the option for several agents (default: all supplied with "
        "lunarsim)",
    )
    args = parser.parse_args()
    assert lunarsim_envs.__name__
    try:
        for field, least in (("flights", 2), ("worlds", 1), ("seed", 0)):
            if getattr(args, field) < least:
                raise InputError(f"--{field}", getattr(args, field), f"must be {least} or more")
        scenario, agents = Scenario.load(found(Path(args.scenario))), tuple(args.agent or AGENTS)
        results = {}
        for agent in agents:
            check(agent)
        for agent in agents:
            for perception in PERCEPTIONS:
                start_s = time.process_time()
                results[agent, perception] = fly_agent(
                    agent, scenario, perception, args.flights, args.worlds, args.seed
                )
                spent = time.process_time() - start_s
                print(f"{agent}, {perception}: {spent:.0f} s", file=sys.stderr, flush=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{scenario.name}: {args.flights} flights over {args.worlds} worlds\n")
    print_agent_results(results, agents)
    print()
    for name, (against, alike, count) in count_contradictions(results, agents).items():
        print(f"{name}: {count} pairs of agents; same order in {alike}, contradiction in {against}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
