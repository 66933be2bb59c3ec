"""Plot the learning curve."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunarsim.viz.style import COLOURS, new_figure, save


def draw_curve(curve: list[dict[str, float]], path: Path) -> None:
    """Plot fractions of safe landings and propellant against the training steps.

    Parameters
    ----------
    curve
        One row per evaluation, from `guidance.TrainingRun.curve`.
    path
        PNG file to write.
    """
    steps = np.array([row["steps"] for row in curve]) / 1e6
    figure = new_figure(7.0, 5.0)
    shares, burnt = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for name, label, colour in (
        ("safe", "Safe landings", COLOURS[5]),
        ("on_target", "Safe landings within 10 m", COLOURS[0]),
    ):  # fmt: skip
        shares.plot(steps, [row[name] for row in curve], color=colour, label=label)
    shares.axhline(0.95, color="#8c8c8c", linewidth=0.8, linestyle="--")
    shares.set(ylim=(-0.02, 1.02), ylabel="Fraction of 300 flights")
    shares.legend(loc="lower right")
    shares.set_title("Evaluation on held-out seeds")
    burnt.plot(steps, [row["propellant_kg"] for row in curve], color=COLOURS[1])
    burnt.set(xlabel="Environment steps (millions)", ylabel="Propellant (kg)")
    for axes in (shares, burnt):
        axes.grid(alpha=0.3)
    save(figure, path)
