"""Estimate the share of rare failures by importance sampling or subset simulation.

Each flight of importance sampling has a weight: the nominal density of its draws over the density
that they were drawn from. The mean of weight times failure is an unbiased estimate of the failure
share under the nominal dispersions (Owen, Monte Carlo theory, methods and examples, 2013, sections
9.1 and 9.11). The mixture bounds the weights by 1 / nominal_share, so the variance is finite.

The estimate of subset simulation is the product of the conditional probabilities of the levels. The
coefficient of variation of a level includes the correlation of the states of a chain (Au and Beck
2001, eqs. 28 and 29) or of the states of a world, whichever is larger. The coefficients of the
levels are added as if fully correlated, the bound of Au and Beck (after eq. 33): chains of a level
start from states of the level before, so their errors are correlated where chance dominates the
dispersions.

If few worlds remain, the share of failing worlds is poorly known. The interval then extends up to
the probability of reaching the last level that had many worlds; failures are a subset of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow.compute as pc
from scipy.special import ndtri

from lunarsim.campaign.analysis import arm_rows, column
from lunarsim.campaign.dispersions import build_dispersions
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import WEIGHT
from lunarsim.campaign.results import Results
from lunarsim.campaign.subset import SubsetChains, SubsetLevel
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.comparisons import share_upper_bound
from lunarsim.typing import Array, BoolArray

# With fewer failures of equal weight, or fewer worlds among them, the interval is approximate and
# is widened.
MIN_EFFECTIVE_FAILURES = 20


@dataclass(frozen=True)
class RareFailureEstimate:
    """Estimated probability of failure of one arm (variant of the scenario).

    Attributes
    ----------
    arm
        Name of the arm.
    flights, failures, without_outcome
        Number of flights with an outcome; failures among them (with method subset, in the last
        level only); flights without an outcome.
    value, low, high
        Probability of failure under the nominal dispersions, and its 95 % interval.
    equivalent_flights
        Number of plain Monte Carlo flights with the same standard error; NaN without failures.
    effective_failures
        Effective number of failures (Kish 1965): 1 if the weight of one failure exceeds all others.
        With method subset, the number of different worlds among the flights of the last level.
    """

    arm: str
    flights: int
    failures: int
    without_outcome: int
    value: float
    low: float
    high: float
    equivalent_flights: float
    effective_failures: float

    @property
    def is_approximate(self) -> bool:
        """Whether too few flights failed for an accurate interval."""
        return not self.effective_failures >= MIN_EFFECTIVE_FAILURES


def estimate_failure_shares(
    results: Results, metric: str = "safe", above: float | None = None, below: float | None = None
) -> list[RareFailureEstimate]:
    """Estimate the probability of failure of every arm from weighted flights.

    An arm is a variant of the scenario.

    Parameters
    ----------
    results
        Results of a campaign of method importance or subset.
    metric
        Boolean column that is false for a failure, or a numeric column with a limit. With method
        subset the spec defines the failure.
    above, below
        Failure limit of a numeric column.

    Raises
    ------
    InputError
        If the campaign has another method, or metric and limits do not fit together.
    """
    if not results.has_unequal_weights:
        raise InputError(
            "folder", str(results.folder), "must be a campaign of method importance or subset"
        )
    if results.is_subset:
        given = {"--metric": metric, "--above": above, "--below": below}
        omitted = {"--metric": "safe", "--above": None, "--below": None}
        for name, value in given.items():
            if value != omitted[name]:
                raise InputError(
                    name, value,
                    "must be omitted, because the spec defines the failure with method = 'subset'",
                )  # fmt: skip
        return [_subset_failure_share(results)]
    kinds = {n: kind for n, kind in results.manifest["columns"].items() if kind != "text"}
    if metric not in kinds:
        raise InputError(
            "--metric", metric, "must be a numeric or boolean column of the results",
            suggestion(metric, kinds),
        )  # fmt: skip
    limits = above is not None or below is not None
    if limits == (kinds[metric] == "bool"):
        expected = (
            "must be a numeric column with --above or --below"
            if limits
            else "must be a boolean column without --above and --below"
        )
        raise InputError("--metric", metric, expected)
    values, weights = column(results, metric), column(results, WEIGHT)
    if limits:
        failed = (values > (np.inf if above is None else above)) | (
            values < (-np.inf if below is None else below)
        )
    else:
        failed = values < 0.5
    flown = pc.equal(results.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    good = flown & np.isfinite(values)
    max_weight = 1.0 / float(results.manifest["identity"]["importance"]["nominal_share"])
    out = []
    for arm, rows in arm_rows(results).items():
        here = rows & good
        value, low, high, worth = estimate_weighted_share(failed[here], weights[here], max_weight)
        left_out = int(rows.sum() - here.sum())
        flights, failures = int(here.sum()), int(failed[here].sum())
        effective_failures = _effective_sample_size(weights[here & failed])
        out.append(
            RareFailureEstimate(
                arm, flights, failures, left_out, value, low, high, worth, effective_failures
            )
        )
    return out


def _subset_failure_share(results: Results) -> RareFailureEstimate:
    """Return the probability of failure of a subset simulation; NaN until complete."""
    chains = load_chains(results)
    missing_count = sum(level.missing_count for level in chains.levels)
    failures = sum(int((level.margins <= 0.0).sum()) for level in chains.levels[-1:])
    flights, (arm,), nan = len(results.table) - missing_count, results.arms, float("nan")
    if chains.stop is None:
        return RareFailureEstimate(arm, flights, failures, missing_count, nan, nan, nan, nan, nan)
    made = estimate_failure_probability(chains.levels)
    worth = (1.0 - made.value) / made.value / made.variation**2 if made.value else nan
    return RareFailureEstimate(
        arm, flights, failures, missing_count, made.value, made.low, made.high, worth, made.worlds
    )


def _effective_sample_size(weights: Array) -> float:
    """Return the effective sample size of weights (Kish 1965); 0 for an empty array."""
    return float(weights.sum() ** 2 / (weights**2).sum()) if len(weights) else 0.0


def estimate_weighted_share(
    hits: BoolArray, weights: Array, max_weight: float
) -> tuple[float, float, float, float]:
    """Estimate a probability by importance sampling, with interval and sample size.

    The interval is symmetric in the logarithm of the probability. If the effective number of hits
    is small, the upper limit is at least `max_weight` times the binomial upper bound for the hits
    with at least half the maximum weight. Without hits, the lower limit is 0.

    Parameters
    ----------
    hits, weights
        Hit (boolean) and weight of each draw (n,).
    max_weight
        Maximum weight that a draw can have.

    Returns
    -------
    tuple of float
        Weighted fraction of hits; lower and upper limit at 95 %; number of draws with weight 1 that
        would give the same standard error.
    """
    count = len(hits)
    nan = float("nan")
    if not count:
        return nan, nan, nan, nan
    if not hits.any():
        return 0.0, 0.0, min(1.0, max_weight * share_upper_bound(0, count)), nan
    each = weights * hits
    value = float(each.mean())
    error = float(each.std(ddof=1)) / np.sqrt(count) if count > 1 else np.inf
    wide = float(np.exp(ndtri(0.975) * error / value))
    worth = value * (1.0 - value) / error**2 if error > 0.0 else nan
    high = value * wide
    if _effective_sample_size(weights[hits]) < MIN_EFFECTIVE_FAILURES:
        heavy = int((hits & (weights >= 0.5 * max_weight)).sum())
        high = max(high, max_weight * share_upper_bound(heavy, count))
    return value, value / wide, min(1.0, high), float(worth)


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
