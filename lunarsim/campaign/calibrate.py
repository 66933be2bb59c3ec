"""Refit and assess the safe-landing probability of a Gaussian DEM for a scenario.

The last calibration stage maps the probability of the calibration supplied with lunarsim to one
for the scenario.

The flights use seeds that no campaign uses, whatever its root seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from lunarsim.campaign.plan import MAX_FLIGHTS
from lunarsim.campaign.pool import iterate_results
from lunarsim.errors import InputError
from lunarsim.evaluation.site_calibration import (
    CalibrationComparison,
    CrossValidation,
    ProbabilityQuality,
    SiteSamples,
    check_site_counts,
    cross_validate,
    sample_sites,
    with_quality,
)
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import dem_site_evidence
from lunarsim.onboard.hazards.gaussian_dem.mapper import (
    GaussianDemMapper,
    GaussianDemMapperSettings,
)
from lunarsim.rng import RandomStreams, calibration_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.typing import Array

# The last calibration seed is reserved for the bootstrap intervals.
_BOOTSTRAP_SEED_INDEX = 2**32 - 1
_HEADINGS = (
    "Domain", "Calibration", "Sites", "Share of\nall sites", "Observed\nsafe share", "ECE",
    "Brier skill", "Sites with\np > 0.95", "Bias (mean p\nminus observed)",
)  # fmt: skip


@dataclass(frozen=True)
class CalibrationResult:
    """Calibration of the safe-landing probability for a scenario, and its quality.

    Attributes
    ----------
    calibration
        Calibration fitted to all flights.
    left_out
        Cross-validated quality: each flight is evaluated by a fit to the others.
    maps
        Number of maps that sites were sampled from.
    """

    calibration: ScenarioCalibration
    left_out: CrossValidation
    maps: int


@dataclass(frozen=True)
class _CalibrationFlight:
    """Settings of one flight whose sites are sampled for the calibration.

    `root` is the root seed, `flight` the index of the flight, and `sites` the number of sites that
    are sampled from each map.
    """

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
) -> CalibrationResult:
    """Refit the safe-landing probability of a mapper to flights of a scenario.

    Sites are sampled from each map that the scenario's policy uses for a decision. Only cells that
    the map has observed and that have a true classification are used.

    Parameters
    ----------
    scenario
        Scenario to fly; a calibration file that it already names is ignored.
    flights, seed, sites, jobs
        Number of flights, root seed, sites per map, processes. The result does not depend on
        `jobs`.
    mapper
        Name of the mapper; omitted: `gaussian_mapper` chooses.
    progress
        Called with 1 after each flight.

    Returns
    -------
    CalibrationResult
        Fit to all flights, its cross-validated quality, and the number of maps.

    Raises
    ------
    InputError
        If an argument or the scenario is not usable, or all sites are of one class.
    """
    for name, value, minimum in (("flights", flights, 2), ("sites", sites, 1), ("jobs", jobs, 1)):
        if value < minimum:
            raise InputError(f"--{name}", value, f"must be {minimum} or more")
    mapper = gaussian_mapper(scenario, mapper)
    plain = scenario.changed(mappers={mapper: {"calibration_path": None}})
    if flights > MAX_FLIGHTS:
        raise InputError("--flights", flights, f"must be at most {MAX_FLIGHTS:,}")
    tasks = [_CalibrationFlight(plain, mapper, seed, i, sites) for i in range(flights)]
    found: dict[int, list[SiteSamples]] = {}
    for index, parts in iterate_results(_fly_and_sample, tasks, min(jobs, flights)):
        found[index] = parts
        if progress is not None:
            progress(1)
    parts = [part for index in range(flights) for part in found[index]]
    if not sum(map(len, parts)):
        raise InputError(
            "sites",
            0,
            "cannot be drawn, because no map that a decision used has observed terrain",
            "Check when the LiDAR scans ([tasking]).",
            show_value=False,
        )
    everything = SiteSamples.joined(parts)
    check_site_counts(everything)
    lander = plain.vehicle.make()
    rng = np.random.default_rng(calibration_seed(seed, _BOOTSTRAP_SEED_INDEX))
    left_out = cross_validate(everything, flights, lander, rng)
    fit = replace(
        everything.fitted(lander),
        scenario=scenario.name, mapper=mapper, flights=flights, sites=len(everything), seed=seed,
    )  # fmt: skip
    return CalibrationResult(with_quality(fit, left_out), left_out, len(parts))


def gaussian_mapper(scenario: Scenario, name: str | None = None) -> str:
    """Return the name of the Gaussian DEM mapper to calibrate.

    If `name` is None, this is the mapper that decisions use if it is a Gaussian DEM, else the only
    Gaussian DEM of the scenario.

    Raises
    ------
    InputError
        If the mapper does not exist, is not a Gaussian DEM or is not calibrated, or if several
        mappers qualify.
    """
    mappers = {n: part.make() for n, part in scenario.mappers.items()}
    fit = [n for n, part in mappers.items() if isinstance(part, GaussianDemMapperSettings)]
    words = ", ".join(fit) or "none"
    if name is None:
        decides = scenario.decisions.map or next(iter(mappers), "")
        name = decides if decides in fit else (fit[0] if len(fit) == 1 else None)
        if name is None:
            problem = (
                "must contain a mapper of kind 'gaussian-dem'"
                if not fit
                else f"contains several mappers of kind 'gaussian-dem' ({words})"
            )
            remedy = "Add it as [mappers.NAME]." if not fit else "Choose one with --mapper."
            raise InputError("mappers", ", ".join(mappers), problem, remedy, show_value=False)
    if name not in fit:
        raise InputError(
            "--mapper",
            name,
            "must be the name of a mapper of kind 'gaussian-dem'",
            f"Mappers of this kind: {words}.",
        )
    safety = mappers[name].safety
    if safety != "calibrated":
        raise InputError(
            f"mappers.{name}.safety", safety, 'must be "calibrated" to use a calibration'
        )
    return name


def _fly_and_sample(task: _CalibrationFlight) -> list[SiteSamples]:
    """Fly one descent under the scenario's policy; return sites sampled from its maps.

    The maps are those that the policy used for a decision.
    """
    scenario = task.scenario
    seed = calibration_seed(task.root, task.flight)
    simulation = Simulation(scenario, seed, scenario.policy.kind)
    computer = simulation.computer
    mapper = computer.mappers[task.mapper]
    assert isinstance(mapper, GaussianDemMapper)
    rng = RandomStreams(seed).get("calibration.sites")
    found, last, error = [], None, simulation.navigation_error
    while not simulation.done and computer.altitude >= computer.decisions.last_altitude:
        if task.mapper in computer.updated_mappers:
            error = simulation.navigation_error
        if simulation.decision_due and not mapper.is_empty:
            drawn = mapper.hazard_map()
            if drawn is not last:
                last = drawn
                evidence = dem_site_evidence(
                    mapper.dem(), mapper.lander, mapper.rocks, mapper.beam_ratio
                )
                truth = simulation.truth
                found.append(sample_sites(evidence, truth, error, task.sites, task.flight, rng))
        simulation.step()
    return found


def _comparisons_by_domain(
    result: CalibrationResult,
) -> tuple[tuple[str, CalibrationComparison], ...]:
    """Return the comparison of two calibrations on the domain of each, with its name.

    The calibrations are the one supplied with lunarsim ("packaged") and the refit. In each of the
    two domains, they are compared on the same sites.
    """
    return (
        ("packaged", result.left_out.packaged_domain),
        ("refit", result.left_out.refit_domain),
    )


def calibration_table(result: CalibrationResult) -> Table:
    """Build a table of the quality of the supplied and the refitted calibration.

    The supplied ("packaged") calibration comes with lunarsim. Values have 95 % intervals.
    """
    c = result.calibration
    table = Table(
        title=f"{c.scenario}: {c.sites} sites on {result.maps} maps of {c.flights} flights, "
        "leave-one-flight-out"
    )
    for heading in _HEADINGS:
        table.add_column(
            heading, justify="left" if heading in ("Domain", "Calibration") else "right"
        )
    for name, comparison in _comparisons_by_domain(result):
        for calibration, quality in (
            ("packaged", comparison.packaged),
            ("refit", comparison.refit),
        ):
            table.add_row(name, calibration, *_quality_cells(quality))
        table.add_section()
    return table


def _quality_cells(quality: ProbabilityQuality) -> tuple[str, ...]:
    """Return the formatted table cells of one calibration's quality metrics."""
    return (
        str(quality.sites),
        _with_interval(quality.share, "{:.2f}"),
        _with_interval(quality.safe, "{:.3f}"),
        _with_interval(quality.ece),
        _with_interval(quality.skill, "{:+.3f}"),
        str(quality.confident_sites),
        _with_interval(quality.bias, "{:+.4f}"),
    )


def _with_interval(values: Array, form: str = "{:.4f}") -> str:
    """Format value, lower and upper limit (3,) as text; "-" for a value that is NaN.

    `form` is the format string of one number.
    """
    if not np.isfinite(values[0]):
        return "-"
    value, low, high = (form.format(v) for v in values)
    return f"{value} [{low}, {high}]"


def calibration_remarks(result: CalibrationResult) -> Iterator[str]:
    """Yield sentences on the quality and the coefficients of a refitted calibration.

    They state for each domain whether the refit is better than the calibration supplied with
    lunarsim.
    """
    left = result.left_out.refit_domain
    for name, comparison in _comparisons_by_domain(result):
        gain = comparison.gain
        if not np.isfinite(gain).all():
            yield f"In the {name} domain there are no sites to compare the refit on."
            continue
        word = "better" if comparison.better else ("worse" if gain[2] < 0.0 else "no better")
        yield (
            f"In the {name} domain the refit is {word} than the packaged calibration on "
            f"held-out flights: the Brier score is lower by {_with_interval(gain, '{:+.4f}')}."
        )
    if left.refit.skill[0] <= 0.0:
        yield (
            "On held-out flights its probabilities are less informative than the mean safe share: "
            "use more flights."
        )
    if not any(comparison.better for _, comparison in _comparisons_by_domain(result)):
        yield "The refit gives no improvement: use the packaged calibration."
    c = result.calibration
    yield (
        f"Log odds of the refit: {c.inside.intercept:+.3f} {c.inside.slope:+.3f} x packaged in the "
        f"packaged domain, {c.outside.intercept:+.3f} {c.outside.slope:+.3f} x packaged outside"
    )
