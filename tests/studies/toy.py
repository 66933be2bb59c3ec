"""Measure the mean of random numbers.

A study for tests.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from lunarsim.studies import Case, Metric, Study, run_script

# Cases that are measured write a file here; a file "stop" interrupts the third case.
TRACES: Path | None = None


def measure(case: Case) -> list[dict[str, Any]]:
    """Return two rows per case."""
    if case["traces"]:
        folder = Path(case["traces"])
        if (folder / "stop").exists() and len(list(folder.iterdir())) == 3:
            raise KeyboardInterrupt
        (folder / f"{case['size']}-{case['shift']}-{case.number}").touch()
    rng = np.random.default_rng([case.seed, case.number])
    values = case["shift"] + rng.standard_normal(case["size"])
    return [
        {"mean": values.mean(), "positive": values.mean() > 0.0, "values": values[:2], "half": half}
        for half in range(2)
    ]


study = Study(
    measure,
    repeats="draws",
    count=4,
    factors={"size": (10, 1000), "shift": (0.0, 1.0)},
    factor_help={"size": "Number of values."},
    options=(click.Option(["--traces"], default="", help="Folder for traces."),),
    metrics={
        "mean": Metric("mean (m)", "median-max", 2), "positive": Metric("positive", "share"),
    },
    reference=True,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
