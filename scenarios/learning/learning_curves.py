"""Learning curves of PPO over several training seeds, with intervals.

    python scenarios/learning/learning_curves.py --jobs 2 --out out/curves
    python scenarios/learning/learning_curves.py --environment Guidance-v1 --seeds 2

Every tenth of a training, its agent flies 300 episodes of the split "validation"; after the
training, it flies 500 of the split "test". Intervals (95 %) are those of the mean over training
seeds, by Student's distribution. The trainings are those of `train_descents.py` and, for
Retarget-v1, of `masked_ppo.py`. The study needs the extra `rl`.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.stats import t as student

from lunarsim import InputError
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.viz.style import COLOURS, new_figure, save
from lunarsim_envs.training.settings import SETTINGS, PpoSettings

CHECKS, FLIGHTS, TEST_FLIGHTS = 10, 300, 500
# The agent supplied for Guidance-v1 is trained for longer, from wider starts.
DESCENTS = SETTINGS | {
    "Guidance-v1": PpoSettings(steps=5_000_000, position_sigma=30.0, velocity_sigma=3.0)
}
ENVIRONMENTS = (*DESCENTS, "Retarget-v1")
TEST = "test"
Rows = list[dict[str, Any]]


def train(case: Case) -> Rows:
    """Train an agent with one seed; return a row per evaluation, the last one of the test split."""
    try:
        import sb3_contrib
    except ModuleNotFoundError as error:
        raise InputError(
            "learning_curves", None, f"needs the package {error.name}, which is not installed",
            "Install the extra `rl`.", show_value=False,
        ) from None  # fmt: skip
    assert sb3_contrib.__name__
    rows: Rows = []

    def add(steps: int, seconds: float, split: str, result: Any) -> None:
        rows.append({
            "steps": steps, "seconds": seconds, "split": split, "safe": result.safe,
            "on_target": result.on_target, "propellant_kg": result.propellant,
        })  # fmt: skip

    seed = case.seed + case.number
    if case["environment"] in DESCENTS:
        _train_descents(DESCENTS[case["environment"]], case["steps"], seed, add)
    else:
        import masked_ppo

        masked_ppo.train(case["steps"] or masked_ppo.STEPS, seed, CHECKS, add)
    return rows


def _train_descents(settings: Any, steps: int | None, seed: int, add: Any) -> None:
    """Train an agent of Guidance-v1 or Control-v1; call `add` with the result of each evaluation.

    `steps` is the number of steps, None for that of the settings.
    """
    from lunarsim_envs.training.descents import TrainingRun

    settings = replace(settings, steps=steps or settings.steps, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        run = TrainingRun(settings, Path(folder))
        due = {-(-settings.updates * k // CHECKS) for k in range(1, CHECKS + 1)}
        while run.done < settings.updates:
            run.advance()
            if run.done in due:
                result = run.fly("validation", FLIGHTS)
                add(int(run.model.num_timesteps), run.seconds, "validation", result)
        add(int(run.model.num_timesteps), run.seconds, TEST, run.fly(TEST, TEST_FLIGHTS))


def mean_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the mean of n values and the half width of its 95 % interval; NaN if n is 1."""
    n = len(values)
    if n < 2:
        return float(values.mean()), np.nan
    spread = student.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n)
    return float(values.mean()), float(spread)


def print_curves(report: Report) -> None:
    """Print the results on the test split by environment, and draw the learning curves."""
    table = Table(
        "environment", "seeds", "steps", "minutes per training",
        "safe landings of the test split,\nmean over seeds [95 %]", "lowest / highest seed",
        "safe within 10 m", "propellant (kg)", title="Trained agents",
    )  # fmt: skip
    for (environment,), rows in report.groups("environment").items():
        last = [row for row in rows if row["split"] == TEST]
        safe, on_target, spent = (
            report.column(name, last) for name in ("safe", "on_target", "propellant_kg")
        )
        mean, half = mean_interval(safe)
        interval = f" [{mean - half:.3f}, {min(mean + half, 1.0):.3f}]" if len(safe) > 1 else ""
        table.add_row(
            environment, str(len(last)), f"{last[0]['steps']:,}",
            f"{report.column('seconds', last).mean() / 60.0:.1f}",
            f"{mean:.3f}{interval}",
            f"{safe.min():.3f} / {safe.max():.3f}",
            "-" if np.isnan(on_target).all() else f"{on_target.mean():.3f}",
            f"{spent.mean():.1f}",
        )  # fmt: skip
    report.print(table)
    if report.out is not None:
        draw_curves(report, report.out / "curves.png")


def draw_curves(report: Report, path: Path) -> None:
    """Draw the share of safe landings over the steps of each environment's trainings."""
    groups = report.groups("environment")
    figure = new_figure(4.0 * len(groups), 3.2)
    axes = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for one, ((environment,), rows) in zip(axes, groups.items(), strict=True):
        curves: dict[int, list[dict[str, Any]]] = {}
        for row in rows:
            if row["split"] != TEST:
                curves.setdefault(row["number"], []).append(row)
        steps = np.array([row["steps"] for row in next(iter(curves.values()))]) / 1e6
        safe = np.array([[row["safe"] for row in curve] for curve in curves.values()])
        for curve in safe:
            one.plot(steps, curve, color=COLOURS[0], linewidth=0.7, alpha=0.5)
        mean, half = np.array([mean_interval(column) for column in safe.T]).T
        one.plot(steps, mean, color=COLOURS[0], linewidth=2.0, label="Mean over seeds")
        if len(safe) > 1:
            one.fill_between(
                steps, np.clip(mean - half, 0, 1), np.clip(mean + half, 0, 1), alpha=0.25,
                color=COLOURS[0], linewidth=0.0, label="95 % interval of the mean",
            )  # fmt: skip
        one.axhline(0.95, color="#8c8c8c", linewidth=0.8, linestyle="--")
        one.set(title=environment, xlabel="Environment steps (millions)", ylim=(-0.02, 1.02))
        one.grid(alpha=0.3)
    axes[0].set_ylabel(f"Safe landings, of {FLIGHTS} flights")
    axes[0].legend(loc="lower right", fontsize=8)
    save(figure, path)


study = Study(
    train,
    repeats="seeds",
    count=5,
    factors={"environment": ENVIRONMENTS},
    factor_help={"environment": "Environment of the training."},
    options=[
        click.Option(
            ["--steps"], type=click.IntRange(min=1), default=None,
            help="Number of steps of each training. Default: that of the environment's settings.",
        )
    ],
    report=print_curves,
    seed=0,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
