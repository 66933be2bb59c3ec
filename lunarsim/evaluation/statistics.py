"""Statistics of a campaign."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest
from scipy.stats import t as student

from lunarsim.evaluation.map_quality import MapQuality


@dataclass(frozen=True)
class Proportion:
    """A proportion of successes with its 95 % Wilson interval.

    Attributes
    ----------
    count, total
        Number of successes and of trials.

    Examples
    --------
    >>> print(Proportion(18, 20))
    0.900 [0.699, 0.972]
    """

    count: int
    total: int

    @property
    def value(self) -> float:
        """Fraction of successes; NaN without trials."""
        return self.count / self.total if self.total else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % Wilson score interval of the proportion."""
        if self.total == 0:
            return (0.0, 1.0)
        ci = binomtest(self.count, self.total).proportion_ci(0.95, method="wilson")
        return float(ci.low), float(ci.high)

    def __str__(self) -> str:
        """Return the proportion and its interval as text: ``value [low, high]``."""
        low, high = self.interval
        return f"{self.value:.3f} [{low:.3f}, {high:.3f}]"


@dataclass(frozen=True)
class MeanInterval:
    """A mean with its 95 % confidence interval.

    Attributes
    ----------
    mean
        Mean; NaN without values.
    half
        Half width of the interval; NaN for fewer than two values.
    """

    mean: float
    half: float

    def text(self, digits: int = 4) -> str:
        """Return ``mean ± half`` as text with a number of decimal digits."""
        return f"{self.mean:.{digits}f} ± {self.half:.{digits}f}"


def mean_interval(values: ArrayLike) -> MeanInterval:
    """Return the mean of values (n,) with its 95 % confidence interval (Student's t).

    NaN values are ignored.

    Examples
    --------
    >>> print(mean_interval([0.8, 0.9, 1.0, 0.9]).text(3))
    0.900 ± 0.130
    """
    x = np.asarray(values, dtype=np.float64)
    x = x[np.isfinite(x)]
    mean = float(x.mean()) if x.size else float("nan")
    if x.size < 2:
        return MeanInterval(mean, float("nan"))
    half = float(student.ppf(0.975, x.size - 1) * x.std(ddof=1) / np.sqrt(x.size))
    return MeanInterval(mean, half)


def summarise_policies(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return summary statistics of each policy's flights, by policy and statistic.

    `rows` are result rows of flights, as from `flight_metrics.evaluate`; policies keep their order.

    Precision and recall pool the cells of all flights. ``safe_in_reach`` counts only flights in
    which an exactly safe site of the mapped terrain was within reach.
    """
    summary: dict[str, dict[str, Any]] = {}
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == policy]
        reach = [row for row in own if row["safe_site_in_reach"]]
        hits, false_safe, missed = (
            sum(row[name] for row in own)
            for name in ("map_true_safe", "map_false_safe", "map_false_unsafe")
        )
        quality = MapQuality(hits, false_safe, missed, rejected=0)

        def column(name: str, own: list[dict[str, Any]] = own) -> np.ndarray:
            return np.array([row[name] for row in own], dtype=np.float64)

        summary[policy] = {
            "flights": len(own),
            "aborted": sum(row["aborted"] for row in own),
            "safe": Proportion(sum(row["safe"] for row in own), len(own)),
            "safe_in_reach": Proportion(sum(row["safe"] for row in reach), len(reach)),
            "propellant_median_kg": float(np.median(column("propellant_kg"))),
            "propellant_p95_kg": float(np.percentile(column("propellant_kg"), 95)),
            "divert_median_m": float(np.median(column("divert_m"))),
            "vertical_speed_max_m_s": _finite_max(column("vertical_speed_m_s")),
            "horizontal_speed_max_m_s": _finite_max(column("horizontal_speed_m_s")),
            "tilt_max_deg": _finite_max(column("tilt_deg")),
            "precision": quality.precision,
            "recall": quality.recall,
        }
    return summary


def _finite_max(values: np.ndarray) -> float:
    """Return the maximum of the finite values, or NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else float("nan")
