"""Declare a study: factors, a measurement for each case, and a report.

A study is one script in ``scenarios/``. It runs as a script or by ``lunarsim study run``, with the
same options.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import click

from lunarsim.studies.report import Metric, Report, print_metrics

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One case of a study: levels of the factors, a number, and the root seed.

    Attributes
    ----------
    levels
        Level of each factor, by factor.
    number
        Number of the repetition, from 0: of the flight, world or field.
    seed
        Root seed of the study. Random numbers derive from `seed` and `number`, so that all levels
        of the factors meet the same worlds and noise.
    options
        Values of the study's own options, by name.
    """

    levels: Mapping[str, Any]
    number: int
    seed: int
    options: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        """Return the level of a factor, or the value of an option, by its name."""
        return self.levels[name] if name in self.levels else self.options[name]


Measure = Callable[[Sequence[Case]], list[list[Row]]]
Explore = Callable[[Measure, int, int, Mapping[str, Any]], None]


@dataclass(frozen=True)
class Study:
    """Cases of a study, what is measured in each, and how the results are reported.

    Attributes
    ----------
    measure
        Function at the top level of the script. It maps a case to a row (a dictionary of numbers,
        booleans, texts and lists), or to a list of rows. The levels of the factors and the number
        of the case are added to each row.
    repeats
        Plural name of the repetitions, for instance "flights", which is also the option that sets
        their number.
    count
        Number of repetitions by default.
    factors
        Levels of each factor, by factor. The study measures all combinations.
    factor_help
        Help of each factor on the command line, where an option selects some of its levels. A
        factor without help has no option.
    options
        Further options of the command. Their values are in `Case.options`.
    metrics
        Columns of the default report, by column of the rows.
    reference
        Whether the default report compares all levels of the first factor with its first level.
    report
        Function that prints and plots the results; default: a table of `metrics` by factors.
    minimum
        Minimum number of repetitions.
    seed
        Root seed by default.
    explore
        Function that chooses the cases itself, for example a search whose next cases depend on
        results. It is called with a function that measures a batch of cases and returns the rows
        of each, the number of repetitions, the root seed and the values of the options. Default:
        the cases are all combinations of the factors.
    """

    measure: Callable[[Case], Row | list[Row]]
    repeats: str
    count: int
    factors: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    factor_help: Mapping[str, str] = field(default_factory=dict)
    options: Sequence[click.Option] = ()
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    reference: bool = False
    report: Callable[[Report], None] = print_metrics
    minimum: int = 1
    seed: int = 1
    explore: Explore | None = None

    def cases(
        self, count: int, seed: int, levels: Mapping[str, Sequence[Any]], options: Mapping[str, Any]
    ) -> list[Case]:
        """Return all cases: combinations of levels, each with all repetitions."""
        names = list(self.factors)
        return [
            Case(dict(zip(names, chosen, strict=True)), number, seed, options)
            for chosen in itertools.product(*(levels[name] for name in names))
            for number in range(count)
        ]
