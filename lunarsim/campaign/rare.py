"""Rare failures: the share of flights that fail, from flights that were drawn to fail more often.

Each flight counts with its weight, the density of its draws over the density that they were drawn
from; the mean of weight times failure is unbiased for the share of failures under the dispersions
as declared (Owen, Monte Carlo theory, methods and examples, 2013, sections 9.1 and 9.11). The
mixture keeps weights below 1 / nominal_share, so the variance is finite whatever the shifts are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray
from scipy.special import ndtri

from lunarsim.campaign.analysis import arm_rows, column
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.plan import WEIGHT
from lunarsim.campaign.results import Results
from lunarsim.campaign.subset_share import FEW, chains_of, share_of
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.comparisons import greatest_share

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RareShare:
    """The share of failures of one arm.

    Attributes
    ----------
    arm
        Its name.
    flights, failures, left_out
        With a verdict; of them failed; without a verdict.
    value, low, high
        Share of failures under the dispersions as declared, and its 95 % interval.
    worth
        Flights of plain Monte Carlo that would give the same standard error; NaN without failures.
    told_by
        Failures of equal weight that theirs are worth (Kish): 1 where a single one outweighs all;
        with method subset the worlds that the last level is of.
    """

    arm: str
    flights: int
    failures: int
    left_out: int
    value: float
    low: float
    high: float
    worth: float
    told_by: float

    @property
    def few(self) -> bool:
        """Whether so few have failed that the interval is rough."""
        return not self.told_by >= FEW


def rare_shares(
    found: Results, metric: str = "safe", above: float | None = None, below: float | None = None
) -> list[RareShare]:
    """Return the share of failures of every arm.

    Parameters
    ----------
    found
        A campaign of method importance or subset.
    metric
        Column of true and false: failed is false; or of numbers, with a limit. With method subset
        what the spec says.
    above, below
        A number beyond one of these is a failure.

    Raises
    ------
    InputError
        If flights count alike, or metric and limits do not fit.
    """
    if not found.is_leaning:
        raise InputError("folder", str(found.folder), "a campaign of method importance or subset")
    if found.is_subset:
        if metric != "safe" or above is not None or below is not None:
            expected = "nothing: with method subset the spec says what failure is"
            raise InputError("--metric", metric, expected)
        return [_of_subset(found)]
    kinds = {n: kind for n, kind in found.manifest["columns"].items() if kind != "text"}
    if metric not in kinds:
        raise InputError("--metric", metric, suggestion(metric, kinds))
    limits = above is not None or below is not None
    if limits == (kinds[metric] == "bool"):
        expected = "a column of numbers with --above or --below, or one of true and false without"
        raise InputError("--metric", metric, expected)
    values, weights = column(found, metric), column(found, WEIGHT)
    if limits:
        failed = (values > (np.inf if above is None else above)) | (
            values < (-np.inf if below is None else below)
        )
    else:
        failed = values < 0.5
    flown = pc.equal(found.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    good = flown & np.isfinite(values)
    most = 1.0 / float(found.manifest["identity"]["importance"]["nominal_share"])
    out = []
    for arm, rows in arm_rows(found).items():
        here = rows & good
        value, low, high, worth = weighted_share(failed[here], weights[here], most)
        left_out = int(rows.sum() - here.sum())
        flights, failures = int(here.sum()), int(failed[here].sum())
        told_by = _told_by(weights[here & failed])
        out.append(RareShare(arm, flights, failures, left_out, value, low, high, worth, told_by))
    return out


def _of_subset(found: Results) -> RareShare:
    """Return the share of a subset simulation; NaN while it is not complete."""
    chains = chains_of(found)
    lost = sum(level.lost for level in chains.levels)
    failures = sum(int((level.margins <= 0.0).sum()) for level in chains.levels[-1:])
    flights, (arm,), nan = len(found.table) - lost, found.arms, float("nan")
    if chains.stop is None:
        return RareShare(arm, flights, failures, lost, nan, nan, nan, nan, nan)
    made = share_of(chains.levels)
    worth = (1.0 - made.value) / made.value / made.variation**2 if made.value else nan
    return RareShare(
        arm, flights, failures, lost, made.value, made.low, made.high, worth, made.worlds
    )


def _told_by(weights: Array) -> float:
    """Return how many equal weights say as much as these (Kish 1965); 0 for none."""
    return float(weights.sum() ** 2 / (weights**2).sum()) if len(weights) else 0.0


def weighted_share(
    hits: NDArray[np.bool_], weights: Array, most: float
) -> tuple[float, float, float, float]:
    """Return the weighted share of hits, its 95 % interval, and how many even draws it is worth.

    The interval is even in the logarithm, since the share cannot be negative. Where hits are worth
    few even ones, its upper end is at least that of the least flattering case: hits of the greatest
    weight of all, which are those of draws as declared, were as many as can be.

    Parameters
    ----------
    hits, weights
        Of each draw (n,).
    most
        Greatest weight that a draw can have.
    """
    count = len(hits)
    nan = float("nan")
    if not count:
        return nan, nan, nan, nan
    if not hits.any():
        return 0.0, 0.0, min(1.0, most * greatest_share(0, count)), nan
    each = weights * hits
    value = float(each.mean())
    error = float(each.std(ddof=1)) / np.sqrt(count) if count > 1 else np.inf
    wide = float(np.exp(ndtri(0.975) * error / value))
    worth = value * (1.0 - value) / error**2 if error > 0.0 else nan
    high = value * wide
    if _told_by(weights[hits]) < FEW:
        heavy = int((hits & (weights >= 0.5 * most)).sum())
        high = max(high, most * greatest_share(heavy, count))
    return value, value / wide, min(1.0, high), float(worth)
