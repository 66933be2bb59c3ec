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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import click
import numpy as np
from navigation_errors import SCENARIOS, error_of
from scipy.spatial import cKDTree
from undeclared_failures import declared_table

from lunarsim import Scenario, Simulation, Terrain, flight_seed
from lunarsim.frames import rotation_about_up
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.shadows import ShadowMapper
from lunarsim.onboard.navigation.error_state import MAP
from lunarsim.onboard.navigation.terrain_heights import TERRAIN
from lunarsim.studies import Case, Report, Study, run_script

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
# Name of each error of the Sun azimuth.
SUN_NAMES = {s: f"Sun {s:g} deg off" if s else "none" for s in SUNS}


@dataclass(frozen=True)
class Conditions:
    """Conditions of one simulated flight with navigation on tracked rocks.

    `relief` is the RMS slope (deg), `cover` the rock cover (fraction), `sun_azimuth_error` the
    error of the Sun azimuth that the mapper assumes (deg) and `fault` the name of the image fault
    in `FAULTS` ("": none).
    """

    relief: float
    cover: float
    sun_azimuth_error: float
    fault: str

    @property
    def name(self) -> str:
        """Name of the image fault or of the Sun error; "none" without both."""
        return self.fault or SUN_NAMES[self.sun_azimuth_error]


def all_conditions(reliefs: Sequence[float], covers: Sequence[float]) -> list[Conditions]:
    """Return all combinations of conditions; image faults have a cover of 8 % only."""
    matrix = [Conditions(r, c, s, "") for s in SUNS for r in reliefs for c in covers]
    return matrix + [Conditions(r, 0.08, 0.0, fault) for fault in FAULTS for r in reliefs]


def fly_conditions(case: Case) -> list[dict[str, Any]]:
    """Simulate one flight for each relief and cover, with one fault.

    Every combination of conditions has its own terrain.
    """
    conditions = all_conditions(case["relief"], case["cover"])
    return [
        fly(one, case.number * len(conditions) + k, case.seed)
        for k, one in enumerate(conditions)
        if one.name == case["fault"]
    ]


def fly(conditions: Conditions, flight: int, seed: int) -> dict[str, Any]:
    """Simulate one flight with navigation on tracked rocks and the given fault.

    `flight` and `seed` (root seed) determine the random numbers. The row has the maximum errors at
    the end in standard deviations (velocity, attitude, height above the terrain, position relative
    to the rocks), whether one of them exceeded five (`far`), whether navigation declared itself
    lost at the end and at any time, the number of `covariance-inflated` and `rocks-reset` events of
    the rock measurements, and whether the landing was safe.
    """
    scenario = Scenario.load(SCENARIOS / "shadow_nominal.toml").changed(
        terrain={"rms_slope_deg": conditions.relief},
        rocks={"cover": conditions.cover},
        expected_rocks={"cover": conditions.cover},
        tasking={"camera": {"kind": "periodic", "rate_hz": 2.5, "first_altitude_m": 160.0}},
    )
    simulation = Simulation(scenario, flight_seed(seed, flight), "safest")
    mapper = simulation.computer.mapper
    if not isinstance(mapper, ShadowMapper):
        raise click.UsageError("shadow_nominal.toml: the first mapper must be of the kind 'shadow'")
    apply_faults(mapper, conditions, np.random.default_rng([seed, flight]))
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
    return {
        "relief": conditions.relief, "cover": conditions.cover,
        "sun_azimuth_error_deg": conditions.sun_azimuth_error, "error_sigmas": worst,
        "far": max(worst) > MAX_ERROR_SIGMA, "lost": lost, "ever_lost": ever,
        "inflated": inflated, "safe": simulation.outcome.safe,
    }  # fmt: skip


def apply_faults(mapper: ShadowMapper, conditions: Conditions, rng: np.random.Generator) -> None:
    """Rotate the Sun direction that a shadow mapper assumes; add faults to its images."""
    mapper.sun = rotation_about_up(np.deg2rad(conditions.sun_azimuth_error)) @ mapper.sun
    if not conditions.fault:
        return
    update_unchanged, (end, tamper) = mapper.update, FAULTS[conditions.fault]

    def update_faulty(image: CameraImage, estimate: Any) -> None:
        left = tamper(image, rng) if FAULT_START_S <= image.time < end else image
        if left is not None:
            update_unchanged(left, estimate)

    mapper.update = update_faulty  # type: ignore[method-assign]


class RockNavigationErrors:
    """Compute the current navigation errors of a flight in standard deviations.

    The errors are those of velocity, attitude, height above the terrain, and position relative to
    the rocks.
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
        """Return the position error relative to nearby rocks, in standard deviations.

        It is the larger of the values east and north, and 0 if fewer than five large rocks are
        tracked within 30 m.
        """
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


def print_declared(report: Report) -> None:
    """Print the number of large errors and of declared failures by condition.

    With `--cells`, the errors of every flight are printed first.
    """
    for f in report.rows if report.options["cells"] else ():
        off = ", ".join(f"{w:.1f}" for w in f["error_sigmas"])
        fault = f["fault"] if f["fault"] in FAULTS else "no fault"
        report.print(
            f"relief {f['relief']:g} cover {f['cover']:g} Sun {f['sun_azimuth_error_deg']:g} "
            f"{fault}: {off} sigma, lost {f['lost']} (ever {f['ever_lost']}), "
            f"suspect {f['inflated']}, safe {f['safe']}"
        )
    by_fault = {fault: rows for (fault,), rows in report.groups("fault").items()}
    right = by_fault.pop("none", [])
    groups = [
        (text.format(value), [f for f in right if f[name] == value])
        for name, text in (("relief", "relief of {:g} deg"), ("cover", "cover of {:.0%}"))
        for value in sorted({f[name] for f in right})
    ]
    title = "Flights with rock navigation; rows of relief and cover: correct Sun, no fault"
    rows = [*groups, *by_fault.items(), ("all", report.rows)]
    report.print(declared_table(title, "flights with", rows))


study = Study(
    fly_conditions,
    repeats="flights",
    count=1,
    factors={"fault": [*SUN_NAMES.values(), *FAULTS]},
    factor_help={"fault": "Error of the assumed Sun azimuth, or name of an image fault."},
    options=(
        click.Option(
            ["--relief"], type=click.FloatRange(0.0, 30.0), multiple=True, default=RELIEFS,
            show_default=True,
            help="RMS slope of the terrain (deg); repeat the option for several slopes.",
        ),
        click.Option(
            ["--cover"], type=click.FloatRange(0.001, 0.3), multiple=True, default=COVERS,
            show_default=True,
            help="Fraction of the terrain covered by rocks; repeat the option for several values.",
        ),
        click.Option(
            ["--cells"], is_flag=True, default=False, help="Print the results of every flight also."
        ),
    ),
    report=print_declared,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
