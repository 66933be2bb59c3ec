"""Maps of a surrogate beside those of the mapper it stands for, on the same ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim_envs.sites import hazard
from lunarsim_envs.sites.draws import drawn_like, judged, length_of
from lunarsim_envs.sites.looks import Look, LookedFlight
from lunarsim_envs.sites.surrogate import Surrogate

Array = NDArray[np.float64]

# A site is told to be safe from here on, and unsafe below the other.
TOLD_SAFE, TOLD_UNSAFE = 0.9, 0.5
_SIZES = np.append(hazard.SIZES, np.inf)
_RESAMPLED = 500


@dataclass(frozen=True)
class Quality:
    """Figures of maps: names and values, in one order."""

    names: tuple[str, ...]
    values: Array


def quality(looks: Sequence[Look], maps: Sequence[NDArray[np.float32]]) -> Quality:
    """Return calibration, missed and false rates and length of correlation of maps."""
    masks = [judged(look) for look in looks]
    p = np.concatenate([one[mask] for one, mask in zip(maps, masks, strict=True)])
    safe = np.concatenate([look.safe[mask] for look, mask in zip(looks, masks, strict=True)])
    kind = np.concatenate([look.kind[mask] for look, mask in zip(looks, masks, strict=True)])
    named = {"calibration error": _calibration_error(p, safe), "mean p_safe": float(p.mean())}
    size = np.append(0.0, _SIZES)[hazard.size_class(kind)]
    for low, high in ((1.0, 1.25), (1.25, 1.5), (1.5, np.inf)):
        own = ~safe & (size >= low) & (size < high)
        told = f"unsafe, {low:g} to {high:g} of the limit, told safe"
        named[told] = _share(p[own] >= TOLD_SAFE)
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 1.0)):
        own = safe & (size >= low) & (size < high)
        named[f"safe, {low:g} to {high:g} of the limit, told unsafe"] = _share(p[own] < TOLD_UNSAFE)
    edge = kind.astype(int) % (len(hazard.DISTANCES) + 1)
    for words, own in (
        ("unsafe, over 0.5 m inside, told safe", ~safe & (edge <= 2)),
        ("unsafe, at the edge, told safe", ~safe & (edge > 2)),
    ):
        named[words] = _share(p[own] >= TOLD_SAFE)
    for words, own in (
        ("safe, over 0.9 m from the edge, told unsafe", safe & (edge >= 8)),
        ("safe, at the edge, told unsafe", safe & (edge < 8)),
    ):
        named[words] = _share(p[own] < TOLD_UNSAFE)
    named["length of correlation, m"] = length_of(looks, maps)
    return Quality(tuple(named), np.array(list(named.values())))


def _share(told: NDArray[np.bool_]) -> float:
    return float(told.mean()) if told.size >= 20 else float("nan")


def _calibration_error(p: NDArray[np.float32], safe: NDArray[np.bool_]) -> float:
    """Return the mean gap between what is told and how often it is so, over tenths."""
    tenth = np.minimum((p * 10).astype(int), 9)
    gap = 0.0
    for k in range(10):
        own = tenth == k
        if own.any():
            gap += own.mean() * abs(float(p[own].mean()) - float(safe[own].mean()))
    return gap


@dataclass(frozen=True)
class Beside:
    """One figure of the mapper and of the surrogate.

    Attributes
    ----------
    name
        Of the figure.
    mapper, low, high
        Of the mapper's maps, and the 95 % interval that resampling flights gives.
    surrogate
        The same figure of the maps that the surrogate drew on the same ground.
    """

    name: str
    mapper: float
    low: float
    high: float
    surrogate: float

    @property
    def within(self) -> bool:
        """Whether the surrogate's lies in the interval."""
        return bool(self.low <= self.surrogate <= self.high)


def beside(
    surrogate: Surrogate, flights: Sequence[LookedFlight], scan: int, rng: np.random.Generator
) -> list[Beside]:
    """Return the figures of a scan of all flights, mapper and surrogate beside each other."""
    looks = [look for f in flights for look in f.looks if look.stage == scan]
    maps = [look.p_safe for look in looks]
    drawn = [drawn_like(surrogate, f, rng)[scan] for f in flights if len(f.looks) > scan]
    real, made = quality(looks, maps), quality(looks, drawn)
    again = []
    for _ in range(_RESAMPLED // 10):
        pick = rng.integers(len(looks), size=len(looks))
        again.append(quality([looks[k] for k in pick], [maps[k] for k in pick]).values)
    # Few flights spread less than many of their like do: the interval is widened by that.
    spread = np.nanstd(again, axis=0) * 1.96 * np.sqrt(len(looks) / max(len(looks) - 1, 1))
    low, high = real.values - spread, real.values + spread
    return [
        Beside(n, *map(float, row))
        for n, *row in zip(real.names, real.values, low, high, made.values, strict=True)
    ]
