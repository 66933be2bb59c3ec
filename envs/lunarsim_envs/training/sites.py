"""Training of a network that chooses sites, by the cross-entropy method.

A population of networks flies the same flights; the best of them give mean and deviation of the
next population (Rubinstein and Kroese, "The Cross-Entropy Method", Springer 2004, ch. 5). All
flights of a generation fly side by side, a lane each, every lane by its own network.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim_envs.agents.site_network import FEATURES, SiteNetwork, features
from lunarsim_envs.descent.lanes import FLYING
from lunarsim_envs.sites.flights import sights_of
from lunarsim_envs.sites.lanes import SiteLanes
from lunarsim_envs.sites.parts import SITES
from lunarsim_envs.sites.sights import MAP_CELLS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SiteTraining:
    """Settings.

    Attributes
    ----------
    hidden
        Width of the layer.
    population, elite, flights, generations
        Networks a generation, how many of them give the next, flights of each, generations.
    price
        Cost of a kilogram, where a safe landing is worth 1.
    spread
        Standard deviation of the first population.
    kept
        Share of mean and deviation that is kept from one generation to the next.
    seed
        Root seed.
    """

    hidden: int = 8
    population: int = 16
    elite: int = 4
    flights: int = 96
    generations: int = 30
    price: float = 0.006
    spread: float = 0.5
    kept: float = 0.3
    seed: int = 1


def start(hidden: int) -> SiteNetwork:
    """Return a network that trades log-odds of safety against propellant, as `fuel-aware` does."""
    linear = np.zeros(len(FEATURES))
    # A log-odd is worth 1, a kilogram 0.25, a change of site 0.7.
    linear[0], linear[1], linear[3] = 5.0, -0.5, 0.7
    k = len(FEATURES)
    return SiteNetwork(linear, np.zeros((hidden, k)), np.zeros(hidden), np.zeros(hidden))


def flown(lanes: SiteLanes, keys: NDArray[np.uint64], weights: Array, hidden: int) -> Array:
    """Fly every lane once by a network of its own; return whether safe and propellant (n, 2).

    Parameters
    ----------
    lanes
        n of them.
    keys
        Of the flights (n,).
    weights
        Of the networks (n, size), see `SiteNetwork.flat`.
    hidden
        Width of their layers.
    """
    k, n = len(FEATURES), lanes.count
    linear, inner, bias, outer = np.split(weights, np.cumsum([k, hidden * k, hidden]), axis=1)
    inner = inner.reshape(n, hidden, k)
    every = np.ones(n, np.bool_)
    lanes.seed(every, keys)
    lanes.begin(every)
    small = np.zeros((n, 2, MAP_CELLS, MAP_CELLS), np.float32)
    rows = np.arange(n)
    while (lanes.ended == FLYING).any():
        sights = sights_of(lanes, small)
        x, good = features(sights)
        scores = np.einsum("nok,nk->no", x, linear)
        layer = np.tanh(np.einsum("nok,nhk->noh", x, inner) + bias[:, None])
        scores += np.einsum("noh,nh->no", layer, outer)
        best = np.where(good, scores, -np.inf).argmax(axis=1)
        sites = np.full((n, 3), np.nan)
        moved = best > 0
        most = min(SITES, sights.position_of.shape[1])
        sites[moved] = sights.position_of[rows[moved], np.minimum(best[moved] - 1, most - 1)]
        lanes.decide(sites, every)
    return np.stack((lanes.safe.astype(float), lanes.burnt), axis=1)


def train(
    lanes: SiteLanes, settings: SiteTraining, told: Callable[[int, float, float, float], None]
) -> SiteNetwork:
    """Return the trained network.

    Parameters
    ----------
    lanes
        population x flights of them.
    settings
        How.
    told
        Called after every generation with its number, the share of safe landings and the propellant
        (kg) of its elite, and the mean deviation of the weights.
    """
    s = settings
    rng = np.random.default_rng(s.seed)
    mean = start(s.hidden).flat
    sigma = np.full(mean.shape, s.spread)
    for generation in range(s.generations):
        drawn = mean + sigma * rng.standard_normal((s.population, len(mean)))
        drawn[0] = mean
        keys = rng.integers(2**64, size=s.flights, dtype=np.uint64)
        found = flown(lanes, np.tile(keys, s.population), np.repeat(drawn, s.flights, 0), s.hidden)
        found = found.reshape(s.population, s.flights, 2)
        worth = (found[..., 0] - s.price * found[..., 1]).mean(axis=1)
        best = np.argsort(-worth, kind="stable")[: s.elite]
        mean = s.kept * mean + (1.0 - s.kept) * drawn[best].mean(axis=0)
        sigma = s.kept * sigma + (1.0 - s.kept) * drawn[best].std(axis=0)
        safe, burnt = found[best].mean(axis=(0, 1))
        told(generation, float(safe), float(burnt), float(sigma.mean()))
    return SiteNetwork.of(mean, s.hidden)
