"""Maps that a real mapper draws in flight, laid beside the truth: what a surrogate is fitted to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim_envs.sites.hazard import UNKNOWN, TruthLayers
from lunarsim_envs.sites.view import in_view, scan_altitudes, view_of

Array = NDArray[np.float64]

# Every so-manieth cell of a map along its side is looked at: its neighbours say much the same.
EVERY = 2
# Flown on after the last scan, s: so long drift is looked at besides.
_AFTER = 4.0


@dataclass(frozen=True)
class Look:
    """A map as it stood after a scan, and what is true under its cells.

    Attributes
    ----------
    stage
        How many scans it was made of, less one.
    altitude
        Of the lander above the site at the last one, m.
    posting
        Of the cells here, m.
    p_safe, observed
        Of the map (rows, cols).
    kind
        Class of the truth under each cell (rows, cols), see `hazard`; `hazard.UNKNOWN` where there
        is none.
    safe
        Whether each cell is exactly safe (rows, cols).
    viewed
        Whether the last scan had each cell in view (rows, cols), by `view`.
    """

    stage: int
    altitude: float
    posting: float
    p_safe: NDArray[np.float32]
    observed: NDArray[np.bool_]
    kind: NDArray[np.uint8]
    safe: NDArray[np.bool_]
    viewed: NDArray[np.bool_]


@dataclass(frozen=True)
class LookedFlight:
    """What one flight gives: its maps, and how the lander drifted over them.

    Attributes
    ----------
    looks
        In their order.
    drift
        Change of the error of place from the first scan to the end over the time between (2,),
        east and north, m/s.
    claimed
        Deviation that navigation gives the velocity at the first scan, an axis, m/s.
    safe_share
        Of the ground that is exactly safe.
    """

    looks: tuple[Look, ...]
    drift: Array
    claimed: float
    safe_share: float


def looked_flights(scenario: Scenario, seed: int, flights: Iterable[int]) -> Iterator[LookedFlight]:
    """Fly flights of a campaign to their last scan, and yield what their mapper drew.

    They keep their sites, and end some seconds after that scan.

    Parameters
    ----------
    scenario
        With a mapper that decides.
    seed, flights
        Root seed, and numbers of the flights.
    """
    scans = len(scan_altitudes(scenario))
    for flight in flights:
        simulation = Simulation(scenario, flight_seed(seed, flight), "no-divert")
        layers = TruthLayers.of(simulation.truth)
        looks: list[Look] = []
        first: tuple[float, Array] | None = None
        claimed = float("nan")
        name = simulation.computer.decisions_map
        until = np.inf
        while not simulation.done and simulation.time < until:
            simulation.step()
            if name in simulation.computer.mapped and not simulation.done:
                error = simulation.navigation_error
                if first is None:
                    first = simulation.time, error
                    level = simulation.estimate.covariance[3:5, 3:5]
                    claimed = float(np.sqrt(max(0.5 * np.trace(level), 0.0)))
                looks.append(_look(simulation, layers, error, len(looks)))
                if len(looks) == scans:
                    until = simulation.time + _AFTER
        drift = np.full(2, np.nan)
        if first is not None and simulation.time > first[0]:
            drift = (simulation.navigation_error - first[1])[:2] / (simulation.time - first[0])
        share = float(layers.safe[layers.kind != UNKNOWN].mean())
        yield LookedFlight(tuple(looks), drift, claimed, share)


def _look(simulation: Simulation, layers: TruthLayers, error: Array, stage: int) -> Look:
    mapper = simulation.computer.mapper
    assert mapper is not None
    drawn = mapper.hazard_map()
    rows, cols = np.arange(0, drawn.grid.rows, EVERY), np.arange(0, drawn.grid.cols, EVERY)
    xy = drawn.grid.centre_of(rows[:, None], cols[None, :]) - error[:2]
    kind, safe = layers.at(xy)
    pick = np.ix_(rows, cols)
    here, aim = simulation.state.position, simulation.site - error
    viewed = in_view(xy, layers.height(xy), here, aim - here, view_of(simulation.scenario))
    return Look(
        stage, simulation.altitude, EVERY * drawn.grid.posting, drawn.p_safe[pick].copy(),
        drawn.observed[pick].copy(), kind, safe, viewed,
    )  # fmt: skip
