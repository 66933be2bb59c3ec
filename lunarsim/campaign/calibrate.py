"""Fly a scenario's descents and fit the last stage of its Gaussian DEM's calibration to them.

The flights have seeds of their own, which no comparison flies, whatever its root seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lunarsim.campaign.plan import MAX_FLIGHTS
from lunarsim.campaign.pool import outcomes
from lunarsim.errors import InputError
from lunarsim.evaluation.site_calibration import (
    LeftOut,
    Sites,
    check_enough,
    drawn_sites,
    judged_by_flights_left_out,
    with_figures,
)
from lunarsim.onboard.hazards.gaussian_dem.drawn import evidence_of
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapper, GaussianDemMapping
from lunarsim.rng import Streams, calibration_seed
from lunarsim.safety.refit import ScenarioCalibration
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

# The last is of the intervals, not of a flight.
_INTERVALS = 2**32 - 1


@dataclass(frozen=True)
class Calibrated:
    """What a calibration gave.

    Attributes
    ----------
    calibration
        Fitted to all flights.
    left_out
        How good it is on flights that it was not fitted to.
    maps
        Number of maps that sites were drawn from.
    """

    calibration: ScenarioCalibration
    left_out: LeftOut
    maps: int


@dataclass(frozen=True)
class _Task:
    scenario: Scenario
    mapper: str
    root: int
    flight: int
    sites: int


def calibrate(
    scenario: Scenario,
    *,
    flights: int,
    seed: int,
    sites: int,
    jobs: int = 1,
    mapper: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Calibrated:
    """Fit the last stage of the calibration to a scenario's own flights.

    Sites are drawn from each map that the scenario's policy decides on, where the map has observed
    and the truth has a verdict.

    Parameters
    ----------
    scenario
        The study; a calibration that it names already is not flown.
    flights, seed, sites, jobs
        Flights, root seed, sites of each map, processes; what comes out does not depend on `jobs`.
    mapper
        Name of the mapper; left out: `gaussian_mapper` chooses.
    progress
        Called with 1 after each flight.

    Raises
    ------
    InputError
        If the request or the scenario will not do, or the flights show no two kinds of sites.
    """
    for name, value, least in (("flights", flights, 2), ("sites", sites, 1), ("jobs", jobs, 1)):
        if value < least:
            raise InputError(f"--{name}", value, f"at least {least}")
    mapper = gaussian_mapper(scenario, mapper)
    plain = scenario.changed(mappers={mapper: {"calibration_path": None}})
    if flights > MAX_FLIGHTS:
        raise InputError("--flights", flights, f"at most {MAX_FLIGHTS}")
    tasks = [_Task(plain, mapper, seed, i, sites) for i in range(flights)]
    found: dict[int, list[Sites]] = {}
    for index, parts in outcomes(_fly, tasks, min(jobs, flights)):
        found[index] = parts
        if progress is not None:
            progress(1)
    parts = [part for index in range(flights) for part in found[index]]
    if not sum(map(len, parts)):
        raise InputError(
            "sites", 0, "some: no map that a decision was made on had observed any ground"
        )
    everything = Sites.joined(parts)
    check_enough(everything)
    lander = plain.vehicle.make()
    rng = np.random.default_rng(calibration_seed(seed, _INTERVALS))
    left_out = judged_by_flights_left_out(everything, flights, lander, rng)
    fit = replace(
        everything.fitted(lander),
        scenario=scenario.name, mapper=mapper, flights=flights, sites=len(everything), seed=seed,
    )  # fmt: skip
    return Calibrated(with_figures(fit, left_out), left_out, len(parts))


def gaussian_mapper(scenario: Scenario, name: str | None = None) -> str:
    """Return the name of the mapper to calibrate.

    Left out: the one that decides if it is a calibrated Gaussian DEM, else the only Gaussian DEM.

    Raises
    ------
    InputError
        If there is no such mapper, it is of another kind, its safety is not calibrated, or there
        are several to choose from.
    """
    mappers = {n: part.make() for n, part in scenario.mappers.items()}
    fit = [n for n, part in mappers.items() if isinstance(part, GaussianDemMapping)]
    words = ", ".join(fit) or "none"
    if name is None:
        decides = scenario.decisions.map or next(iter(mappers), "")
        name = decides if decides in fit else (fit[0] if len(fit) == 1 else None)
        if name is None:
            expected = "one [mappers.NAME] of kind gaussian-dem" if not fit else "named: --mapper"
            raise InputError("mappers", ", ".join(mappers), f"{expected}; there are {words}")
    if name not in fit:
        raise InputError("--mapper", name, f"a mapper of kind gaussian-dem; there are {words}")
    safety = mappers[name].safety
    if safety != "calibrated":
        raise InputError(f"mappers.{name}.safety", safety, "calibrated: nothing else is fitted")
    return name


def _fly(task: _Task) -> list[Sites]:
    """Fly one descent under the scenario's policy; return sites of each map decided on."""
    scenario = task.scenario
    seed = calibration_seed(task.root, task.flight)
    simulation = Simulation(scenario, seed, scenario.policy.kind)
    computer = simulation.computer
    mapper = computer.mappers[task.mapper]
    assert isinstance(mapper, GaussianDemMapper)
    rng = Streams(seed).get("calibration.sites")
    found, last, error = [], None, simulation.navigation_error
    while not simulation.done and computer.altitude >= computer.decisions.last_altitude:
        if task.mapper in computer.mapped:
            error = simulation.navigation_error
        if simulation.decision_due and not mapper.blank:
            drawn = mapper.hazard_map()
            if drawn is not last:
                last = drawn
                evidence = evidence_of(mapper.dem(), mapper.lander, mapper.rocks)
                truth = simulation.truth
                found.append(drawn_sites(evidence, truth, error, task.sites, task.flight, rng))
        simulation.step()
    return found
