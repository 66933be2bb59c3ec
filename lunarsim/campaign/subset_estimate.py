"""Estimate the failure probability of a subset simulation, and its interval.

The estimate is the product of the conditional probabilities of the levels. The coefficient of
variation of a level includes the correlation of the states of a chain (Au and Beck 2001, eqs. 28
and 29) or of the states of a world, whichever is larger. The coefficients of the levels are added
as if fully correlated, the bound of Au and Beck (after eq. 33): chains of a level start from states
of the level before, so their errors are correlated where chance dominates the dispersions.

If few worlds remain, the share of failing worlds is poorly known. The interval then extends up to
the probability of reaching the last level that had many worlds; failures are a subset of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from lunarsim.campaign.results import Results
from lunarsim.campaign.spec import build_dispersions
from lunarsim.campaign.subset import SubsetChains, SubsetLevel
from lunarsim.errors import InputError
from lunarsim.evaluation.comparisons import share_upper_bound

# With fewer failures of equal weight, or fewer worlds among them, the interval is approximate and
# is widened.
MIN_EFFECTIVE_FAILURES = 20


@dataclass(frozen=True)
class SubsetEstimate:
    """Failure probability estimated by a subset simulation, with its interval.

    Attributes
    ----------
    value, low, high
        Failure probability and its interval of 95 % or more.
    variation
        Coefficient of variation that the interval is based on; infinite without a failure.
    worlds
        Number of different worlds among the states of the last level; 0 without a failure.
    """

    value: float
    low: float
    high: float
    variation: float
    worlds: int


def load_chains(results: Results) -> SubsetChains:
    """Rebuild the Markov chains of a subset simulation from the campaign's results.

    Raises
    ------
    InputError
        If the campaign has another method than subset, or its results are inconsistent.
    """
    identity = results.manifest["identity"]
    if identity.get("method") != "subset":
        raise InputError("folder", str(results.folder), "must be a campaign of method subset")
    laws = build_dispersions(identity, "subset", int(identity["seed"]), int(identity["flights"]))
    chains = SubsetChains(laws)
    orphans = chains.resume(results.table.to_pylist())
    if orphans and results.manifest["state"] == "complete":
        raise InputError(
            "folder", str(results.folder),
            f"contains flight {orphans[0]}, which does not match the flights that it depends on",
            "Fly it again: `lunarsim campaign run` with the same campaign file.",
        )  # fmt: skip
    return chains


def level_table_rows(chains: SubsetChains) -> list[dict[str, str]]:
    """Return the table of the complete levels of a subset simulation.

    Each row is a dictionary of texts by column heading.
    """
    rows = []
    for number, level in enumerate(chains.levels):
        rows.append({
            "level": str(number),
            "flights": str(level.margins.size if number == 0 else
                           level.margins.size - len(level.margins)),
            f"up to {chains.metric}": f"{chains.value_of(level.threshold):.4g}",
            "conditional probability": f"{level.share:.3g}",
            "coefficient of variation":
                f"{np.sqrt(level_variance(level)):.2f}" if level.share else "–",
            "acceptance rate": f"{level.acceptance_rate:.2f}" if number else "–",
            "worlds": str(len(np.unique(level.worlds))),
            "flights without metric": str(level.missing_count),
        })  # fmt: skip
    return rows


def completion_remark(chains: SubsetChains) -> str:
    """Return a sentence on why a subset simulation has no estimate or ended early.

    Return "" if there is nothing to report.
    """
    if chains.stop is None:
        return f"Not complete: level {len(chains.levels)} is running."
    if chains.is_stalled:
        return (
            f"The levels ended early: too many flights of a level have the same {chains.metric}, "
            "which therefore does not measure the distance from failure."
        )
    if chains.levels[-1].share == 0.0:
        return "No flight failed within the maximum number of levels; only an upper bound is known."
    return ""


def estimate_failure_probability(levels: Sequence[SubsetLevel]) -> SubsetEstimate:
    """Estimate the failure probability from all levels of a subset simulation."""
    *before, last = levels
    reached = float(np.prod([level.share for level in before]))
    spread = sum(np.sqrt(level_variance(level)) for level in before)
    failed = last.margins <= 0.0
    if not failed.any():
        # Conservative: the chains of the last level count as single flights.
        high = reached * _interval_factor(spread) * share_upper_bound(0, len(last.margins))
        high = max(high, _reached_share_bound(levels))
        return SubsetEstimate(0.0, 0.0, min(1.0, high), np.inf, 0)
    if not before:
        # Nominal, independent flights: two-sided Clopper-Pearson interval.
        hits, count = int(failed.sum()), failed.size
        low = 1.0 - share_upper_bound(count - hits, count, 0.975)
        high = share_upper_bound(hits, count, 0.975)
        spread = float(np.sqrt(level_variance(last)))
        return SubsetEstimate(last.share, low, high, spread, len(np.unique(last.worlds)))
    value, spread = reached * last.share, float(spread + np.sqrt(level_variance(last)))
    wide, worlds = _interval_factor(spread), len(np.unique(last.worlds))
    high = max(value * wide, _reached_share_bound(levels))
    return SubsetEstimate(value, value / wide, min(1.0, high), spread, worlds)


def _reached_share_bound(levels: Sequence[SubsetLevel]) -> float:
    """Return an upper limit of the failure probability if few worlds remain, else 0.

    It is the upper limit of the probability to reach the first level with fewer than
    `MIN_EFFECTIVE_FAILURES` different worlds. If there is no such level, the result is 0.
    """
    reached, spread, bound = 1.0, 0.0, 1.0
    for level in levels[:-1]:
        if len(np.unique(level.worlds)) < MIN_EFFECTIVE_FAILURES:
            return bound
        reached, spread = reached * level.share, spread + float(np.sqrt(level_variance(level)))
        bound = reached * _interval_factor(spread)
    return bound if len(np.unique(levels[-1].worlds)) < MIN_EFFECTIVE_FAILURES else 0.0


def _interval_factor(variation: float) -> float:
    """Return the factor between a log-normal estimate and its 95 % limits.

    `variation` is the coefficient of variation of the estimate.
    """
    return float(np.exp(ndtri(0.975) * np.sqrt(np.log1p(variation**2))))


def level_variance(level: SubsetLevel) -> float:
    """Return the squared coefficient of variation of a level's probability."""
    near = level.margins <= level.threshold
    share, count = float(near.mean()), near.size
    even = (1.0 - share) / (share * count)
    sums = np.zeros(int(level.worlds.max()) + 1)
    np.add.at(sums, level.worlds, near - share)
    return max(
        even * (1.0 + _chain_correlation(near, share)), float(np.sum((sums / (count * share)) ** 2))
    )


def _chain_correlation(is_below: np.ndarray, share: float) -> float:
    """Return the correlation factor gamma of Markov chains (Au and Beck 2001, eq. 29).

    `is_below` (chains, steps) states whether each state is at or below the threshold, and `share`
    is the fraction of such states. The result is at least 0.
    """
    steps = is_below.shape[1]
    variance = share * (1.0 - share)
    if variance == 0.0:
        return 0.0
    total = 0.0
    for apart in range(1, steps):
        together = float(np.mean(is_below[:, :-apart] & is_below[:, apart:])) - share**2
        total += 2.0 * (1.0 - apart / steps) * together / variance
    return max(0.0, total)
