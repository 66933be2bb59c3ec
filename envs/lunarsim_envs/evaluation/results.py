"""Compute and write evaluation results: metrics per agent, paired differences."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import lunarsim
from lunarsim.atomic_files import atomic_write, atomic_write_text
from lunarsim.campaign.analysis import arm_pairs
from lunarsim.evaluation.comparisons import (
    Difference,
    bootstrap_interval,
    holm_correction,
    mean_difference,
    share_difference,
)
from lunarsim.evaluation.statistics import Proportion
from lunarsim.rng import design_seed
from lunarsim.typing import Array
from lunarsim_envs.evaluation.parallel import Rows


@dataclass(frozen=True)
class BootstrapMean:
    """Mean of finite values with its 95 % bootstrap interval, `low` to `high`."""

    value: float
    low: float
    high: float

    def text(self, digits: int) -> str:
        """Format as ``value [low, high]`` with `digits` decimals, or as a dash for NaN."""
        if not np.isfinite(self.value):
            return "-"
        if not np.isfinite(self.low):
            return f"{self.value:.{digits}f}"
        return f"{self.value:.{digits}f} [{self.low:.{digits}f}, {self.high:.{digits}f}]"


@dataclass(frozen=True)
class AgentMetrics:
    """Performance metrics of one agent over the episodes of an evaluation.

    Attributes
    ----------
    name, episodes
        Name of the agent, and number of episodes.
    score, steps
        Return without shaping, and number of steps per episode.
    safe, on_target
        Fraction of safe landings, and of safe landings near the target; None if the environment
        does not report them.
    propellant, miss
        Propellant used (kg) and miss distance (m) of safe landings.
    """

    name: str
    episodes: int
    score: BootstrapMean
    steps: BootstrapMean
    safe: Proportion | None
    on_target: Proportion | None
    propellant: BootstrapMean
    miss: BootstrapMean


def column(rows: Rows, name: str) -> Array:
    """Return the values `name` of all episodes (n,); NaN where a value is missing."""
    return np.array([float(row.get(name, np.nan)) for row in rows], dtype=np.float64)


def add_on_target(rows: Rows, max_distance: float) -> Rows:
    """Add ``on_target`` to each row: whether the landing was safe and near the target.

    `max_distance` is in m. Episodes without an outcome or distance are unchanged.
    """
    return [
        row | {"on_target": bool(row["safe"] and row["miss_m"] <= max_distance)}
        if "miss_m" in row and "safe" in row
        else row
        for row in rows
    ]


def _true_fraction(rows: Rows, name: str) -> Proportion | None:
    """Return the fraction of episodes in which `name` is true.

    If a row lacks the value, the result is None.
    """
    if not all(name in row for row in rows):
        return None
    return Proportion(sum(bool(row[name]) for row in rows), len(rows))


def agent_metrics(rows: Rows, seed: int) -> list[AgentMetrics]:
    """Compute the metrics of every agent from the rows of its episodes.

    Agents are in the order of the rows; `seed` is that of the bootstrap intervals.
    """
    rng = np.random.default_rng(design_seed(seed))

    def mean(own: Rows, name: str) -> BootstrapMean:
        values = column(own, name)
        values = values[np.isfinite(values)]
        if not len(values):
            return BootstrapMean(*3 * (float("nan"),))
        return BootstrapMean(float(values.mean()), *bootstrap_interval(values, rng))

    found = []
    for agent in dict.fromkeys(row["agent"] for row in rows):
        own = [row for row in rows if row["agent"] == agent]
        landed = [row for row in own if row.get("safe", False)]
        found.append(
            AgentMetrics(
                agent, len(own), mean(own, "score"), mean(own, "steps"),
                _true_fraction(own, "safe"), _true_fraction(own, "on_target"),
                mean(landed, "propellant_kg"), mean(landed, "miss_m"),
            )
        )  # fmt: skip
    return found


def differences(rows: Rows, seed: int) -> dict[str, list[Difference]]:
    """Return paired differences between agents on the same episodes, by metric.

    `rows` are the results of all episodes and `seed` is that of the bootstrap intervals. Safe
    landings are compared on all episodes, propellant on episodes in which both agents landed
    safely. The p-values of one metric are corrected for multiple comparisons (Holm).
    """
    rng = np.random.default_rng(design_seed(seed))
    agents = list(dict.fromkeys(row["agent"] for row in rows))
    mine = {a: [row for row in rows if row["agent"] == a] for a in agents}
    made: dict[str, list[Difference]] = {"score": [], "safe": [], "propellant_kg": []}
    for pair in arm_pairs(agents):
        first, second = (mine[name] for name in pair)
        made["score"].append(
            mean_difference(column(first, "score"), column(second, "score"), pair, rng)
        )
        if not all("safe" in row for row in (*first, *second)):
            continue
        safe = [column(own, "safe") > 0.5 for own in (first, second)]
        made["safe"].append(share_difference(safe[0], safe[1], pair))
        both = safe[0] & safe[1]
        a, b = (np.where(both, column(own, "propellant_kg"), np.nan) for own in (first, second))
        if np.isfinite(a - b).any():
            made["propellant_kg"].append(mean_difference(a, b, pair, rng))
    return {metric: _corrected(found) for metric, found in made.items() if found}


def _corrected(differences: list[Difference]) -> list[Difference]:
    """Return differences with p-values corrected for multiple comparisons (Holm)."""
    corrected = holm_correction([d.p for d in differences])
    return [replace(d, corrected=float(p)) for d, p in zip(differences, corrected, strict=True)]


def write(
    out: Path, rows: Rows, arguments: dict[str, Any], metrics: list[AgentMetrics],
    paired_differences: dict[str, list[Difference]],
) -> None:  # fmt: skip
    """Write ``results.parquet`` (one row per episode and agent) and ``summary.json``.

    Parameters
    ----------
    out
        Folder to write to; it is created if needed.
    rows
        Results of the episodes.
    arguments
        Arguments of the evaluation, stored in the summary.
    metrics, paired_differences
        Metrics of agents, and differences between agents.
    """
    out.mkdir(parents=True, exist_ok=True)
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = pa.table({name: [row.get(name) for row in rows] for name in names})
    atomic_write(out / "results.parquet", lambda part: pq.write_table(table, part))
    summary = arguments | {
        "version": lunarsim.__version__,
        "agents": [asdict(agent) for agent in metrics],
        "differences": {
            metric: [asdict(d) for d in many] for metric, many in paired_differences.items()
        },
    }
    atomic_write_text(out / "summary.json", json.dumps(_finite(summary), indent=1))


def _finite(value: Any) -> Any:
    """Replace numbers that JSON cannot represent (NaN, inf) in nested data by None."""
    if isinstance(value, dict):
        return {key: _finite(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(own) for own in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
