"""Draw surrogate maps in NumPy, and measure the correlation length of errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim_envs.sites import hazard
from lunarsim_envs.sites.map_samples import MapSample, SampledFlight
from lunarsim_envs.sites.surrogate import Surrogate

_LAGS = np.arange(0, 33)


def is_evaluated(sample: MapSample) -> BoolArray:
    """Return which cells have p_safe from the last scan and known truth (rows, cols)."""
    return np.asarray(sample.viewed & sample.observed & (sample.kind != hazard.UNKNOWN))


def draw_surrogate_maps(
    surrogate: Surrogate, flight: SampledFlight, rng: np.random.Generator
) -> list[NDArray[np.float32]]:
    """Generate random surrogate maps of p_safe (rows, cols) for the scans of a flight.

    Returns one map per scan; cells outside `is_evaluated` are NaN. The computation is the same as
    in the kernel `_map_kernels.scan_cell`.
    """
    posting = flight.samples[0].posting
    errors = surrogate.errors(np.array([flight.safe_share]), posting)
    noise, nodes = errors.noise[errors.terrain_index[0]], errors.tables.shape[3]
    side = noise.shape[2]
    steps = np.linspace(-errors.max_score, errors.max_score, nodes)
    out, last, last_mean = [], None, None
    for sample in flight.samples:
        one = noise[sample.stage, rng.integers(noise.shape[1])]
        one = np.roll(one, tuple(rng.integers(side, size=2)), (0, 1))
        one = one[: sample.kind.shape[0], : sample.kind.shape[1]].astype(np.float64)
        mean = rng.standard_normal()
        if last is not None and last_mean is not None:
            fresh = np.sqrt(1.0 - errors.correlation**2)
            one = errors.correlation * last + fresh * one
            mean = errors.correlation * last_mean + fresh * mean
        last, last_mean = one, mean
        common = errors.common_fraction[0, sample.stage]
        z = np.sqrt(common) * mean + np.sqrt(1.0 - common) * one
        p = np.full(sample.kind.shape, np.nan, np.float32)
        for c in np.unique(sample.kind[is_evaluated(sample)]):
            own = is_evaluated(sample) & (sample.kind == c)
            p[own] = np.interp(z[own], steps, errors.tables[0, sample.stage, c])
        out.append(p)
    return out


def correlation(fields: Sequence[Array], lags: IntArray) -> Array:
    """Return the autocorrelation of fields, minus their means, at lags (k,) in cells."""
    top, count = np.zeros(len(lags)), np.zeros(len(lags))
    for one in fields:
        if np.isnan(one).all():
            continue
        field = one - np.nanmean(one)
        for k, lag in enumerate(lags):
            for moved in (field[lag:, :] * field[: field.shape[0] - lag, :],
                          field[:, lag:] * field[:, : field.shape[1] - lag]):  # fmt: skip
                known = np.isfinite(moved)
                top[k] += moved[known].sum()
                count[k] += known.sum()
    mean = top / np.maximum(count, 1.0)
    return np.asarray(mean / max(mean[0], 1e-12))


def correlation_length(samples: Sequence[MapSample], maps: Sequence[NDArray[np.float32]]) -> float:
    """Return the correlation length of map errors (p_safe minus its class mean), m.

    `maps` are the maps of p_safe for `samples`. It is the lag at which the autocorrelation falls to
    1 / e, and NaN if it does not.
    """
    masks = [is_evaluated(sample) for sample in samples]
    total, count = np.zeros(hazard.COUNT), np.zeros(hazard.COUNT)
    for sample, one, mask in zip(samples, maps, masks, strict=True):
        np.add.at(total, sample.kind[mask], one[mask])
        np.add.at(count, sample.kind[mask], 1.0)
    means = total / np.maximum(count, 1.0)
    fields = []
    for sample, one, mask in zip(samples, maps, masks, strict=True):
        field = np.full(mask.shape, np.nan)
        field[mask] = one[mask] - means[sample.kind[mask]]
        fields.append(field)
    falls = correlation(fields, _LAGS)
    below = np.flatnonzero(falls < np.exp(-1.0))
    if not len(below):
        return float("nan")
    k = int(below[0])
    part = (falls[k - 1] - np.exp(-1.0)) / (falls[k - 1] - falls[k])
    return float((k - 1 + part) * samples[0].posting)
