"""Verify requirements on the flights of a campaign, with confidence.

A requirement limits a result column in a percentage of all flights. Whether it holds follows from
the number k of violations in n flights, by the exact binomial (Clopper-Pearson) bound, without an
assumption about the distribution. The same bound in units of the column is an order statistic: the
one-sided distribution-free tolerance bound (Wilks, Annals of Mathematical Statistics 12, 1941).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
from scipy.stats import beta, binom

from lunarsim.campaign.analysis import arm_rows, column, metrics
from lunarsim.campaign.distributions import build_settings
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.results import Results
from lunarsim.errors import InputError, suggestion
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.scenario.files import read_toml
from lunarsim.typing import Array, BoolArray

# Maximum number of flights that is searched for the required number.
_MAX_FLIGHTS = 10_000_000


@dataclass(frozen=True)
class Requirement:
    """Limit of a result column that a percentage of all flights must keep.

    Attributes
    ----------
    name
        Name or number of the requirement, for the table.
    metric
        Result column. Values of a column with true and false need no limit.
    at_most, at_least
        Limit, in the unit of the column.
    percentage
        Minimum percentage of all flights that keep the limit.
    confidence
        Confidence of the result, percent.
    """

    name: str = quantity("", help="name or number of the requirement")
    metric: str = quantity("", help="result column that the requirement limits")
    at_most: float | None = quantity(None, help="upper limit of the column, in its unit")
    at_least: float | None = quantity(None, help="lower limit of the column, in its unit")
    percentage: float = quantity(
        99.0, gt=0, lt=100, help="minimum percentage of all flights that keep the limit"
    )
    confidence: float = quantity(90.0, gt=0, lt=100, help="confidence of the result, percent")

    def __post_init__(self) -> None:
        check_bounds(self, "requirement")

    def kept(self, values: Array) -> BoolArray:
        """Return which values (n,) of the column keep the limit; NaN does not."""
        if self.at_most is not None:
            return np.asarray(values <= self.at_most)
        return np.asarray(values >= (0.5 if self.at_least is None else self.at_least))


@dataclass(frozen=True)
class Verification:
    """Result of a requirement for one arm of a campaign.

    Attributes
    ----------
    requirement, arm
        Requirement, and name of the arm (variant of the scenario).
    flights, violations
        Number of flights, and of those that do not keep the limit or have no value.
    percentile
        Empirical percentile of the column at the required percentage; NaN for true and false.
    bound
        One-sided tolerance bound of this percentile; NaN with too few flights for one, and for true
        and false.
    margin
        Limit minus bound, or bound minus limit for a lower limit; positive if the bound keeps it.
    fraction_bound
        Lower confidence bound of the fraction of flights that keep the limit.
    status
        "pass": the requirement holds at this confidence; "fail": its violation is shown at this
        confidence; "open": neither.
    missing_flights
        Additional flights without a violation until the requirement passes; 0 if it passes, None if
        more than ten million flights are needed.
    """

    requirement: Requirement
    arm: str
    flights: int
    violations: int
    percentile: float
    bound: float
    margin: float
    fraction_bound: float
    status: str
    missing_flights: int | None


def load_requirements(path: Path) -> list[Requirement]:
    """Return the requirements in the tables ``[[requirements]]`` of a TOML file.

    Raises
    ------
    InputError
        If the file has no such table, an unknown key, or a requirement that states no or two
        limits.
    """
    tables = read_toml(path, "requirements")
    unknown = next((key for key in tables if key != "requirements"), None)
    if unknown is not None:
        raise InputError(unknown, tables[unknown], "is an unknown table", "Use [[requirements]].")
    given = tables["requirements"]
    if not isinstance(given, list) or not given:
        raise InputError(
            "requirements", type(given).__name__, "must be one or more tables [[requirements]]"
        )
    out: list[Requirement] = [
        build_settings(f"requirements[{n}]", Requirement, table) for n, table in enumerate(given)
    ]
    for n, one in enumerate(out):
        if None not in (one.at_most, one.at_least):
            raise InputError(
                f"requirements[{n}].at_least", one.at_least, "must be omitted beside at_most",
                "Write two requirements.",
            )  # fmt: skip
        name = one.name.strip()
        if not name or name in [other.name.strip() for other in out[:n]]:
            raise InputError(f"requirements[{n}].name", one.name, "must be a name used only once")
        if not one.name.isprintable():
            raise InputError(
                f"requirements[{n}].name", ascii(one.name), "must have only printable characters"
            )
    return out


def verify(results: Results, requirements: list[Requirement]) -> list[Verification]:
    """Return the verification of every requirement for every arm of a campaign.

    A flight without a value violates the requirement: it ended without a touchdown, or in an error.

    Raises
    ------
    InputError
        If a requirement names no column with numbers or with true and false, or if the flights have
        unequal weights.
    """
    results.check_equal_weights("folder")
    known = metrics(results, "bool", "int", "float")
    flags = metrics(results, "bool")
    for n, one in enumerate(requirements):
        if one.metric not in known:
            raise InputError(
                f"requirements[{n}].metric", one.metric, "must be a column with numbers or with "
                "true and false", suggestion(one.metric, known),
            )  # fmt: skip
        if (one.metric in flags) != (one.at_most is None and one.at_least is None):
            raise InputError(
                f"requirements[{n}]", one.metric,
                "must have no limit, because this column is true or false"
                if one.metric in flags else "must have a limit at_most or at_least",
            )  # fmt: skip
    return list(_verifications(results, requirements))


def _verifications(results: Results, requirements: list[Requirement]) -> Iterator[Verification]:
    flown = pc.equal(results.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    for one in requirements:
        for arm, rows in arm_rows(results).items():
            mask = rows & results.independent
            values = np.where(flown[mask], column(results, one.metric, mask), np.nan)
            yield verify_values(one, arm, values)


def verify_values(requirement: Requirement, arm: str, values: Array) -> Verification:
    """Return the verification of a requirement for the values (n,) of one arm."""
    r = requirement
    n, violations = len(values), int((~r.kept(values)).sum())
    fraction, level = 0.01 * r.percentage, 0.01 * r.confidence
    limit = r.at_most if r.at_most is not None else r.at_least
    percentile = bound = margin = float("nan")
    if limit is not None:
        sign = 1.0 if r.at_most is not None else -1.0
        # Flights without a value lie beyond every limit.
        ordered = np.sort(np.where(np.isnan(values), np.inf, sign * values))
        if n > 0:
            # The rounding error of a product such as 0.07 * 100 must not raise the rank.
            below = int(np.ceil(r.percentage * n / 100.0 - 1e-9)) - 1
            percentile = sign * float(ordered[max(below, 0)])
        rank = tolerance_rank(n, fraction, level)
        if rank is not None:
            bound = sign * float(ordered[rank - 1])
            margin = sign * (limit - bound)
    passes = _lower_bound(n, violations, level)
    fails = 1.0 if violations == 0 else float(beta.ppf(level, n - violations + 1, violations))
    status = "pass" if passes >= fraction else "fail" if fails < fraction else "open"
    needed = n if status == "pass" else needed_flights(violations, fraction, level)
    missing = None if needed is None else needed - n
    return Verification(r, arm, n, violations, percentile, bound, margin, passes, status, missing)


def _lower_bound(flights: int, violations: int, level: float) -> float:
    """Return the lower confidence bound of the fraction that keeps the limit."""
    if violations >= flights:
        return 0.0
    return float(beta.ppf(1.0 - level, flights - violations, violations + 1))


def tolerance_rank(flights: int, fraction: float, level: float) -> int | None:
    """Return the rank of the order statistic that bounds a percentile, or None.

    The value of this rank (1 is the smallest) is at least the percentile `fraction` with the
    confidence `level`: ``P(B < rank) >= level`` with B binomial (`flights`, `fraction`). None: too
    few flights.
    """
    rank = int(binom.ppf(level, flights, fraction)) + 1 if flights > 0 else 1
    return rank if rank <= flights else None


def needed_flights(violations: int, fraction: float, level: float) -> int | None:
    """Return the number of flights with which a requirement passes, or None.

    It is the smallest n whose lower confidence bound with this number of violations reaches
    `fraction`. None: more than ten million.
    """
    if _lower_bound(_MAX_FLIGHTS, violations, level) < fraction:
        return None
    low, high = violations, violations + 1
    while _lower_bound(high, violations, level) < fraction:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if _lower_bound(middle, violations, level) < fraction:
            low = middle
        else:
            high = middle
    return high


def verification_rows(found: list[Verification]) -> list[dict[str, Any]]:
    """Return one dictionary per verification for tables and files; NaN becomes None."""
    rows = []
    for v in found:
        r = v.requirement
        row: dict[str, Any] = {
            "requirement": r.name, "arm": v.arm, "metric": r.metric, "at_most": r.at_most,
            "at_least": r.at_least, "percentage": r.percentage, "confidence": r.confidence,
            "flights": v.flights, "violations": v.violations, "percentile": v.percentile,
            "bound": v.bound, "margin": v.margin, "fraction_bound": v.fraction_bound,
            "status": v.status, "missing_flights": v.missing_flights,
        }  # fmt: skip
        rows.append(
            {
                k: x if x is None or isinstance(x, str) or np.isfinite(x) else None
                for k, x in row.items()
            }
        )
    return rows
