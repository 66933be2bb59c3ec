"""Train a network that chooses sites, by the cross-entropy method.

All networks of a population fly the same flights. The best networks define mean and standard
deviation of the next population (Rubinstein and Kroese, "The Cross-Entropy Method", Springer 2004,
ch. 5). All flights of a generation run in parallel, each with its own network.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.typing import Array
from lunarsim_envs.agents.site_network import SiteNetwork
from lunarsim_envs.descent.batch import FLYING
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.flights import site_inputs
from lunarsim_envs.sites.site_features import FEATURES, site_features
from lunarsim_envs.sites.site_inputs import MAP_CELLS, SITES


@dataclass(frozen=True)
class CemSettings:
    """Settings of a training of a site network by the cross-entropy method.

    Attributes
    ----------
    hidden
        Width of the hidden layer.
    population, elite, flights, generations
        Networks per generation, number of best networks for the update, flights per network, and
        number of generations.
    propellant_weight
        Penalty per kilogram of propellant; a safe landing is worth 1.
    spread
        Standard deviation of the network weights in the first population.
    smoothing
        Smoothing factor: weight of the old mean and standard deviation in an update.
    seed
        Root seed.
    """

    hidden: int = 8
    population: int = 16
    elite: int = 4
    flights: int = 96
    generations: int = 30
    propellant_weight: float = 0.006
    spread: float = 0.5
    smoothing: float = 0.3
    seed: int = 1


def initial_network(hidden: int) -> SiteNetwork:
    """Return the initial network, which imitates the onboard policy ``fuel-aware``.

    `hidden` is the width of the hidden layer, whose weights are zero.
    """
    linear = np.zeros(len(FEATURES))
    # Score: 1 per unit of log-odds, -0.25 per kilogram, +0.7 for keeping the site.
    linear[0], linear[1], linear[3] = 5.0, -0.5, 0.7
    k = len(FEATURES)
    return SiteNetwork(linear, np.zeros((hidden, k)), np.zeros(hidden), np.zeros(hidden))


def fly_networks(
    lanes: SiteDescentBatch, keys: NDArray[np.uint64], weights: Array, hidden: int
) -> Array:
    """Fly n landers, each with its own network; return safety and propellant (n, 2).

    Safety is 0 or 1; propellant is in kg.

    Parameters
    ----------
    lanes
        Batch of n landers.
    keys
        Random keys of the flights (n,).
    weights
        Weights of the networks (n, size), in the order of `SiteNetwork.flat`.
    hidden
        Width of the hidden layers.
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
        inputs = site_inputs(lanes, small)
        x, good = site_features(inputs)
        scores = np.einsum("nok,nk->no", x, linear)
        layer = np.tanh(np.einsum("nok,nhk->noh", x, inner) + bias[:, None])
        scores += np.einsum("noh,nh->no", layer, outer)
        best = np.where(good, scores, -np.inf).argmax(axis=1)
        sites = np.full((n, 3), np.nan)
        moved = best > 0
        most = min(SITES, inputs.position_of.shape[1])
        sites[moved] = inputs.position_of[rows[moved], np.minimum(best[moved] - 1, most - 1)]
        lanes.decide(sites, every)
    return np.stack((lanes.safe.astype(float), lanes.propellant_used), axis=1)


def train(
    lanes: SiteDescentBatch,
    settings: CemSettings,
    report: Callable[[int, float, float, float], None],
) -> SiteNetwork:
    """Train a site network by the cross-entropy method and return it.

    Parameters
    ----------
    lanes
        Batch with population x flights landers.
    settings
        Settings of the training.
    report
        Function called after every generation with its number, the fraction of safe landings and
        the mean propellant (kg) of the best networks, and the mean standard deviation of weights.
    """
    s = settings
    rng = np.random.default_rng(s.seed)
    mean = initial_network(s.hidden).flat
    sigma = np.full(mean.shape, s.spread)
    for generation in range(s.generations):
        drawn = mean + sigma * rng.standard_normal((s.population, len(mean)))
        drawn[0] = mean
        keys = rng.integers(2**64, size=s.flights, dtype=np.uint64)
        found = fly_networks(
            lanes, np.tile(keys, s.population), np.repeat(drawn, s.flights, 0), s.hidden
        )
        found = found.reshape(s.population, s.flights, 2)
        worth = (found[..., 0] - s.propellant_weight * found[..., 1]).mean(axis=1)
        best = np.argsort(-worth, kind="stable")[: s.elite]
        mean = s.smoothing * mean + (1.0 - s.smoothing) * drawn[best].mean(axis=0)
        sigma = s.smoothing * sigma + (1.0 - s.smoothing) * drawn[best].std(axis=0)
        safe, burnt = found[best].mean(axis=(0, 1))
        report(generation, float(safe), float(burnt), float(sigma.mean()))
    return SiteNetwork.of(mean, s.hidden)
