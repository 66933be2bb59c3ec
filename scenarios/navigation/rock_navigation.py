"""Test whether rock navigation declares itself lost in difficult conditions.

The script flies `shadow_nominal.toml` with images at 2.5 Hz from 160 m, over relief of 0 to 8 deg,
with a rock cover of 2 to 15 % and an error of the assumed Sun azimuth of up to 180 deg; then with
images that fail from 28 s. An error is too large if velocity, attitude, height above terrain or
position relative to the rocks exceeds five standard deviations on an axis. A flight fails
undeclared if it ends with such an error and navigation does not declare itself lost. The policy is
not informed: landing results show the effect of a fault.

python scenarios/navigation/rock_navigation.py --flights 1
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from consistency import SCENARIOS, error_of
from scipy.spatial import cKDTree
from shared_options import declared_table, json_option, seed_and_jobs, write_flights

from lunarsim import Scenario, Simulation, Terrain, flight_seed
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.frames import rotation_about_up
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.shadows import ShadowMapper
from lunarsim.onboard.navigation.error_state import MAP
from lunarsim.onboard.navigation.terrain_heights import TERRAIN

RELIEFS = (0.0, 2.0, 4.0, 8.0)  # RMS slope, deg
COVERS = (0.02, 0.08, 0.15)
SUNS = (0.0, 5.0, 45.0, 180.0)  # error of the Sun azimuth, deg
FAULT_START_S, FAULT_END_S = 28.0, 32.0  # s
MAX_ERROR_SIGMA = 5.0  # standard deviations

Tamper = Callable[[CameraImage, np.random.Generator], CameraImage | None]


def blacken(image: CameraImage, rng: np.random.Generator) -> CameraImage:
    """Return a black image with the same time and camera; `rng` has no effect."""
    return CameraImage(image.time, np.zeros_like(image.counts), image.camera)


FAULTS: dict[str, tuple[float, Tamper]] = {
    "half of the pictures lost": (np.inf, lambda p, rng: p if rng.random() < 0.5 else None),
    "no pictures for 4 s": (FAULT_END_S, lambda p, rng: None),
    "black pictures for 4 s": (FAULT_END_S, blacken),
    "no more pictures": (np.inf, lambda p, rng: None),
}


@dataclass(frozen=True)
class RockNavigationTask:
    """Settings of one simulated flight with navigation on tracked rocks.

    `relief` is the RMS slope (deg), `cover` the rock cover (fraction), `sun_azimuth_error` the
    error of the Sun azimuth that the mapper assumes (deg) and `fault` the name of the image fault
    in `FAULTS` ("": none). `flight` and `seed` (root seed) determine the random numbers.
    """

    relief: float
    cover: float
    sun_azimuth_error: float
    fault: str
    flight: int
    seed: int


@dataclass(frozen=True)
class RockNavigationFlight:
    """Results of one simulated flight with navigation on tracked rocks.

    Attributes
    ----------
    error_sigmas
        Maximum errors at the end in standard deviations: velocity, attitude, height above the
        terrain, position relative to the rocks.
    lost, ever_lost
        Whether navigation declared itself lost at the end, and whether it ever did.
    inflated
        Number of `covariance-inflated` and `rocks-reset` events of the rock measurements.
    safe
        Whether the landing was safe.
    """

    task: RockNavigationTask
    error_sigmas: tuple[float, float, float, float]
    lost: bool
    ever_lost: bool
    inflated: int
    safe: bool

    @property
    def far(self) -> bool:
        """Whether an error exceeded five standard deviations at the end."""
        return max(self.error_sigmas) > MAX_ERROR_SIGMA


def fly(task: RockNavigationTask) -> RockNavigationFlight:
    """Simulate one flight with navigation on tracked rocks and the given fault."""
    scenario = Scenario.load(SCENARIOS / "shadow_nominal.toml").changed(
        terrain={"rms_slope_deg": task.relief},
        rocks={"cover": task.cover},
        expected_rocks={"cover": task.cover},
        tasking={"camera": {"kind": "periodic", "rate_hz": 2.5, "first_altitude_m": 160.0}},
    )
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), "safest")
    mapper = simulation.computer.mapper
    if not isinstance(mapper, ShadowMapper):
        raise click.UsageError("shadow_nominal.toml: the first mapper must be of the kind 'shadow'")
    apply_faults(mapper, task)
    errors = RockNavigationErrors(simulation, mapper)
    while not simulation.done:
        # Only in flight: no measurements are taken at rest.
        worst, lost = errors.current(), simulation.computer.estimate.lost
        simulation.step()
    events = [(name, d.get("measurement", "")) for _, name, d in simulation.computer.telemetry]
    inflated = sum(
        name in {"covariance-inflated", "rocks-reset"} and "rocks" in what for name, what in events
    )
    ever = any(name == "lost" for name, _ in events)
    return RockNavigationFlight(task, worst, lost, ever, inflated, simulation.outcome.safe)


def apply_faults(mapper: ShadowMapper, task: RockNavigationTask) -> None:
    """Rotate the Sun direction that a shadow mapper assumes; add faults to its images."""
    mapper.sun = rotation_about_up(np.deg2rad(task.sun_azimuth_error)) @ mapper.sun
    if not task.fault:
        return
    rng = np.random.default_rng([task.seed, task.flight])
    update_unchanged, (end, tamper) = mapper.update, FAULTS[task.fault]

    def update_faulty(image: CameraImage, estimate: Any) -> None:
        left = tamper(image, rng) if FAULT_START_S <= image.time < end else image
        if left is not None:
            update_unchanged(left, estimate)

    mapper.update = update_faulty  # type: ignore[method-assign]


class RockNavigationErrors:
    """Compute the current navigation errors of a flight in standard deviations.

    The errors are those of `RockNavigationFlight.error_sigmas`: velocity, attitude, height above
    the terrain, and position relative to the rocks.
    """

    def __init__(self, simulation: Simulation, mapper: ShadowMapper) -> None:
        self.simulation, self.mapper = simulation, mapper
        terrain = simulation.world.terrain
        self.rough, self.bare = terrain, Terrain(terrain.relief)
        self.rocks = cKDTree(np.column_stack((terrain.rocks.x, terrain.rocks.y)))

    def current(self) -> tuple[float, float, float, float]:
        """Return the current errors in standard deviations.

        They are the maxima over the axes of velocity and attitude, the height above the terrain,
        and the position relative to the rocks.
        """
        state, rocks = self.simulation.state, self.mapper.tracker.filter
        off = np.abs(error_of(self.simulation))[3:]
        off = off / np.sqrt(np.diag(self.simulation.estimate.covariance)[3:])
        # Terrain height in the lander frame: state entries of height, terrain and map.
        at = [2, rocks.state.block(TERRAIN).start, rocks.state.block(MAP).start + 2]
        over = np.array([1.0, -1.0, -1.0])
        # The altimeter can measure the terrain or the top of a rock.
        below = [float(t.elevation(state.position[:2])) for t in (self.bare, self.rough)]
        above = state.position[2] - np.array(below)
        height = np.min(np.abs(above - (rocks.inertial.position[2] - rocks.terrain_height_below)))
        spread = np.sqrt(max(over @ rocks.covariance[np.ix_(at, at)] @ over, 1e-12))
        off_height = height / spread if np.isfinite(height) else 0.0
        return (
            float(off[:3].max()),
            float(off[3:].max()),
            float(off_height),
            self.relative_to_rocks(),
        )

    def relative_to_rocks(self) -> float:
        """Return the position error relative to nearby rocks, in standard deviations."""
        tracker, rocks = self.mapper.tracker, self.mapper.tracker.filter
        away = np.hypot(*(rocks.xy - rocks.inertial.position[:2]).T)
        at = np.flatnonzero((tracker.existence > 0.9) & (rocks.radius > 0.25) & (away < 30.0))
        if len(at) < 5:
            return 0.0
        here = self.simulation.state.position[:2]
        found = rocks.xy[at] - rocks.inertial.position[:2] + here
        off = np.median(found - self.rocks.data[self.rocks.query(found)[1]], axis=0)
        own = rocks.relative_covariance()[at][:, [0, 1], [0, 1]]
        shape = (tracker.model.centre_sigma * rocks.radius[at, None]) ** 2
        return float((np.abs(off) / np.sqrt(np.median(own + shape, axis=0))).max())


def tasks_of(
    flights: int, seed: int, reliefs: tuple[float, ...], covers: tuple[float, ...]
) -> list[RockNavigationTask]:
    """Return the settings of all flights of the study.

    `flights` is the number of flights per combination of conditions, `reliefs` are RMS slopes (deg)
    and `covers` rock covers (fractions).
    """
    matrix = [(r, c, s, "") for s in SUNS for r in reliefs for c in covers]
    failing = [(r, 0.08, 0.0, fault) for fault in FAULTS for r in reliefs]
    # Every combination of conditions has its own terrain.
    return [
        RockNavigationTask(*cell, flight=n * len(matrix + failing) + k, seed=seed)
        for n in range(flights) for k, cell in enumerate(matrix + failing)
    ]  # fmt: skip


def flights_by_condition(
    flights: list[RockNavigationFlight],
) -> list[tuple[str, list[RockNavigationFlight]]]:
    """Group the flights by condition: return names and flights of table rows."""
    right = [f for f in flights if f.task.sun_azimuth_error == 0.0 and not f.task.fault]
    reliefs, covers = ({getattr(f.task, k) for f in right} for k in ("relief", "cover"))
    rows = [
        (f"relief of {r:g} deg", [f for f in right if f.task.relief == r]) for r in sorted(reliefs)
    ]
    rows += [(f"cover of {c:.0%}", [f for f in right if f.task.cover == c]) for c in sorted(covers)]
    rows += [
        (f"Sun {s:g} deg off", [f for f in flights if f.task.sun_azimuth_error == s])
        for s in SUNS
        if s > 0.0
    ]
    rows += [(fault, [f for f in flights if f.task.fault == fault]) for fault in FAULTS]
    return [row for row in (*rows, ("all", flights)) if row[1]]


def fault_name_of(task: RockNavigationTask) -> str:
    """Return the name of a flight's fault; "none" if it has none."""
    return task.fault or (
        f"Sun {task.sun_azimuth_error:g} deg off" if task.sun_azimuth_error else "none"
    )


@click.command()
@click.option(
    "--flights",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of flights for each of the 64 combinations of conditions.",
)
@click.option(
    "--relief",
    "reliefs",
    type=click.FloatRange(0.0, 30.0),
    multiple=True,
    default=RELIEFS,
    show_default=True,
    help="RMS slope of the terrain (deg); repeat the option for several slopes.",
)
@click.option(
    "--cover",
    "covers",
    type=click.FloatRange(0.001, 0.3),
    multiple=True,
    default=COVERS,
    show_default=True,
    help="Fraction of the terrain covered by rocks; repeat the option for several values.",
)
@json_option
@seed_and_jobs
@click.option("--cells", is_flag=True, help="Print the results of every flight also.")
def main(
    flights: int, seed: int, reliefs: tuple[float, ...], covers: tuple[float, ...], jobs: int,
    out: Path | None, cells: bool,
) -> None:  # fmt: skip
    """Fly with rock navigation in difficult conditions; count undeclared failures."""
    console = plain_console(120)
    tasks = tasks_of(flights, seed, reliefs, covers)
    flown = collect_results(fly, tasks, jobs, console, "flights")
    if cells:
        for f in flown:
            t, off = f.task, ", ".join(f"{w:.1f}" for w in f.error_sigmas)
            console.print(
                f"relief {t.relief:g} cover {t.cover:g} Sun {t.sun_azimuth_error:g} "
                f"{t.fault or 'no fault'}: {off} sigma, lost {f.lost} (ever {f.ever_lost}), "
                f"suspect {f.inflated}, safe {f.safe}"
            )
    title = "Flights with rock navigation; rows of relief and cover: correct Sun, no fault"
    console.print(declared_table(title, "flights with", flights_by_condition(flown)))
    write_flights(out, [(fault_name_of(f.task), [f]) for f in flown])


if __name__ == "__main__":
    main()
