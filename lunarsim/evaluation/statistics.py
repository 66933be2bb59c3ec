"""Statistics of a campaign."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest


@dataclass(frozen=True)
class Proportion:
    """A share with its 95 % Wilson interval.

    Attributes
    ----------
    count, total
        Successes and trials.
    """

    count: int
    total: int

    @property
    def value(self) -> float:
        """The share; NaN without trials."""
        return self.count / self.total if self.total else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson score interval at 95 %."""
        if self.total == 0:
            return (0.0, 1.0)
        ci = binomtest(self.count, self.total).proportion_ci(0.95, method="wilson")
        return float(ci.low), float(ci.high)

    def __str__(self) -> str:
        """Return ``value [low, high]``."""
        low, high = self.interval
        return f"{self.value:.3f} [{low:.3f}, {high:.3f}]"


def summarise(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the summary of each policy, in the order the policies appear.

    Precision and recall pool the cells of all flights. ``safe_in_reach`` counts only flights in
    which the scanned ground held an exactly safe site within reach.
    """
    summary: dict[str, dict[str, Any]] = {}
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == policy]
        reach = [row for row in own if row["safe_site_in_reach"]]
        hits = sum(row["map_hits"] for row in own)
        called = hits + sum(row["map_false_safe"] for row in own)
        true = hits + sum(row["map_missed"] for row in own)

        def column(name: str, own: list[dict[str, Any]] = own) -> np.ndarray:
            return np.array([row[name] for row in own], dtype=np.float64)

        summary[policy] = {
            "flights": len(own),
            "safe": Proportion(sum(row["safe"] for row in own), len(own)),
            "safe_in_reach": Proportion(sum(row["safe"] for row in reach), len(reach)),
            "propellant_median_kg": float(np.median(column("propellant_kg"))),
            "propellant_p95_kg": float(np.percentile(column("propellant_kg"), 95)),
            "divert_median_m": float(np.median(column("divert_m"))),
            "vertical_speed_max_m_s": _peak(column("vertical_speed_m_s")),
            "horizontal_speed_max_m_s": _peak(column("horizontal_speed_m_s")),
            "tilt_max_deg": _peak(column("tilt_deg")),
            "precision": hits / called if called else float("nan"),
            "recall": hits / true if true else float("nan"),
        }
    return summary


def _peak(values: np.ndarray) -> float:
    """Return the greatest finite value, NaN without any."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else float("nan")
