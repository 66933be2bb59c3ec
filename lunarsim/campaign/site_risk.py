"""Thresholds of p_safe that bound the risk of the sites of a campaign."""

from __future__ import annotations

import numpy as np
import pyarrow.compute as pc

from lunarsim.campaign.analysis import arm_rows, column, metrics
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.results import Results
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.risk_control import RiskThreshold, risk_threshold


def site_risk_thresholds(
    results: Results, metric: str = "safe", max_risk: float = 0.05, confidence: float = 0.95
) -> dict[str, RiskThreshold]:
    """Return the threshold of p_safe of each arm of a campaign, by name.

    Thresholds are those of `risk_threshold`. A flight uses its last site unless it aborts or the
    site has no p_safe. Flights without an outcome count as failures at every threshold.

    Parameters
    ----------
    results
        Results whose flights have equal weights.
    metric
        Boolean column that is true for a success.
    max_risk, confidence
        Maximum risk and confidence level, 0 to 1.

    Raises
    ------
    InputError
        If weights are unequal, the campaign stops early, flights are not independent (Latin
        hypercube, Sobol sequence), the metric is not a boolean column, or an arm has no flights.
    """
    results.check_equal_weights("folder")
    if "stop" in results.manifest["identity"]:
        raise InputError(
            "folder", str(results.folder), "must be a campaign without [stop]",
            "The bound needs a number of flights that does not depend on their outcomes.",
        )  # fmt: skip
    method = results.manifest["identity"].get("method")
    if method in ("latin-hypercube", "sobol"):
        raise InputError(
            "folder", str(results.folder),
            f"must be a campaign with independent flights, not with method = {method!r}",
            "Use method = 'monte-carlo'.",
        )  # fmt: skip
    columns = results.manifest["columns"]
    for name, wanted in ((metric, "bool"), ("p_safe", "float"), ("aborted", "bool")):
        if columns.get(name) != wanted:
            field = "--metric" if name == metric else "columns"
            raise InputError(
                field, name, f"must be a result column of type {wanted}",
                suggestion(name, metrics(results, wanted)),
            )  # fmt: skip
    flown = pc.equal(results.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    p = np.where(column(results, "aborted") == 1.0, np.nan, column(results, "p_safe"))
    p = np.where(flown, p, np.inf)
    failed = ~flown | (column(results, metric) != 1.0)
    return {
        arm: risk_threshold(p[used], failed[used], max_risk=max_risk, confidence=confidence)
        for arm, rows in arm_rows(results).items()
        for used in [rows & results.independent]
    }
