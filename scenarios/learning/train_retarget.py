"""Train an agent that chooses sites on the surrogate, and fly it unchanged on the real mapper.

    python scenarios/learning/train_retarget.py --out out/retarget.npz
    python scenarios/learning/train_retarget.py --compare few-sites --flights 300

The first trains by the cross-entropy method on `scenarios/few_sites.toml` and compares; the second
compares an agent that comes along, or a file. Flights are over worlds that no training saw, and the
same for all agents: pairs of them are compared with the best of the policies that come along.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from flights import flown

import lunarsim_envs
from lunarsim.errors import InputError
from lunarsim.evaluation.comparisons import mean_difference, share_difference
from lunarsim.evaluation.statistics import Proportion
from lunarsim.scenario import Scenario
from lunarsim.scenario.shipped import found
from lunarsim_envs.agents.registry import label
from lunarsim_envs.sites.perception import PERCEPTIONS, lanes_of
from lunarsim_envs.training.sites import SiteTraining, train

POLICIES = ("no-divert", "nearest-safe", "safest", "fuel-aware")
# Root seeds of the worlds: of training, and of comparisons.
TRAINED_ON, FLOWN_ON = 0, 7001


def trained(scenario: Scenario, settings: SiteTraining, worlds: int, out: Path) -> None:
    """Train, telling of each generation, and write the network."""
    begun = time.perf_counter()
    count = settings.population * settings.flights
    lanes = lanes_of(count, "surrogate", scenario, worlds, TRAINED_ON, None)
    print("generation  safe of the elite  propellant, kg  deviation   s", flush=True)

    def told(generation: int, safe: float, burnt: float, sigma: float) -> None:
        spent = time.perf_counter() - begun
        print(f"{generation:>10} {safe:>18.3f} {burnt:>15.2f} {sigma:>10.3f} {spent:>5.0f}",
              flush=True)  # fmt: skip

    network = train(lanes, settings, told)
    out.parent.mkdir(parents=True, exist_ok=True)
    network.save(out)
    print(f"wrote {out}: {out.stat().st_size / 1e3:.1f} kB")


def compare(
    agent: str, policies: tuple[str, ...], scenario: Scenario, perception: str, flights: int,
    worlds: int,
) -> None:  # fmt: skip
    """Print agent and policies on the same flights, and pairs with the best policy."""
    print(f"\nperception {perception}, {flights} flights over {worlds} worlds")
    print(f"{'':<14} {'safe':>6}  95 % interval      propellant, kg")
    told = {}
    for name in (*policies, agent):
        safe, burnt = told[name] = flown(name, scenario, perception, flights, worlds, FLOWN_ON)
        low, high = Proportion(int(safe.sum()), flights).interval
        print(
            f"{label(name):<14} {safe.mean():>6.3f}  [{low:.3f}, {high:.3f}] {burnt.mean():>14.2f}",
            flush=True,
        )
    best = max(policies, key=lambda name: (told[name][0].sum(), -told[name][1].mean()))
    mine, other = told[agent], told[best]
    names = best, label(agent)
    share = share_difference(other[0], mine[0], names)
    burnt = mean_difference(other[1], mine[1], names, np.random.default_rng(1))
    print(f"{names[1]} less {best}, in pairs:")
    for what, d in (("safe", share), ("propellant, kg", burnt)):
        print(f"  {what:<15} {d.value:+.3f} [{d.low:+.3f}, {d.high:+.3f}], p {d.p:.3g}")


def main() -> int:
    """Train, or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="few_sites", help="file or name")
    parser.add_argument("--out", type=Path, help="file of the network to write (.npz)")
    parser.add_argument("--compare", metavar="AGENT", help="train none: compare this one")
    parser.add_argument("--generations", type=int, default=25)
    parser.add_argument(
        "--price", type=float, default=SiteTraining.price,
        help="of a kilogram, where a safe landing is worth 1 (%(default)s)",
    )  # fmt: skip
    parser.add_argument("--worlds", type=int, default=24, help="of a pool")
    parser.add_argument("--flights", type=int, default=300, help="that are compared")
    parser.add_argument(
        "--policy", action="append", choices=POLICIES, help="to compare with; left out: all"
    )
    parser.add_argument(
        "--perception", action="append", choices=PERCEPTIONS, help="that are compared on"
    )
    args = parser.parse_args()
    assert lunarsim_envs.__name__
    try:
        if args.out is None and args.compare is None:
            raise InputError("--out", None, "a file name, or --compare")
        for name in ("generations", "worlds", "flights"):
            if getattr(args, name) < 1:
                raise InputError(f"--{name}", getattr(args, name), "at least 1")
        if not 0.0 <= args.price < 1.0:
            raise InputError("--price", args.price, "from 0 to less than 1")
        scenario = Scenario.load(found(Path(args.scenario)))
        if args.compare is None:
            settings = SiteTraining(generations=args.generations, price=args.price)
            trained(scenario, settings, args.worlds, args.out)
        agent = args.compare or str(args.out)
        for perception in args.perception or ("surrogate", "gaussian-dem"):
            policies = tuple(args.policy or POLICIES)
            compare(agent, policies, scenario, perception, args.flights, args.worlds)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
