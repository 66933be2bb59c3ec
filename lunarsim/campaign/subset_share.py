"""The share of failures that a subset simulation has found, and how far it can be trusted.

The share is the product of the levels' shares. Of each level's share the coefficient of variation
takes in how alike the states of a chain are (Au and Beck 2001, eqs. 28 and 29) and how alike those
of one world are, whichever says more; those of the levels are added as if they all erred to the
same side, the bound of Au and Beck (after eq. 33): chains of one level go on from those of the one
before, and where chance decides rather than what is drawn, their errors do go together.

Where few worlds are left the share of the worlds that fail is not known: then the interval reaches
up to the share that comes as far as the last level that many worlds had part in, of which failures
are a part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from lunarsim.campaign.results import Results
from lunarsim.campaign.spec import dispersions_of
from lunarsim.campaign.subset import Chains, Level
from lunarsim.errors import InputError
from lunarsim.evaluation.comparisons import greatest_share

# Fewer failures that count alike, or fewer worlds of them, do not tell how often one fails: an
# interval is rough then, and reaches farther.
FEW = 20


@dataclass(frozen=True)
class SubsetShare:
    """What the levels say.

    Attributes
    ----------
    value, low, high
        Share of failures, and its interval of 95 % or more.
    variation
        Coefficient of variation that the interval is of; infinite without a failure.
    worlds
        Different worlds among the states of the last level; 0 without a failure.
    """

    value: float
    low: float
    high: float
    variation: float
    worlds: int


def chains_of(found: Results) -> Chains:
    """Return the levels of a campaign of method subset, as far as they are flown.

    Raises
    ------
    InputError
        If it is of another method, or its rows do not follow from each other.
    """
    identity = found.manifest["identity"]
    if identity.get("method") != "subset":
        raise InputError("folder", str(found.folder), "a campaign of method subset")
    laws = dispersions_of(identity, "subset", int(identity["seed"]), int(identity["flights"]))
    chains = Chains(laws)
    orphans = chains.resume(found.table.to_pylist())
    if orphans and found.manifest["state"] == "complete":
        raise InputError(
            "folder", str(found.folder),
            f"rows that follow from each other: flight {orphans[0]} was drawn from none that is "
            "there; `lunarsim campaign run` with the same spec flies it again",
        )  # fmt: skip
    return chains


def levels_told(chains: Chains) -> list[dict[str, str]]:
    """Return what there is to say of each complete level, in words by heading."""
    told = []
    for number, level in enumerate(chains.levels):
        told.append({
            "level": str(number),
            "flights": str(level.margins.size if number == 0 else
                           level.margins.size - len(level.margins)),
            f"up to {chains.metric}": f"{chains.value_of(level.threshold):.4g}",
            "share": f"{level.share:.3g}",
            "variation": f"{np.sqrt(variance_of(level)):.2f}" if level.share else "–",
            "steps taken": f"{level.taken:.2f}" if number else "–",
            "worlds": str(len(np.unique(level.worlds))),
            "without the metric": str(level.lost),
        })  # fmt: skip
    return told


def how_it_ended(chains: Chains) -> str:
    """Return in words what is to be said of a campaign besides its figures, "" for nothing."""
    if chains.stop is None:
        return f"not complete: level {len(chains.levels)} is being flown"
    if chains.stuck:
        return (
            f"too many of a level's flights were as near to failure as each other by "
            f"{chains.metric}: it does not tell how near failure is, and the levels ended there"
        )
    if chains.levels[-1].share == 0.0:
        return "no flight failed in as many levels as were asked for; the share lies below"
    return ""


def share_of(levels: Sequence[Level]) -> SubsetShare:
    """Return what complete levels, the last included, say of the share of failures."""
    *before, last = levels
    reached = float(np.prod([level.share for level in before]))
    spread = sum(np.sqrt(variance_of(level)) for level in before)
    failed = last.margins <= 0.0
    if not failed.any():
        # As if the chains of the last level were all that tells of it.
        high = reached * _wide(spread) * greatest_share(0, len(last.margins))
        high = max(high, _share_that_many_reach(levels))
        return SubsetShare(0.0, 0.0, min(1.0, high), np.inf, 0)
    if not before:
        # Flights as declared, each alone: Clopper and Pearson, both sides.
        hits, count = int(failed.sum()), failed.size
        low = 1.0 - greatest_share(count - hits, count, 0.975)
        high = greatest_share(hits, count, 0.975)
        spread = float(np.sqrt(variance_of(last)))
        return SubsetShare(last.share, low, high, spread, len(np.unique(last.worlds)))
    value, spread = reached * last.share, float(spread + np.sqrt(variance_of(last)))
    wide, worlds = _wide(spread), len(np.unique(last.worlds))
    high = max(value * wide, _share_that_many_reach(levels))
    return SubsetShare(value, value / wide, min(1.0, high), spread, worlds)


def _share_that_many_reach(levels: Sequence[Level]) -> float:
    """Return an upper bound of the share that reaches the last level of many worlds.

    0 where the last level of all has many itself: its own error then says enough.
    """
    reached, spread, most = 1.0, 0.0, 1.0
    for level in levels[:-1]:
        if len(np.unique(level.worlds)) < FEW:
            return most
        reached, spread = reached * level.share, spread + float(np.sqrt(variance_of(level)))
        most = reached * _wide(spread)
    return most if len(np.unique(levels[-1].worlds)) < FEW else 0.0


def _wide(variation: float) -> float:
    """Return the factor of an interval of 95 % of a log-normal estimate."""
    return float(np.exp(ndtri(0.975) * np.sqrt(np.log1p(variation**2))))


def variance_of(level: Level) -> float:
    """Return the squared coefficient of variation of a level's share."""
    near = level.margins <= level.threshold
    share, count = float(near.mean()), near.size
    even = (1.0 - share) / (share * count)
    sums = np.zeros(int(level.worlds.max()) + 1)
    np.add.at(sums, level.worlds, near - share)
    return max(even * (1.0 + _alike(near, share)), float(np.sum((sums / (count * share)) ** 2)))


def _alike(near: np.ndarray, share: float) -> float:
    """Return by how much the states of a chain tell less than as many apart (eq. 29); never < 0."""
    steps = near.shape[1]
    whole = share * (1.0 - share)
    if whole == 0.0:
        return 0.0
    total = 0.0
    for apart in range(1, steps):
        together = float(np.mean(near[:, :-apart] & near[:, apart:])) - share**2
        total += 2.0 * (1.0 - apart / steps) * together / whole
    return max(0.0, total)
