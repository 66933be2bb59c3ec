"""Run a study with options from the command line."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import Progress

from lunarsim.campaign.pool import TaskPool
from lunarsim.campaign.provenance import IGNORED_DIFFERENCES
from lunarsim.console import plain_console, plain_progress
from lunarsim.errors import InputError
from lunarsim.scenario.shipped import folder
from lunarsim.studies.report import Report
from lunarsim.studies.results import (
    RESULTS,
    Journal,
    plain,
    provenance,
    read_results,
    write_results,
)
from lunarsim.studies.study import Case, Row, Study

_CONSOLE_WIDTH = 200

# What must be equal for a folder of results to be continued.
_IDENTITY = ("study", "version", "code", "script", "options")


def run_script(study: Study) -> None:
    """Run a study as a script, with the options of the command line."""
    study_command(study)()


def study_command(study: Study) -> click.Command:
    """Return the click command of a study; its help is the docstring of the script."""
    script = inspect.getmodule(study.measure)
    text = inspect.getdoc(script) or ""
    options = [
        click.Option(
            [f"--{study.repeats}", "count"], type=click.IntRange(min=study.minimum),
            default=study.count, show_default=True,
            help=f"Number of {study.repeats} for each combination of factors.",
        ),
        *(_factor_option(study, name) for name in study.factor_help),
        *study.options,
        click.Option(
            ["--seed"], type=click.IntRange(min=0), default=study.seed, show_default=True,
            help="Seed from which all random numbers derive.",
        ),
        click.Option(
            ["--jobs"], type=click.IntRange(min=1), default=1, show_default=True,
            help="Number of parallel processes; it does not change the results.",
        ),
        click.Option(
            ["--out"], type=click.Path(file_okay=False, path_type=Path),
            help="Folder for results and figures. A study that was interrupted continues there. "
            "Default: none.",
        ),
    ]  # fmt: skip
    return click.Command(
        study_name(study), params=list(options), callback=_callback(study),
        help="\b\n" + text.replace("\n\n", "\n\n\b\n"),
        short_help=text.split("\n", maxsplit=1)[0],
        context_settings={"help_option_names": ["-h", "--help"]},
    )  # fmt: skip


def _factor_option(study: Study, name: str) -> click.Option:
    """Return the option that selects levels of a factor."""
    return click.Option(
        [f"--{name.replace('_', '-')}", name], multiple=True,
        type=click.Choice([str(level) for level in study.factors[name]]),
        help=f"{study.factor_help[name]} Repeat the option for several. Default: all.",
    )  # fmt: skip


def study_script(study: Study) -> Path:
    """Return the file of a study."""
    return Path(inspect.getfile(study.measure)).resolve()


def study_name(study: Study) -> str:
    """Return the name of a study: its file in the folder of scenarios, without suffix."""
    path, root = study_script(study), folder().resolve()
    return str(path.relative_to(root).with_suffix("")) if path.is_relative_to(root) else path.stem


def _callback(study: Study) -> Any:
    def run(count: int, seed: int, jobs: int, out: Path | None, **others: Any) -> None:
        levels = {
            name: [one for one in every if not others.get(name) or str(one) in others[name]]
            for name, every in study.factors.items()
        }
        options = {name: value for name, value in others.items() if name not in study.factors}
        console = plain_console(_CONSOLE_WIDTH)
        try:
            rows = run_study(
                study, count=count, seed=seed, jobs=jobs, levels=levels, options=options, out=out,
                console=console,
            )  # fmt: skip
            report_study(study, rows, seed=seed, options=options, out=out, console=console)
            if out is not None:
                console.print(f"results: {out / RESULTS}", soft_wrap=True)
        except InputError as error:
            raise click.UsageError(str(error)) from None

    return run


def run_study(
    study: Study, *, count: int | None = None, seed: int | None = None, jobs: int = 1,
    levels: Mapping[str, Sequence[Any]] | None = None, options: Mapping[str, Any] | None = None,
    out: Path | None = None, console: Console | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Measure all cases of a study that a folder does not hold yet; return all rows.

    Parameters
    ----------
    study
        The study.
    count, seed
        Number of repetitions and root seed; default: those of the study.
    jobs
        Number of processes.
    levels
        Levels of the factors; default: all.
    options
        Values of the study's own options; default: their defaults.
    out
        Folder for the results; a study that was interrupted continues there.
    console
        Console of the progress bar.

    Returns
    -------
    list
        Rows of all cases, in their order. After an interrupt with some finished cases: the rows
        from the first case up to the first gap.

    Raises
    ------
    InputError
        If the folder holds other results.
    """
    count = study.count if count is None else count
    seed = study.seed if seed is None else seed
    values = {**_defaults(study), **(options or {})}
    chosen = {name: list((levels or {}).get(name, every)) for name, every in study.factors.items()}
    identity = provenance(
        study_name(study), study_script(study),
        {study.repeats: count, "seed": seed, "levels": chosen, **values},
    )  # fmt: skip
    same = {key: identity[key] for key in _IDENTITY}
    same["machine"] = {k: v for k, v in identity["machine"].items() if k not in IGNORED_DIFFERENCES}
    journal, complete = Journal(out, same), False
    with plain_progress(console or plain_console(_CONSOLE_WIDTH)) as progress:
        try:
            with TaskPool(jobs) as pool:
                batches = _Batches(study, journal, pool, progress)
                if study.explore is None:
                    batches(study.cases(count, seed, chosen, values))
                else:
                    study.explore(batches, count, seed, values)
            complete = True
        except KeyboardInterrupt:
            if 0 not in journal.finished:
                raise
            done, known = len(journal.finished), len(batches.cases)
            progress.console.print(f"Interrupted after {done} of {known} cases.")
    rows = _joined(batches.cases, journal.finished)
    if out is not None:
        found = {"complete": complete, "columns": _labels(study), "rows": rows}
        write_results(out, {**identity, **found})
    return rows


class _Batches:
    """Measures batches of cases of a study, except those that the journal holds."""

    def __init__(self, study: Study, journal: Journal, pool: TaskPool, progress: Progress) -> None:
        self._measure, self._journal, self._pool = study.measure, journal, pool
        self._progress, self._bar = progress, progress.add_task("cases", total=0)
        self.cases: list[Case] = []

    def __call__(self, batch: Sequence[Case]) -> list[list[Row]]:
        """Return the rows of each case of a batch."""
        finished, first = self._journal.finished, len(self.cases)
        self.cases += batch
        indices = range(first, len(self.cases))
        waiting = [index for index in indices if index not in finished]
        done = len(self.cases) - len(waiting)
        self._progress.update(self._bar, total=len(self.cases), completed=done)
        tasks = [self.cases[index] for index in waiting]
        for n, rows in self._pool.iterate_results(self._measure, tasks):
            self._journal.add(waiting[n], rows)
            self._progress.advance(self._bar)
        return [_as_list(finished[index]) for index in indices]


def _as_list(rows: Row | list[Row]) -> list[Row]:
    return [rows] if isinstance(rows, dict) else rows


def _defaults(study: Study) -> dict[str, Any]:
    """Return the values of the study's own options if none is given."""
    return click.Command("study", params=list(study.options)).make_context("study", []).params


def _labels(study: Study) -> dict[str, str]:
    """Return quantity and unit of each metric, by column."""
    return {name: metric.label for name, metric in study.metrics.items()}


def _joined(cases: Sequence[Case], finished: Mapping[int, Any]) -> list[dict[str, Any]]:
    """Return the rows of all cases before the first unfinished case.

    Each row also gets the levels of the factors and the number of its case.
    """
    rows = []
    for index, case in enumerate(cases):
        if index not in finished:
            break
        for row in _as_list(finished[index]):
            rows.append({**plain(case.levels), "number": case.number, **row})
    return rows


def report_study(
    study: Study, rows: list[dict[str, Any]], *, seed: int | None = None,
    options: Mapping[str, Any] | None = None, out: Path | None = None,
    console: Console | None = None,
) -> None:  # fmt: skip
    """Print and plot the rows of a study; the parameters are those of `run_study`."""
    study.report(
        Report(
            rows, list(study.factors), study.repeats, study.metrics, study.reference,
            {**_defaults(study), **(options or {})},
            study.seed if seed is None else seed, console or plain_console(_CONSOLE_WIDTH), out,
        )
    )  # fmt: skip


def report_folder(study: Study, folder: Path) -> None:
    """Print and plot the results of a study in a folder again.

    Raises
    ------
    InputError
        If the folder has no readable results of this study.
    """
    found = read_results(folder, study_name(study))
    report_study(
        study, found["rows"], seed=found["options"]["seed"], options=found["options"], out=folder,
        console=plain_console(_CONSOLE_WIDTH),
    )  # fmt: skip
