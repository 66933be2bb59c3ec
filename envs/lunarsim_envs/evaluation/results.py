"""What episodes gave: every agent by itself, agents against each other, and the files of both."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

import lunarsim
from lunarsim.campaign.analysis import pairs_of
from lunarsim.evaluation.comparisons import (
    Difference,
    holm,
    mean_bootstrap,
    mean_difference,
    share_difference,
)
from lunarsim.evaluation.statistics import Proportion
from lunarsim.rng import design_seed
from lunarsim.whole_files import write_text_whole, write_whole
from lunarsim_envs.evaluation.running import Rows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mean:
    """A mean with its bootstrap interval at 95 %, over the values that there are."""

    value: float
    low: float
    high: float

    def text(self, digits: int) -> str:
        """Return ``value [low, high]``; a dash without values."""
        if not np.isfinite(self.value):
            return "-"
        if not np.isfinite(self.low):
            return f"{self.value:.{digits}f}"
        return f"{self.value:.{digits}f} [{self.low:.{digits}f}, {self.high:.{digits}f}]"


@dataclass(frozen=True)
class AgentFigures:
    """One agent by itself.

    Attributes
    ----------
    name, episodes
        Whose, and how many.
    score, steps
        Return less shaping, and length of an episode.
    safe, on_target
        Share that landed safe, and safe near enough to the target; None where an environment tells
        neither.
    propellant, miss
        Of safe landings, kg and m.
    """

    name: str
    episodes: int
    score: Mean
    steps: Mean
    safe: Proportion | None
    on_target: Proportion | None
    propellant: Mean
    miss: Mean


def column(rows: Rows, name: str) -> Array:
    """Return a column of some rows (n,); NaN where a row has none."""
    return np.array([float(row.get(name, np.nan)) for row in rows], dtype=np.float64)


def with_target(rows: Rows, within: float) -> Rows:
    """Return rows that also tell whether a safe landing was within so many metres."""
    return [
        row | {"on_target": bool(row["safe"] and row["miss_m"] <= within)}
        if "miss_m" in row and "safe" in row
        else row
        for row in rows
    ]


def _share(rows: Rows, name: str) -> Proportion | None:
    if not all(name in row for row in rows):
        return None
    return Proportion(sum(bool(row[name]) for row in rows), len(rows))


def figures(rows: Rows, seed: int) -> list[AgentFigures]:
    """Return every agent's figures, in the order in which they come in the rows."""
    rng = np.random.default_rng(design_seed(seed))

    def mean(own: Rows, name: str) -> Mean:
        values = column(own, name)
        values = values[np.isfinite(values)]
        if not len(values):
            return Mean(*3 * (float("nan"),))
        return Mean(float(values.mean()), *mean_bootstrap(values, rng))

    found = []
    for agent in dict.fromkeys(row["agent"] for row in rows):
        own = [row for row in rows if row["agent"] == agent]
        landed = [row for row in own if row.get("safe", False)]
        found.append(
            AgentFigures(
                agent, len(own), mean(own, "score"), mean(own, "steps"), _share(own, "safe"),
                _share(own, "on_target"), mean(landed, "propellant_kg"), mean(landed, "miss_m"),
            )
        )  # fmt: skip
    return found


def differences(rows: Rows, seed: int) -> dict[str, list[Difference]]:
    """Return differences between agents on the same episodes, by metric.

    The share of safe landings is compared on all episodes, propellant on those that both landed
    safe. Tests of one metric are corrected for their number.
    """
    rng = np.random.default_rng(design_seed(seed))
    agents = list(dict.fromkeys(row["agent"] for row in rows))
    mine = {a: [row for row in rows if row["agent"] == a] for a in agents}
    made: dict[str, list[Difference]] = {"score": [], "safe": [], "propellant_kg": []}
    for pair in pairs_of(agents):
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


def _corrected(found: list[Difference]) -> list[Difference]:
    corrected = holm([d.p for d in found])
    return [replace(d, corrected=float(p)) for d, p in zip(found, corrected, strict=True)]


def write(
    out: Path, rows: Rows, told: dict[str, Any], found: list[AgentFigures],
    between: dict[str, list[Difference]],
) -> None:  # fmt: skip
    """Write ``results.parquet``, a row an episode and agent, and ``summary.json``.

    Parameters
    ----------
    out
        Folder; made if it is not there.
    rows, told
        Episodes, and what was asked for.
    found, between
        Figures of agents, and differences between them.
    """
    out.mkdir(parents=True, exist_ok=True)
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = pa.table({name: [row.get(name) for row in rows] for name in names})
    write_whole(out / "results.parquet", lambda part: pq.write_table(table, part))
    summary = told | {
        "version": lunarsim.__version__,
        "agents": [asdict(agent) for agent in found],
        "differences": {metric: [asdict(d) for d in many] for metric, many in between.items()},
    }
    write_text_whole(out / "summary.json", json.dumps(_finite(summary), indent=1))


def _finite(value: Any) -> Any:
    """Return a value in which numbers that JSON has no word for are None."""
    if isinstance(value, dict):
        return {key: _finite(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(own) for own in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
