"""Whether the surrogate ranks policies as the real mapper does, on worlds that no fit has seen.

    python scenarios/learning/ranking.py --flights 300

All policies that choose among sites and the agent that comes along fly the same episodes twice, on
maps of the surrogate and of the Gaussian DEM itself. Printed are shares that land safe and what
they burn on both, the mapper less the surrogate in pairs, and of each pair of agents who is ahead
on either: the two contradict each other where intervals of both leave nought out, on other sides.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import combinations
from pathlib import Path

import numpy as np
from flights import Flown, flown

import lunarsim_envs
from lunarsim.errors import InputError
from lunarsim.evaluation.comparisons import Difference, mean_difference, share_difference
from lunarsim.evaluation.statistics import Proportion
from lunarsim.scenario import Scenario
from lunarsim.scenario.shipped import found
from lunarsim_envs.agents.registry import check, label

AGENTS = ("random", "no-divert", "safest", "nearest-safe", "fuel-aware", "few-sites")
# The model first, then what it stands for.
PERCEPTIONS = ("surrogate", "gaussian-dem")


def side(d: Difference) -> int:
    """Return which of two is ahead: 1 the second, -1 the first, 0 where the interval has nought."""
    return int(d.low > 0.0) - int(d.high < 0.0)


def contradicted(ours: Difference, theirs: Difference) -> bool:
    """Tell whether two intervals of a difference leave nought out on other sides."""
    return side(ours) * side(theirs) < 0


def shares(told: dict[tuple[str, str], Flown], agents: tuple[str, ...]) -> None:
    """Print each agent on both perceptions, and the mapper less the surrogate in pairs."""
    print("| agent | safe, surrogate [95 %] | safe, mapper | mapper less surrogate | kg, both |\n"
          "| --- | --- | --- | --- | --- |")  # fmt: skip
    for agent in agents:
        ours, theirs = (told[agent, perception] for perception in PERCEPTIONS)
        d = share_difference(ours.safe, theirs.safe, PERCEPTIONS)
        both = [str(Proportion(int(one.safe.sum()), len(one.safe))) for one in (ours, theirs)]
        print(f"| `{label(agent)}` | {both[0]} | {both[1]} | {d.value:+.3f} [{d.low:+.3f}, "
              f"{d.high:+.3f}] | {ours.burnt.mean():.2f}, {theirs.burnt.mean():.2f} |")  # fmt: skip


def pairs(told: dict[tuple[str, str], Flown], agents: tuple[str, ...]) -> dict[str, list[int]]:
    """Return of the pairs of agents, by what is compared: contradicted, told apart alike, all."""
    counts = {"safe": [0, 0, 0], "propellant": [0, 0, 0]}
    for pair in combinations(agents, 2):
        both: dict[str, list[Difference]] = {"safe": [], "propellant": []}
        for perception in PERCEPTIONS:
            a, b = (told[agent, perception] for agent in pair)
            rng = np.random.default_rng(1)
            both["safe"].append(share_difference(a.safe, b.safe, pair))
            both["propellant"].append(mean_difference(a.burnt, b.burnt, pair, rng))
        for name, (ours, theirs) in both.items():
            counts[name][0] += contradicted(ours, theirs)
            counts[name][1] += side(ours) == side(theirs)
            counts[name][2] += 1
    return counts


def main() -> int:
    """Fly, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="few_sites", help="file or name")
    parser.add_argument("--flights", type=int, default=300)
    parser.add_argument("--worlds", type=int, default=24, help="of a pool")
    parser.add_argument("--seed", type=int, default=7001, help="of worlds and flights")
    parser.add_argument("--agent", action="append", help="left out: all that come along")
    args = parser.parse_args()
    assert lunarsim_envs.__name__
    try:
        for field, least in (("flights", 2), ("worlds", 1), ("seed", 0)):
            if getattr(args, field) < least:
                raise InputError(f"--{field}", getattr(args, field), f"at least {least}")
        scenario, agents = Scenario.load(found(Path(args.scenario))), tuple(args.agent or AGENTS)
        told = {}
        for agent in agents:
            check(agent)
        for agent in agents:
            for perception in PERCEPTIONS:
                begun = time.process_time()
                told[agent, perception] = flown(
                    agent, scenario, perception, args.flights, args.worlds, args.seed
                )
                spent = time.process_time() - begun
                print(f"{agent}, {perception}: {spent:.0f} s", file=sys.stderr, flush=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{scenario.name}: {args.flights} flights over {args.worlds} worlds\n")
    shares(told, agents)
    print()
    for name, (against, alike, count) in pairs(told, agents).items():
        print(f"{name}: of {count} pairs of agents {alike} are ranked alike, {against} contradict")
    return 0


if __name__ == "__main__":
    sys.exit(main())
