"""Statistics of a campaign: per arm, between arms, and between two campaigns.

An arm is a variant of the scenario, for instance another policy. All arms fly the same flight
indices, which have the same random numbers; a row of the results is one flight under one arm.
"""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from lunarsim.campaign.manifest import first_difference
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.results import Results
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.comparisons import (
    Difference,
    Ellipse,
    bootstrap_interval,
    holm_correction,
    landing_ellipse,
    mean_difference,
    quantile_interval,
    share_difference,
)
from lunarsim.evaluation.statistics import Proportion
from lunarsim.rng import design_seed
from lunarsim.typing import Array, BoolArray

# Up to this number of arms all pairs are compared; beyond it, each arm with the first.
_MAX_ALL_PAIRS = 8
# Fields of the identity that determine the draws of a flight index.
_DRAW_FIELDS = ("method", "dispersions", "correlations")
_SUMMARY_METRICS = ("propellant_kg", "divert_m", "duration_s")


@dataclass(frozen=True)
class ArmStatistics:
    """Statistics of the flights of one arm, a variant of the scenario.

    Attributes
    ----------
    name
        Name of the arm.
    rows, flown
        Number of flights, and number of flights that have a landing outcome.
    shares
        Fraction of flown flights for which a boolean metric is true, by metric.
    means
        Mean and its bootstrap interval (value, low, high), by metric.
    quantiles
        Median and 95th percentile, each with its interval, by metric.
    ellipse
        Landing ellipse of the touchdown points, or None.
    """

    name: str
    rows: int
    flown: int
    shares: dict[str, Proportion]
    means: dict[str, tuple[float, float, float]]
    quantiles: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]]
    ellipse: Ellipse | None


def column(results: Results, name: str, rows: BoolArray | None = None) -> Array:
    """Return a column of campaign results as floats.

    True and false become 1 and 0, missing values NaN. `rows` is a mask of rows; None: all rows.
    """
    values = pc.cast(results.table[name], "float64").to_numpy(zero_copy_only=False)
    return np.asarray(values if rows is None else values[rows], dtype=np.float64)


def metrics(results: Results, *kinds: str) -> list[str]:
    """Return the names of the metrics of some kinds: "bool", "int", "float" or "text"."""
    return [name for name, kind in results.manifest["columns"].items() if kind in kinds]


def arm_rows(results: Results) -> dict[str, BoolArray]:
    """Return a boolean mask of the result rows that belong to each arm, by arm name.

    An arm is a variant of the scenario.
    """
    names = results.table["arm"]
    return {arm: pc.equal(names, arm).to_numpy(zero_copy_only=False) for arm in results.arms}


def compute_arm_statistics(results: Results) -> list[ArmStatistics]:
    """Compute fractions, means, quantiles and landing ellipse of every arm.

    An arm is a variant of the scenario. Flights without a landing outcome enter only the count
    `rows`.

    Raises
    ------
    InputError
        If the flights have unequal weights (importance sampling).
    """
    results.check_equal_weights("folder")
    rng = np.random.default_rng(design_seed(int(results.manifest["seed"])))
    flown = pc.equal(results.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    metric_names = [name for name in _SUMMARY_METRICS if name in results.manifest["columns"]]
    out = []
    for arm, rows in arm_rows(results).items():
        here = rows & flown
        flown_rows = int(here.sum())
        here = here & results.independent
        count = int(here.sum())
        shares = {
            name: Proportion(int(np.nansum(column(results, name, here))), count)
            for name in metrics(results, "bool")
        }
        numbers = {name: column(results, name, here) for name in metric_names}
        out.append(
            ArmStatistics(
                arm, int(rows.sum()), flown_rows, shares,
                {n: (_mean(v), *bootstrap_interval(v, rng)) for n, v in numbers.items()},
                {n: (quantile_interval(v, 0.5), quantile_interval(v, 0.95))
                 for n, v in numbers.items()},
                _ellipse(results, here),
            )
        )  # fmt: skip
    return out


def _mean(values: Array) -> float:
    """Return the mean of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def _ellipse(results: Results, rows: BoolArray) -> Ellipse | None:
    """Return the landing ellipse of the touchdown points in some rows, or None.

    `rows` is a mask of result rows.
    """
    names = ("touchdown_x_m", "touchdown_y_m")
    if not all(name in results.manifest["columns"] for name in names):
        return None
    return landing_ellipse(np.column_stack([column(results, name, rows) for name in names]))


def arm_pairs(arms: Sequence[str]) -> list[tuple[str, str]]:
    """Return the pairs of arm names to compare.

    An arm is a variant of the scenario. Up to 8 arms give all pairs; of more arms, each one is
    paired with the first.
    """
    if len(arms) <= _MAX_ALL_PAIRS:
        return list(combinations(arms, 2))
    return [(arms[0], other) for other in arms[1:]]


def differences(results: Results, metric: str = "safe") -> list[Difference]:
    """Compute the difference of a metric between pairs of arms, paired by flight.

    An arm is a variant of the scenario. The pairs are all pairs of up to 8 arms, otherwise each arm
    with the first. The p-values have Holm's correction for the number of
    pairs.

    Raises
    ------
    InputError
        If the metric is not a numeric or boolean column, or the flights have unequal weights.
    """
    results.check_equal_weights("folder")
    kind = results.manifest["columns"].get(metric)
    if kind not in ("bool", "float", "int"):
        raise InputError(
            "metric",
            metric,
            "must be a numeric or boolean column of the results",
            suggestion(metric, metrics(results, "bool", "int", "float")),
        )
    rng = np.random.default_rng(design_seed(int(results.manifest["seed"])))
    flights = int(results.table["flight"].to_numpy().max(initial=-1)) + 1
    values = {}
    for arm, mine in arm_rows(results).items():
        rows = mine & results.independent
        values[arm] = np.full(flights, np.nan)
        values[arm][results.table["flight"].to_numpy()[rows]] = column(results, metric, rows)
    made = []
    for pair in arm_pairs(results.arms):
        a, b = (values[arm] for arm in pair)
        both = np.isfinite(a) & np.isfinite(b)
        if kind == "bool":
            made.append(share_difference(a[both] > 0.5, b[both] > 0.5, pair))
        else:
            made.append(mean_difference(a[both], b[both], pair, rng))
    corrected = holm_correction([d.p for d in made])
    return [replace(d, corrected=float(p)) for d, p in zip(made, corrected, strict=True)]


@dataclass(frozen=True)
class ArmComparison:
    """Result of comparing an arm of a second campaign with the same arm of a first.

    An arm is a variant of the scenario.

    Attributes
    ----------
    difference
        Fraction of flights with a true metric in the second campaign minus that fraction in the
        first, with a 90 % interval (two one-sided tests at 5 %).
    equivalent
        Whether the interval lies within the margin.
    worse
        Whether the second is significantly worse: McNemar's test at 5 %, corrected for all arms.
    """

    difference: Difference
    equivalent: bool
    worse: bool


def compare_campaigns(
    first: Results, second: Results, margin: float, metric: str = "safe"
) -> list[ArmComparison]:
    """Compare two campaigns over the same flights, arm by arm.

    An arm is a variant of the scenario.

    Parameters
    ----------
    first, second
        Campaigns with the same arms and the same root seed.
    margin
        Campaigns whose fractions differ by less than this margin count as equivalent.
    metric
        Boolean column of the results.

    Returns
    -------
    list of ArmComparison
        One comparison per arm, in the order of the arms.

    Raises
    ------
    InputError
        If the campaigns differ in arms, seed or draws, flights have unequal weights, or there is
        no such metric.
    """
    for field, results in (("A", first), ("B", second)):
        results.check_equal_weights(field)
    for name in ("seed", "arms", *_DRAW_FIELDS):
        ours, theirs = (_shared_value(results, name) for results in (first, second))
        found = first_difference(ours, theirs, name)
        if found is not None:
            key, a, b = found
            raise InputError(
                "B", b, f"must have the same {key} as A, {reprlib.repr(a)}, but has "
                f"{reprlib.repr(b)}", show_value=False,
            )  # fmt: skip
    if first.manifest["columns"].get(metric) != "bool":
        raise InputError(
            "--metric",
            metric,
            "must be a boolean column of the results",
            suggestion(metric, metrics(first, "bool")),
        )
    made = []
    for arm in first.arms:
        a, b = (_by_flight(results, arm, metric) for results in (first, second))
        flights = sorted(a.keys() & b.keys())
        if not flights:
            raise InputError(
                "B",
                str(second.folder),
                f"must have a flight of arm {arm!r} that A has too",
                show_value=False,
            )
        hits = np.array([(a[i], b[i]) for i in flights], dtype=bool)
        made.append(share_difference(hits[:, 0], hits[:, 1], (arm, arm), level=0.9))
    corrected = holm_correction([d.p for d in made])
    return [
        ArmComparison(
            replace(d, corrected=float(p)),
            equivalent=bool(d.low > -margin and d.high < margin),
            worse=bool(p < 0.05 and d.value < 0.0),
        )
        for d, p in zip(made, corrected, strict=True)
    ]


def _shared_value(results: Results, name: str) -> object:
    """Return a value that must be equal in two compared campaigns, such as `seed`."""
    if name == "arms":
        return results.arms
    return (
        results.manifest["identity"].get(name) if name in _DRAW_FIELDS else results.manifest[name]
    )


def _by_flight(results: Results, arm: str, metric: str) -> dict[int, bool]:
    """Return a boolean metric of one arm by flight index.

    An arm is a variant of the scenario. The metric of a flight without a landing outcome is False.
    """
    mine = pc.equal(results.table["arm"], arm).to_numpy(zero_copy_only=False)
    rows = results.table.filter(pa.array(mine & results.independent))
    values = zip(rows["flight"].to_pylist(), rows[metric].to_pylist(), strict=True)
    return {flight: bool(value) for flight, value in values}
