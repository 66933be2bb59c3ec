"""Estimate the share of rare failures by importance sampling or subset simulation.

Each flight of importance sampling has a weight: the nominal density of its draws over the density
that they were drawn from. The mean of weight times failure is an unbiased estimate of the failure
share under the nominal dispersions (Owen, Monte Carlo theory, methods and examples, 2013, sections
9.1 and 9.11). The mixture bounds the weights by 1 / nominal_share, so the variance is finite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow.compute as pc
from scipy.special import ndtri

from lunarsim.campaign.analysis import arm_rows, column
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import WEIGHT
from lunarsim.campaign.results import Results
from lunarsim.campaign.subset_estimate import (
    MIN_EFFECTIVE_FAILURES,
    estimate_failure_probability,
    load_chains,
)
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.comparisons import share_upper_bound
from lunarsim.typing import Array, BoolArray


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
