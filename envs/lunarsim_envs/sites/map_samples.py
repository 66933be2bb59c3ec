"""Record maps and truth in simulated flights, to fit a surrogate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.typing import Array, BoolArray
from lunarsim_envs.sites.field_of_view import fov_and_footprint, in_view, scan_altitudes
from lunarsim_envs.sites.hazard import UNKNOWN, TruthLayers

# Sampling interval of map cells per axis; neighbouring cells are strongly correlated.
EVERY = 2
# Flight time after the last scan, to measure the drift, s.
_AFTER = 4.0


@dataclass(frozen=True)
class MapSample:
    """Hazard map of a simulated mapper after a scan, with the truth at its cells.

    Attributes
    ----------
    stage
        Index of the last scan in the map, from 0.
    altitude
        Altitude of the lander above the site at the last scan, m.
    posting
        Spacing of the sampled cells, m.
    p_safe, observed
        p_safe and observed mask of the map (rows, cols).
    kind
        Class of the true terrain at each cell (rows, cols), from `hazard`; `hazard.UNKNOWN` where
        the true safety is not known.
    safe
        True safety of each cell (rows, cols).
    viewed
        Whether each cell is in the field of view of the last scan (rows, cols).
    """

    stage: int
    altitude: float
    posting: float
    p_safe: NDArray[np.float32]
    observed: BoolArray
    kind: NDArray[np.uint8]
    safe: BoolArray
    viewed: BoolArray


@dataclass(frozen=True)
class SampledFlight:
    """Hazard maps and navigation drift of one simulated flight.

    Attributes
    ----------
    samples
        Maps in time order.
    drift
        Mean rate of the position error from the first scan to the end, east and north (2,), m/s.
    reported_velocity_sigma
        Velocity standard deviation that navigation reports at the first scan, per axis, m/s.
    safe_share
        Truly safe fraction of the terrain.
    """

    samples: tuple[MapSample, ...]
    drift: Array
    reported_velocity_sigma: float
    safe_share: float


def sample_flights(
    scenario: Scenario, seed: int, flights: Iterable[int]
) -> Iterator[SampledFlight]:
    """Simulate flights of a campaign, and yield the hazard maps and drift of each.

    The flights do not divert, and end 4 s after the last scan.

    Parameters
    ----------
    scenario
        Scenario with a mapper.
    seed, flights
        Root seed, and indices of the flights.
    """
    scans = len(scan_altitudes(scenario))
    for flight in flights:
        simulation = Simulation(scenario, flight_seed(seed, flight), "no-divert")
        truth = simulation.truth
        elevation = truth.terrain.raster(truth.grid)
        layers = TruthLayers.of(truth.raster_safety(), elevation, truth.lander)
        samples: list[MapSample] = []
        first: tuple[float, Array] | None = None
        claimed = float("nan")
        name = simulation.computer.decision_map_name
        until = np.inf
        while not simulation.done and simulation.time < until:
            simulation.step()
            if name in simulation.computer.updated_mappers and not simulation.done:
                error = simulation.navigation_error
                if first is None:
                    first = simulation.time, error
                    level = simulation.estimate.covariance[3:5, 3:5]
                    claimed = float(np.sqrt(max(0.5 * np.trace(level), 0.0)))
                samples.append(_map_sample(simulation, layers, error, len(samples)))
                if len(samples) == scans:
                    until = simulation.time + _AFTER
        drift = np.full(2, np.nan)
        if first is not None and simulation.time > first[0]:
            drift = (simulation.navigation_error - first[1])[:2] / (simulation.time - first[0])
        share = float(layers.safe[layers.kind != UNKNOWN].mean())
        yield SampledFlight(tuple(samples), drift, claimed, share)


def _map_sample(simulation: Simulation, layers: TruthLayers, error: Array, stage: int) -> MapSample:
    """Sample the current map of a simulation and the truth at its cells.

    `error` (3,) is the navigation error, m, and `stage` the index of the last scan.
    """
    mapper = simulation.computer.mapper
    assert mapper is not None
    drawn = mapper.hazard_map()
    rows, cols = np.arange(0, drawn.grid.rows, EVERY), np.arange(0, drawn.grid.cols, EVERY)
    xy = drawn.grid.centre_of(rows[:, None], cols[None, :]) - error[:2]
    kind, safe = layers.at(xy)
    pick = np.ix_(rows, cols)
    here, aim = simulation.state.position, simulation.site - error
    viewed = in_view(
        xy, layers.height(xy), here, aim - here, fov_and_footprint(simulation.scenario)
    )
    return MapSample(
        stage, simulation.altitude, EVERY * drawn.grid.posting, drawn.p_safe[pick].copy(),
        drawn.observed[pick].copy(), kind, safe, viewed,
    )  # fmt: skip
