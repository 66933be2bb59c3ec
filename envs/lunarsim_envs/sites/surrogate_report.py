"""Compare maps of a surrogate with maps of its mapper on the same terrain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.typing import Array, BoolArray
from lunarsim_envs.sites import hazard
from lunarsim_envs.sites.map_samples import MapSample, SampledFlight
from lunarsim_envs.sites.surrogate import Surrogate
from lunarsim_envs.sites.surrogate_maps import correlation_length, draw_surrogate_maps, is_evaluated

# Classification thresholds: safe at or above the first p_safe, unsafe below the second.
TOLD_SAFE, TOLD_UNSAFE = 0.9, 0.5
_SIZES = np.append(hazard.SIZES, np.inf)
_RESAMPLES = 50


@dataclass(frozen=True)
class SurrogateMapQuality:
    """Quality metrics of p_safe maps: names and values (n,) in the same order."""

    names: tuple[str, ...]
    values: Array


def quality(
    samples: Sequence[MapSample], maps: Sequence[NDArray[np.float32]]
) -> SurrogateMapQuality:
    """Compute calibration error, false rates and correlation length of p_safe maps.

    `maps` are maps of p_safe; `samples` have the true classes and safety of their cells.
    """
    masks = [is_evaluated(sample) for sample in samples]
    p = np.concatenate([one[mask] for one, mask in zip(maps, masks, strict=True)])
    safe = np.concatenate([sample.safe[mask] for sample, mask in zip(samples, masks, strict=True)])
    kind = np.concatenate([sample.kind[mask] for sample, mask in zip(samples, masks, strict=True)])
    named = {"calibration error": _calibration_error(p, safe), "mean p_safe": float(p.mean())}
    size = np.append(0.0, _SIZES)[hazard.size_class(kind)]
    for low, high in ((1.0, 1.25), (1.25, 1.5), (1.5, np.inf)):
        own = ~safe & (size >= low) & (size < high)
        name = f"unsafe, {low:g} to {high:g} of the limit, classified safe"
        named[name] = _wrong_fraction(p[own] >= TOLD_SAFE)
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 1.0)):
        own = safe & (size >= low) & (size < high)
        name = f"safe, {low:g} to {high:g} of the limit, classified unsafe"
        named[name] = _wrong_fraction(p[own] < TOLD_UNSAFE)
    edge = kind.astype(int) % (len(hazard.DISTANCES) + 1)
    for words, own in (
        ("unsafe, over 0.5 m from the edge, classified safe", ~safe & (edge <= 2)),
        ("unsafe, at the edge, classified safe", ~safe & (edge > 2)),
    ):
        named[words] = _wrong_fraction(p[own] >= TOLD_SAFE)
    for words, own in (
        ("safe, over 0.9 m from the edge, classified unsafe", safe & (edge >= 8)),
        ("safe, at the edge, classified unsafe", safe & (edge < 8)),
    ):
        named[words] = _wrong_fraction(p[own] < TOLD_UNSAFE)
    named["correlation length (m)"] = correlation_length(samples, maps)
    return SurrogateMapQuality(tuple(named), np.array(list(named.values())))


def _wrong_fraction(is_wrong: BoolArray) -> float:
    """Return the fraction of wrong classifications; NaN for fewer than 20 cells."""
    return float(is_wrong.mean()) if is_wrong.size >= 20 else float("nan")


def _calibration_error(p: NDArray[np.float32], safe: BoolArray) -> float:
    """Return the expected calibration error of p_safe, in ten bins."""
    tenth = np.minimum((p * 10).astype(int), 9)
    gap = 0.0
    for k in range(10):
        own = tenth == k
        if own.any():
            gap += own.mean() * abs(float(p[own].mean()) - float(safe[own].mean()))
    return gap


@dataclass(frozen=True)
class MetricComparison:
    """One quality metric of maps, for the mapper and for its surrogate.

    Attributes
    ----------
    name
        Name of the metric.
    mapper, low, high
        Value for the mapper's maps, and its 95 % interval from resampled flights.
    surrogate
        Value for the surrogate's maps on the same terrain.
    """

    name: str
    mapper: float
    low: float
    high: float
    surrogate: float

    @property
    def within(self) -> bool:
        """Whether the surrogate's value is within the mapper's 95 % interval."""
        return bool(self.low <= self.surrogate <= self.high)


def compare_metrics(
    surrogate: Surrogate, flights: Sequence[SampledFlight], scan: int, rng: np.random.Generator
) -> list[MetricComparison]:
    """Compare quality metrics of mapper and surrogate for one scan of all flights.

    `scan` is the index of the scan; `rng` samples surrogate maps and the bootstrap.
    """
    samples = [sample for f in flights for sample in f.samples if sample.stage == scan]
    maps = [sample.p_safe for sample in samples]
    drawn = [draw_surrogate_maps(surrogate, f, rng)[scan] for f in flights if len(f.samples) > scan]
    real, made = quality(samples, maps), quality(samples, drawn)
    again = []
    for _ in range(_RESAMPLES):
        pick = rng.integers(len(samples), size=len(samples))
        again.append(quality([samples[k] for k in pick], [maps[k] for k in pick]).values)
    # Small-sample correction of the bootstrap standard deviation.
    spread = np.nanstd(again, axis=0) * 1.96 * np.sqrt(len(samples) / max(len(samples) - 1, 1))
    low, high = real.values - spread, real.values + spread
    return [
        MetricComparison(n, *map(float, row))
        for n, *row in zip(real.names, real.values, low, high, made.values, strict=True)
    ]
