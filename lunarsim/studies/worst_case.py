"""Run a search for the worst case as a study, and report what it finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from lunarsim.evaluation.comparisons import bootstrap_interval
from lunarsim.scenario import Scenario
from lunarsim.search import SearchSpace, Trial, WorstCaseSearch
from lunarsim.search.worst_case import FOUND, METHODS, ONE_NOMINAL, SCREENED, SHRUNK
from lunarsim.studies.report import Report
from lunarsim.studies.study import Case, Measure, Row
from lunarsim.typing import Array
from lunarsim.viz.style import COLOURS, new_figure, save

__all__ = ["OPTIONS", "WorstCaseProblem"]

OPTIONS = (
    click.Option(
        ["--findings"], type=click.IntRange(min=1), default=3, show_default=True,
        help="Maximum number of findings.",
    ),
    click.Option(
        ["--draws"], type=click.IntRange(min=2), default=10, show_default=True,
        help="Number of fresh draws on which each finding is evaluated.",
    ),
)  # fmt: skip
FIGURE = "worst_case.png"
# Numbers of evaluations at which the table of the search has a row, as fractions of all.
_TABLE_FRACTIONS = (0.05, 0.1, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class WorstCaseProblem:
    """What a study searches for, and how its results are named.

    The study has `explore`, `report` and `OPTIONS` of this module. Its `measure` returns one row
    with the column `score`. It reads the searched values from ``case["values"]`` and draws random
    numbers from ``case.seed`` and ``case.number`` only.

    Attributes
    ----------
    space
        Admissible values.
    build
        Function that returns the scenario of a set of values.
    level
        Score of a case without failure.
    score_label
        Name and unit of the score in tables and in the figure.
    """

    space: SearchSpace
    build: Callable[[Mapping[str, Any]], Scenario]
    level: float
    score_label: str

    def explore(self, measure: Measure, count: int, seed: int, options: Mapping[str, Any]) -> None:
        """Search with `count` evaluations of each method, and evaluate the findings.

        Parameters
        ----------
        measure
            Function that measures a batch of cases.
        count, seed, options
            Evaluations of each method, root seed, and the values of `OPTIONS`.

        Raises
        ------
        InputError
            If a key or a range is not admissible, or an option is not usable.
        """
        self.space.check(self.build)
        search = WorstCaseSearch(
            self.space, self.level, count, findings=options["findings"], draws=options["draws"]
        )

        def evaluate(trials: Sequence[Trial]) -> list[float]:
            cases = [
                Case({**vars(t), "values": dict(t.values)}, t.draw, seed, options) for t in trials
            ]
            return [rows[0]["score"] for rows in measure(cases)]

        search.run(evaluate, seed)

    def report(self, report: Report) -> None:
        """Print the search, its findings and their keys; write figure and scenarios."""
        report.print(self._search_table(report))
        report.print(self._candidate_table(report))
        report.print(self._finding_table(report))
        report.print(self._key_table(report))
        if report.out is not None:
            self._plot(report, report.out / FIGURE)
            for number, rows in _by(report.rows, SHRUNK, "finding").items():
                name = _name(number)
                scenario = replace(
                    self.build(rows[0]["values"]), name=name,
                    description=f"{self.score_label}: {_mean(rows)} over {len(rows)} draws",
                )  # fmt: skip
                scenario.save(report.out / f"{name}.toml")

    def _search_table(self, report: Report) -> Table:
        """Return the minimum score after numbers of evaluations, by method."""
        table = Table(title=f"Minimum score of single evaluations ({self.score_label})")
        for heading in ("evaluations", *METHODS):
            table.add_column(heading, justify="right")
        curves = [_minimum_so_far(report, method) for method in METHODS]
        count = max(map(len, curves))
        for n in sorted({max(1, round(f * count)) for f in _TABLE_FRACTIONS}):
            cells = (f"{c[n - 1]:.3f}" if n <= len(c) else "-" for c in curves)
            table.add_row(str(n), *cells)
        return table

    def _candidate_table(self, report: Report) -> Table:
        """Return the candidates of both methods with their scores on fresh draws."""
        table = Table(title=f"Best candidates on fresh draws ({self.score_label})")
        for heading in ("method", "score in the search", "score, mean [95 %]", "draws"):
            table.add_column(heading, justify="right")
        for rows in _by(report.rows, SCREENED, "finding").values():
            first = _origin(report, rows[0]["values"])
            table.add_row(first["phase"], f"{first['score']:.3f}", _mean(rows), str(len(rows)))
        return table

    def _finding_table(self, report: Report) -> Table:
        """Return the findings with their scores on fresh draws, and the study's metrics."""
        table = Table(title=f"Findings on fresh draws ({self.score_label})")
        for heading in (
            "finding", "method", "score in the search", "as found, mean [95 %]",
            "shrunk, mean [95 %]", "keys that are not nominal",
            *(f"shrunk: {metric.label}" for metric in report.metrics.values()),
        ):  # fmt: skip
            table.add_column(heading, justify="right")
        shrunk = _by(report.rows, SHRUNK, "finding")
        for number, rows in _by(report.rows, FOUND, "finding").items():
            first, after = _origin(report, rows[0]["values"]), shrunk.get(number, [])
            if not after:
                continue
            changed = self._changed(after[0]["values"])
            table.add_row(
                _name(number), first["phase"], f"{first['score']:.3f}", _mean(rows), _mean(after),
                f"{len(changed)} of {len(self.space.ranges)}",
                *(m.text([row[c] for row in after]) for c, m in report.metrics.items()),
            )  # fmt: skip
        return table

    def _key_table(self, report: Report) -> Table:
        """Return the keys that each shrunk finding needs, and its score without each."""
        table = Table(title=f"Keys of the shrunk findings ({self.score_label})")
        for heading in (
            "finding", "key", "nominal value", "value as found", "value as shrunk",
            "score with this key nominal, mean [95 %]",
        ):  # fmt: skip
            table.add_column(heading, justify="right")
        found, without = (_by(report.rows, phase, "finding") for phase in (FOUND, ONE_NOMINAL))
        nominal = self.space.nominal()
        for number, rows in _by(report.rows, SHRUNK, "finding").items():
            by_key = _by(without.get(number, []), ONE_NOMINAL, "key")
            for key in self._changed(rows[0]["values"]):
                values = (nominal[key], found[number][0]["values"][key], rows[0]["values"][key])
                table.add_row(_name(number), key, *map(str, values), _mean(by_key.get(key, [])))
        return table

    def _changed(self, values: Mapping[str, Any]) -> list[str]:
        """Return the keys whose value is not nominal."""
        return [key for key, nominal in self.space.nominal().items() if values[key] != nominal]

    def _plot(self, report: Report, path: Path) -> None:
        """Plot the minimum score against the number of evaluations, and all findings."""
        figure = new_figure(7.0, 4.0)
        axes = figure.add_subplot()
        for colour, method in zip(COLOURS, METHODS, strict=False):
            curve = _minimum_so_far(report, method)
            if not len(curve):
                continue
            n = np.arange(1, len(curve) + 1)
            scores = report.column("score", [r for r in report.rows if r["phase"] == method])
            axes.plot(n, scores, ".", ms=3, color=colour, alpha=0.5)
            axes.step(n, curve, where="post", color=colour, label=f"{method}, minimum so far")
        for number, rows in _by(report.rows, FOUND, "finding").items():
            low, high = _interval(rows)
            mean = report.column("score", rows).mean()
            at = (1.03 + 0.02 * number) * max(len(_minimum_so_far(report, m)) for m in METHODS)
            axes.plot([at, at], [low, high], color=COLOURS[6], lw=1)
            label = "finding on fresh draws, mean and 95 % interval" if number == 0 else None
            axes.plot(at, mean, "D", ms=4, color=COLOURS[6], label=label)
        axes.axhline(self.level, color="#666666", lw=1, ls="--", label="claimed level")
        axes.set_ylim(0.0, 1.05)
        axes.set_xlabel("Number of evaluations")
        axes.set_ylabel(self.score_label)
        axes.legend(loc="lower left")
        axes.grid(alpha=0.3)
        save(figure, path)


def _name(number: int) -> str:
    return f"finding_{number + 1}"


def _by(rows: Sequence[Row], phase: str, column: str) -> dict[Any, list[Row]]:
    """Return the rows of one phase, grouped by a column."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        if row["phase"] == phase:
            found.setdefault(row[column], []).append(row)
    return found


def _origin(report: Report, values: Mapping[str, Any]) -> Row:
    """Return the lowest row of the search among those with equal values."""
    same = (r for r in report.rows if r["phase"] in METHODS and r["values"] == values)
    return min(same, key=lambda row: row["score"])


def _minimum_so_far(report: Report, method: str) -> Array:
    """Return the minimum score after each evaluation of a method (n,)."""
    scores = report.column("score", [r for r in report.rows if r["phase"] == method])
    return np.asarray(np.minimum.accumulate(scores))


def _interval(rows: Sequence[Row]) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean score over draws."""
    return bootstrap_interval([row["score"] for row in rows], np.random.default_rng(0))


def _mean(rows: Sequence[Row]) -> str:
    """Return the mean score over draws and its interval as text."""
    if not rows:
        return "-"
    low, high = _interval(rows)
    return f"{np.mean([row['score'] for row in rows]):.3f} [{low:.3f}, {high:.3f}]"
