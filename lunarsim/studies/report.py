"""Report the rows of a study as tables with intervals and paired differences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from lunarsim.evaluation.comparisons import mean_difference, share_difference
from lunarsim.evaluation.statistics import Proportion, mean_interval
from lunarsim.typing import Array


@dataclass(frozen=True)
class Metric:
    """Column of a report: a statistic of one column of the rows.

    Attributes
    ----------
    label
        Quantity and unit, for instance "map height error, RMS (m)".
    statistic
        "share" (fraction of true values with its 95 % Wilson interval), "mean" (with its 95 %
        interval), "median", "max", "median-max" (both), "median-p95" (median and 95th percentile),
        "rms" (root mean square), "count" (number of true values), or "sum".
    digits
        Number of decimal digits.
    """

    label: str
    statistic: str = "mean"
    digits: int = 3

    def __post_init__(self) -> None:
        """Check the name of the statistic."""
        if self.statistic not in {"share", "mean", "count"} and not set(
            self.statistic.split("-")
        ) <= set(_STATISTICS):
            raise ValueError(f"unknown statistic {self.statistic!r}")

    def text(self, values: Sequence[Any]) -> str:
        """Return the statistic of the values of one column as text, ignoring NaN and None."""
        values = [v for v in values if v is not None and not np.isnan(v)]
        if self.statistic == "share":
            return str(Proportion(sum(bool(v) for v in values), len(values)))
        if self.statistic == "count":
            return str(sum(bool(v) for v in values))
        x = np.array(values, dtype=np.float64)
        x = x[np.isfinite(x)]
        if x.size == 0:
            return "-"
        if self.statistic == "mean":
            return mean_interval(x).text(self.digits)
        parts = (_STATISTICS[name](x) for name in self.statistic.split("-"))
        return " / ".join(f"{float(value):.{self.digits}f}" for value in parts)

    def difference(
        self, first: Sequence[Any], second: Sequence[Any], rng: np.random.Generator
    ) -> str:
        """Return second minus first, paired by row, with its 95 % interval as text."""
        names = ("first", "second")
        if self.statistic in {"share", "count"}:
            d = share_difference(np.array(first, dtype=bool), np.array(second, dtype=bool), names)
        else:
            d = mean_difference(
                np.array(first, dtype=np.float64), np.array(second, dtype=np.float64), names, rng
            )
        return f"{d.value:+.{self.digits}f} [{d.low:+.{self.digits}f}, {d.high:+.{self.digits}f}]"


_STATISTICS: dict[str, Callable[[Array], Any]] = {
    "median": np.median, "max": np.max, "sum": np.sum, "p95": lambda x: np.percentile(x, 95.0),
    "rms": lambda x: np.sqrt(np.mean(x**2)),
}  # fmt: skip


@dataclass(frozen=True)
class Report:
    """Results of a study and where they are reported.

    Attributes
    ----------
    rows
        Results in the order of the cases: measured columns, levels of the factors and `number`.
    factors, repeats, metrics, reference
        The factors' names, and the values of the study's attributes of the same names.
    options
        Values of all options, by name.
    seed
        Root seed.
    console
        Console for tables and text.
    out
        Folder for figures; None if none was given.
    """

    rows: list[dict[str, Any]]
    factors: Sequence[str]
    repeats: str
    metrics: Mapping[str, Metric]
    reference: bool
    options: Mapping[str, Any]
    seed: int
    console: Console
    out: Path | None = None

    def print(self, content: Any) -> None:
        """Print a table or text."""
        self.console.print(content)

    def groups(self, *names: str) -> dict[tuple[Any, ...], list[dict[str, Any]]]:
        """Return the rows with equal values in the named columns, in order of appearance."""
        found: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
        for row in self.rows:
            found.setdefault(tuple(row[name] for name in names), []).append(row)
        return found

    def column(self, name: str, rows: Sequence[Mapping[str, Any]] | None = None) -> Array:
        """Return one column of the rows (n,) as numbers; NaN where a row lacks it."""
        chosen = self.rows if rows is None else rows
        found = (row.get(name) for row in chosen)
        return np.array([np.nan if v is None else v for v in found], dtype=np.float64)


def metric_table(report: Report, title: str = "") -> Table:
    """Return a table of all metrics by combination of levels."""
    names = list(report.factors)
    table = Table(title=title or None)
    for name in names:
        table.add_column(name.replace("_", " "), justify="left")
    table.add_column(report.repeats, justify="right")
    for metric in report.metrics.values():
        table.add_column(metric.label, justify="right")
    for levels, rows in report.groups(*names).items():
        table.add_row(
            *map(str, levels), str(len(rows)),
            *(m.text([row[c] for row in rows]) for c, m in report.metrics.items()),
        )  # fmt: skip
    return table


def difference_table(report: Report) -> Table:
    """Return paired differences of metrics from the first level of the first factor."""
    factor, *others = report.factors
    by_level = report.groups(factor)
    (first,), *rest = by_level
    table = Table(title=f"Difference from {first}, paired [95 % interval]")
    table.add_column("metric")
    for (level,) in rest:
        table.add_column(f"{level} minus {first}", justify="right")
    rng = np.random.default_rng(report.seed)
    for column, metric in report.metrics.items():
        cells = []
        for (level,) in rest:
            a, b = (_paired(by_level[(one,)], column, others) for one in (first, level))
            both = [key for key in a if key in b]
            cells.append(metric.difference([a[k] for k in both], [b[k] for k in both], rng))
        table.add_row(metric.label, *cells)
    return table


def _paired(
    rows: Sequence[Mapping[str, Any]], column: str, factors: Sequence[str]
) -> dict[tuple[Any, ...], Any]:
    """Return the values of one column by case, so that two levels can be paired.

    A key has the levels of `factors`, the number of the case, and the index of the row within the
    case.
    """
    found: dict[tuple[Any, ...], Any] = {}
    rows_of_case: Counter[tuple[Any, ...]] = Counter()
    for row in rows:
        case = (*(row[name] for name in factors), row["number"])
        found[(*case, rows_of_case[case])] = row[column]
        rows_of_case[case] += 1
    return found


def print_metrics(report: Report) -> None:
    """Print the metrics of each combination of levels, and their paired differences."""
    report.print(metric_table(report))
    if report.reference and len(report.groups(report.factors[0])) > 1:
        report.print(difference_table(report))
