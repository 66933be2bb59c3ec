"""Fit a surrogate to maps from simulated flights."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtr, ndtri
from scipy.stats import rankdata

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.typing import Array
from lunarsim_envs.sites import hazard
from lunarsim_envs.sites.map_samples import MapSample, SampledFlight
from lunarsim_envs.sites.surrogate import LENGTHS, MOST, NODES, Surrogate, surrogate_tables
from lunarsim_envs.sites.surrogate_maps import (
    correlation,
    correlation_length,
    draw_surrogate_maps,
    is_evaluated,
)

# Minimum number of sites for a separate table of a class; smaller classes share that of their size.
_ENOUGH = 150
# Number of iterations that correct the correlation lengths.
_ROUNDS = 3
# Lags at which the correlation is fitted, in cells.
_LAGS = np.array([0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32])


def fit_mapper_surrogate(
    scenario: Scenario, terrains: Sequence[Sequence[SampledFlight]]
) -> Surrogate:
    """Fit the surrogate of a scenario's mapper to maps from simulated flights.

    Parameters
    ----------
    scenario
        Scenario of the flights.
    terrains
        Flights over several terrains, which differ in their fraction of safe sites.

    Raises
    ------
    InputError
        If flights are missing, or have more than two scans.
    """
    samples = [[sample for flight in terrain for sample in flight.samples] for terrain in terrains]
    scans = 1 + max((sample.stage for terrain in samples for sample in terrain), default=-1)
    if not 1 <= scans <= 2:
        raise InputError("scans", scans, "must be one or two in every flight")
    shares = np.array([np.mean([f.safe_share for f in terrain]) for terrain in terrains])
    order = np.argsort(shares)
    tables = np.zeros((len(terrains), scans, hazard.COUNT, NODES))
    common, weights = (
        np.zeros((len(terrains), scans)),
        np.zeros((len(terrains), scans, len(LENGTHS))),
    )
    scores: list[list[Array]] = [[] for _ in range(scans)]
    for g, index in enumerate(order):
        for stage in range(scans):
            own = [sample for sample in samples[index] if sample.stage == stage]
            tables[g, stage] = quantile_tables(own)
            found = normal_scores(own)
            means = np.array([np.nanmean(one) for one in found])
            every = np.nanvar(np.concatenate([one.ravel() for one in found]))
            common[g, stage] = min(np.var(means) / max(every, 1e-9), 0.95)
            weights[g, stage] = correlation_weights(found, own[0].posting)
            scores[stage] += found
    every = [flight for terrain in terrains for flight in terrain]
    drift = np.array([flight.drift for flight in every])
    plain = Surrogate(
        shares[order], tables, common, weights, np.ones(common.shape), _scan_correlation(scores),
        np.sqrt(np.nanmean(drift**2, axis=0)),
        float(np.mean([f.reported_velocity_sigma for f in every])),
        np.array([_altitude(samples, stage) for stage in range(scans)]),
        json.dumps(surrogate_tables(scenario), sort_keys=True),
    )  # fmt: skip
    return _fit_length_factor(plain, [terrains[index] for index in order])


def _fit_length_factor(
    surrogate: Surrogate, terrains: Sequence[Sequence[SampledFlight]]
) -> Surrogate:
    """Return the surrogate with a factor on its correlation lengths, fitted to maps.

    `terrains` are the simulated flights over each fitted terrain, with the mapper's maps.
    """
    for _ in range(_ROUNDS):
        stretch = surrogate.stretch.copy()
        for g, terrain in enumerate(terrains):
            rng = np.random.default_rng(g)
            drawn = [draw_surrogate_maps(surrogate, flight, rng) for flight in terrain]
            for scan in range(stretch.shape[1]):
                samples = [sample for f in terrain for sample in f.samples if sample.stage == scan]
                wanted = correlation_length(samples, [sample.p_safe for sample in samples])
                found = correlation_length(samples, [one[scan] for one in drawn if len(one) > scan])
                if np.isfinite(wanted) and np.isfinite(found):
                    stretch[g, scan] = np.clip(stretch[g, scan] * wanted / found, 0.5, 5.0)
        surrogate = replace(surrogate, stretch=stretch)
    return surrogate


def _altitude(samples: Sequence[Sequence[MapSample]], stage: int) -> float:
    return float(np.mean([k.altitude for terrain in samples for k in terrain if k.stage == stage]))


def quantile_tables(samples: Sequence[MapSample]) -> Array:
    """Tabulate the distribution of p_safe in each terrain class (classes, nodes).

    Column k is the quantile of p_safe at the k-th of the evenly spaced normal scores.
    """
    kind = np.concatenate([sample.kind[is_evaluated(sample)] for sample in samples])
    p = np.concatenate([sample.p_safe[is_evaluated(sample)] for sample in samples]).astype(
        np.float64
    )
    share = ndtr(np.linspace(-MOST, MOST, NODES))
    sizes = hazard.size_class(kind)
    known = np.flatnonzero(np.bincount(sizes, minlength=len(hazard.SIZES) + 1) >= 1)
    if not len(known):
        raise InputError(
            "samples", samples, "must include a site with known true safety", show_value=False
        )
    out = np.empty((hazard.COUNT, NODES))
    for c in range(hazard.COUNT):
        size = int(hazard.size_class(np.array([c], np.uint8))[0])
        own = p[kind == c]
        if len(own) < _ENOUGH:
            nearest = known[np.argmin(np.abs(known - size))]
            own = p[sizes == nearest]
        out[c] = np.quantile(own, share)
    return out


def normal_scores(samples: Sequence[MapSample]) -> list[Array]:
    """Return the normal score of each cell's p_safe within its terrain class.

    Each map gives an array (rows, cols), with NaN where `is_evaluated` is false.
    """
    masks = [is_evaluated(sample) for sample in samples]
    kind = np.concatenate([sample.kind[mask] for sample, mask in zip(samples, masks, strict=True)])
    p = np.concatenate([sample.p_safe[mask] for sample, mask in zip(samples, masks, strict=True)])
    z = np.empty(len(p))
    for c in np.unique(kind):
        own = kind == c
        z[own] = ndtri((rankdata(p[own]) - 0.5) / own.sum())
    out, at = [], 0
    for mask in masks:
        one = np.full(mask.shape, np.nan)
        count = int(mask.sum())
        one[mask] = z[at : at + count]
        out.append(one)
        at += count
    return out


def correlation_weights(fields: Sequence[Array], posting: float) -> Array:
    """Fit the autocorrelation of fields by Gaussians with the lengths `LENGTHS`.

    `posting` is the spacing of cells, m. Returns the weights (lengths,), which sum to 1.
    """
    wanted = correlation(fields, _LAGS)
    away = _LAGS * posting
    basis = np.stack(
        [(away == 0.0).astype(float)]
        + [np.exp(-0.5 * (away / length) ** 2) for length in LENGTHS[1:]],
        axis=1,
    )
    weights = nnls(basis, np.maximum(wanted, 0.0))[0]
    return np.asarray(weights / weights.sum())


def _scan_correlation(scores: Sequence[Sequence[Array]]) -> float:
    """Return the correlation of normal scores between the first and the second map.

    `scores` are the fields (rows, cols) of each scan; with one scan, the result is 0.
    """
    if len(scores) < 2:
        return 0.0
    first, second = scores
    if len(first) != len(second):
        raise InputError(
            "scans", (len(first), len(second)), "must have as many first maps as second maps"
        )
    pairs = np.concatenate([
        np.stack((a, b), axis=-1).reshape(-1, 2) for a, b in zip(first, second, strict=True)
    ])  # fmt: skip
    known = pairs[np.isfinite(pairs).all(axis=1)]
    return float(np.clip(np.corrcoef(known.T)[0, 1], 0.0, 0.99)) if len(known) > 2 else 0.0
