"""Train a site-selecting agent on the surrogate and test it on the real mapper.

    python scenarios/learning/train_retarget.py --out out/retarget.npz
    python scenarios/learning/train_retarget.py --compare few-sites --flights 300

The surrogate is a fast statistical substitute of the mapper. The first command trains by the
cross-entropy method on `scenarios/few_sites.toml` and compares the agent; the second compares an
agent supplied with lunarsim or a file. The flights use held-out terrains and are the same for all
agents. The agent is compared in pairs with the best policy of lunarsim.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from flights import fly_agent

import lunarsim_envs
from lunarsim import InputError, Scenario
from lunarsim.evaluation.comparisons import mean_difference, share_difference
from lunarsim.scenario.shipped import found
from lunarsim.studies import Proportion
from lunarsim_envs.agents.registry import label
from lunarsim_envs.sites.perception import PERCEPTIONS, create_batch
from lunarsim_envs.training.sites import CemSettings, train

POLICIES = ("no-divert", "nearest-safe", "safest", "fuel-aware")
# Root seeds of the worlds in training and in comparisons.
TRAINED_ON, FLOWN_ON = 0, 7001


def train_agent(scenario: Scenario, settings: CemSettings, worlds: int, out: Path) -> None:
    """Train a site-selecting agent, print each generation, and write its network.

    `worlds` is the number of terrains and `out` the output file.
    """
    start_s = time.perf_counter()
    count = settings.population * settings.flights
    lanes = create_batch(count, "surrogate", scenario, worlds, TRAINED_ON, None)
    print("generation  safe rate, elite  propellant (kg)  std. dev.   s", flush=True)

    def report(generation: int, safe: float, burnt: float, sigma: float) -> None:
        spent = time.perf_counter() - start_s
        print(f"{generation:>10} {safe:>18.3f} {burnt:>15.2f} {sigma:>10.3f} {spent:>5.0f}",
              flush=True)  # fmt: skip

    network = train(lanes, settings, report)
    out.parent.mkdir(parents=True, exist_ok=True)
    network.save(out)
    print(f"wrote {out}: {out.stat().st_size / 1e3:.1f} kB")


def compare(
    agent: str, policies: tuple[str, ...], scenario: Scenario, perception: str, flights: int,
    worlds: int,
) -> None:  # fmt: skip
    """Fly an agent and several policies from the same starts; print results.

    `perception` is the kind of hazard map, `worlds` the number of terrains. Paired differences are
    relative to the best policy.
    """
    print(f"\nperception {perception}, {flights} flights over {worlds} worlds")
    print(f"{'':<14} {'safe':>6}  95 % interval      propellant (kg)")
    results = {}
    for name in (*policies, agent):
        safe, burnt = results[name] = fly_agent(
            name, scenario, perception, flights, worlds, FLOWN_ON
        )
        low, high = Proportion(int(safe.sum()), flights).interval
        print(
            f"{label(name):<14} {safe.mean():>6.3f}  [{low:.3f}, {high:.3f}] {burnt.mean():>14.2f}",
            flush=True,
        )
    best = max(policies, key=lambda name: (results[name][0].sum(), -results[name][1].mean()))
    mine, other = results[agent], results[best]
    names = best, label(agent)
    share = share_difference(other[0], mine[0], names)
    burnt = mean_difference(other[1], mine[1], names, np.random.default_rng(1))
    print(f"{names[1]} minus {best}, paired:")
    for what, d in (("safe", share), ("propellant (kg)", burnt)):
        print(f"  {what:<15} {d.value:+.3f} [{d.low:+.3f}, {d.high:+.3f}], p {d.p:.3g}")


def _parse_arguments() -> argparse.Namespace:
    """Parse the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scenario",
        default="few_sites",
        help="scenario: TOML file, or a name from `lunarsim scenario list`",
    )
    parser.add_argument("--out", type=Path, help="file for the trained network (.npz)")
    parser.add_argument(
        "--compare", metavar="AGENT", help="do not train, but compare this existing agent"
    )
    parser.add_argument(
        "--generations", type=int, default=25, help="number of generations of the training"
    )
    parser.add_argument(
        "--propellant-weight", metavar="WEIGHT", type=float, default=CemSettings.propellant_weight,
        help="penalty per kilogram of propellant in the training; a safe landing is worth 1 "
        "(default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--worlds",
        type=int,
        default=24,
        help="number of random terrains over which the flights are distributed",
    )
    parser.add_argument(
        "--flights", type=int, default=300, help="number of flights in the comparison"
    )
    parser.add_argument(
        "--policy",
        action="append",
        choices=POLICIES,
        help="policy to compare with the agent; repeat the option for several policies (default: "
        "all)",
    )
    parser.add_argument(
        "--perception",
        action="append",
        choices=PERCEPTIONS,
        help="source of the hazard maps in the comparison, as for `lunarsim evaluate`; repeat the "
        "option for several sources",
    )
    return parser.parse_args()


def main() -> int:
    """Train a site-selecting agent, or compare one with policies."""
    args = _parse_arguments()
    assert lunarsim_envs.__name__
    try:
        if args.out is None and args.compare is None:
            raise InputError("--out", None, "must be given without --compare", show_value=False)
        for name in ("generations", "worlds", "flights"):
            if getattr(args, name) < 1:
                raise InputError(f"--{name}", getattr(args, name), "must be 1 or more")
        if not 0.0 <= args.propellant_weight < 1.0:
            raise InputError(
                "--propellant-weight", args.propellant_weight, "must be 0 or more and less than 1"
            )
        scenario = Scenario.load(found(Path(args.scenario)))
        if args.compare is None:
            settings = CemSettings(
                generations=args.generations, propellant_weight=args.propellant_weight
            )
            train_agent(scenario, settings, args.worlds, args.out)
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
