"""Search the minimum of a noisy function of eight keys, of which only two matter.

A study for tests.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click
import numpy as np

from lunarsim.scenario import Scenario
from lunarsim.search import ChoiceRange, ContinuousRange, SearchSpace
from lunarsim.studies import Case, Metric, Study, run_script
from lunarsim.studies.worst_case import OPTIONS, WorstCaseProblem

SPACE = SearchSpace(
    {
        "rocks.cover": ContinuousRange(0.01, 0.19, 0.05),
        "rocks.shape": ChoiceRange(("hemisphere", "cube"), "hemisphere"),
        **{f"vehicle.{name}": ContinuousRange(a, b, 0.5 * (a + b)) for name, a, b in (
            ("leg_radius_m", 1.0, 4.0), ("com_height_m", 1.0, 3.0), ("slope_limit_deg", 5.0, 15.0),
            ("roughness_limit_m", 0.1, 0.5), ("belly_clearance_m", 0.1, 0.5),
            ("pad_diameter_m", 0.1, 0.5),
        )},
    }
)  # fmt: skip


def build(values: Any) -> Scenario:
    """Return the scenario of a set of values."""
    tables: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        table, name = key.split(".")
        tables.setdefault(table, {})[name] = value
    return Scenario.from_dict(tables)


def measure(case: Case) -> dict[str, Any]:
    """Return a score that cover and shape determine; the noise depends on the draw."""
    if case["traces"]:
        folder = Path(case["traces"])
        if (folder / "stop").exists() and len(list(folder.iterdir())) == 60:
            raise KeyboardInterrupt
        (folder / f"{len(list(folder.iterdir()))}").touch()
    values = case["values"]
    deficit = 0.6 * math.exp(-(((values["rocks.cover"] - 0.15) / 0.05) ** 2))
    if values["rocks.shape"] != "cube":
        deficit *= 0.2
    noise = 0.01 * np.random.default_rng([case.seed, case.number]).standard_normal()
    return {"score": 1.0 - deficit + noise, "deficit": deficit}


PROBLEM = WorstCaseProblem(SPACE, build, 0.95, "toy score")

study = Study(
    measure,
    repeats="evaluations",
    count=60,
    options=(*OPTIONS, click.Option(["--traces"], default="", help="Folder for traces.")),
    metrics={"deficit": Metric("deficit", "median", 2)},
    explore=PROBLEM.explore,
    report=PROBLEM.report,
)

if __name__ == "__main__":
    run_script(study)
