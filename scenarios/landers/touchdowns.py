"""Compare the static touchdown criteria with the simulated motion on the legs.

A vehicle touches down at random positions on relief with rocks, with random speeds, tilts and
rates. Each touchdown is evaluated twice: by the static limits, and by a simulation of the motion on
legs with spring, damping and crush. The table counts both outcomes; the fraction of static-safe
touchdowns that tip over is given with its 95 % interval.

python scenarios/landers/touchdowns.py --terrains 50 --jobs 2
python scenarios/landers/touchdowns.py --terrains 10 --relief 8 --lateral-speed-sigma 0.5
--com-height 3.2
"""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from lunarsim import RandomStreams, Terrain, flight_seed
from lunarsim.api import Lander, State, quat_rotate
from lunarsim.frames import attitude_from_thrust, quat_from_rotation_vector, quat_multiply
from lunarsim.rocks.population import RockPopulation
from lunarsim.studies import Case, Proportion, Report, Study, run_script
from lunarsim.vehicle import Dynamics, evaluate_touchdown, pad_contacts
from lunarsim.vehicle.legs import Legs, evaluate_motion
from lunarsim.world.terrain_models.fractal import FractalTerrain

RELIEFS = (0.0, 3.0, 6.0)  # RMS slope, deg
COVERS = (0.02, 0.05)
GRAVITY = 1.622
TOUCHDOWNS = 10  # on each terrain
Array = NDArray[np.float64]


def first_contact_state(
    lander: Lander, terrain: Terrain, rng: np.random.Generator, lateral_speed_sigma: float = 0.25
) -> State | None:
    """Sample a random state in which the first pad touches the terrain.

    `lateral_speed_sigma` is the standard deviation of the lateral speed per axis, m/s. Returns None
    over unknown terrain.
    """
    west, east, south, north = terrain.bounds
    room = 12.0
    xy = rng.uniform((west + room, south + room), (east - room, north - room))
    level = attitude_from_thrust([0.0, 0.0, 1.0], rng.uniform(0.0, 2.0 * np.pi))
    lean = np.deg2rad(1.5) * np.array([*rng.standard_normal(2), 0.0])
    attitude = quat_multiply(level, quat_from_rotation_vector(lean))
    velocity = np.array(
        [*(lateral_speed_sigma * rng.standard_normal(2)), -2.0 + 0.2 * rng.standard_normal()]
    )
    rate = np.deg2rad(1.0) * rng.standard_normal(3)
    high = State(np.array([*xy, 0.0]), velocity, attitude, rate, 1200.0)
    pads = pad_contacts(lander, high, terrain)
    drop = float(np.max(pads[:, 2] - quat_rotate(attitude, lander.pads)[:, 2]))
    if not np.isfinite(drop):
        return None
    return State(np.array([*xy, drop]), velocity, attitude, rate, 1200.0)


def simulate_touchdowns(case: Case) -> list[dict[str, Any]]:
    """Evaluate ten touchdowns on one terrain by static criteria and simulated motion.

    A row has the criteria that failed in each of the two evaluations (empty: safe), and tilt and
    maximum leg stroke at rest (NaN if the vehicle does not come to rest).
    """
    combinations = list(itertools.product(case["relief"], COVERS))
    relief, cover = combinations[case.number % len(combinations)]
    seed = flight_seed(case.seed, case.number)
    rocks = RockPopulation(cover=cover, min_diameter=0.2)
    terrain = FractalTerrain(size=80.0, rms_slope=np.deg2rad(relief)).build(
        rocks, RandomStreams(seed)
    )
    rng = np.random.default_rng(seed.spawn(1)[0])
    lander, legs = Lander(com_height=case["com_height"]), Legs(friction=case["friction"])
    dynamics = Dynamics(lander, GRAVITY)
    found = []
    while len(found) < TOUCHDOWNS:
        state = first_contact_state(lander, terrain, rng, case["lateral_speed_sigma"])
        if state is None:
            continue
        static = evaluate_touchdown(lander, state, terrain, GRAVITY)
        motion, rest = evaluate_motion(legs, dynamics, state, terrain)
        tilt = float("nan") if rest is None else float(np.rad2deg(rest.tilt))
        stroke = float("nan") if rest is None else float(rest.strokes.max())
        found.append({
            "relief": relief, "cover": cover, "static": static.failure_causes,
            "motion": motion.failure_causes, "tilt_deg": tilt, "stroke_m": stroke,
        })  # fmt: skip
    return found


def print_outcomes(report: Report) -> None:
    """Print touchdown outcomes by static criteria and by simulated motion.

    A table counts the outcomes by slope and rock cover. Touchdowns that are safe by the static
    criteria but tip over or fail in the simulation are counted below it.
    """
    table = Table(title="Touchdown outcomes by static criteria and by motion")
    for name in (
        "RMS slope (deg)", "rock cover", "touchdowns", "both safe", "static only safe",
        "motion only safe", "neither safe",
    ):  # fmt: skip
        table.add_column(name, justify="right")
    groups = sorted(report.groups("relief", "cover").items())
    for name, rows in [*groups, (("all", ""), report.rows)]:
        both = Counter((not row["static"], not row["motion"]) for row in rows)
        cells = [both[True, True], both[True, False], both[False, True], both[False, False]]
        table.add_row(*(f"{n}" for n in name), str(len(rows)), *map(str, cells))
    report.print(table)
    safe = [row for row in report.rows if not row["static"]]
    tipped = sum("tip-over" in row["motion"] for row in safe)
    report.print(
        f"Static-safe touchdowns that tip over: {tipped} of {len(safe)}, "
        f"{Proportion(tipped, len(safe))}; target: below 0.01"
    )
    why = dict(Counter(cause for row in safe for cause in row["motion"]))
    report.print(f"Failed motion criteria of static-safe touchdowns: {why}")
    tipped = sum("tip-over" in row["motion"] for row in report.rows)
    report.print(f"All touchdowns that tip over: {tipped}")


study = Study(
    simulate_touchdowns,
    repeats="terrains",
    count=50,
    report=print_outcomes,
    options=(
        click.Option(
            ["--friction"], type=click.FloatRange(0.0, 3.0, min_open=True), default=0.7,
            show_default=True, help="Friction coefficient between pads and terrain.",
        ),
        click.Option(
            ["--relief"], type=click.FloatRange(0.0, 25.0), multiple=True, default=RELIEFS,
            show_default=True,
            help="RMS slope of the terrain (deg); repeat the option for several slopes.",
        ),
        click.Option(
            ["--lateral-speed-sigma"], type=click.FloatRange(0.0, 5.0), default=0.25,
            show_default=True,
            help="Random lateral speed at touchdown, 1 sigma per axis (m/s).",
        ),
        click.Option(
            ["--com-height"], type=click.FloatRange(0.5, 6.0), default=Lander().com_height,
            show_default=True, help="Height of the centre of mass above the landing pads (m).",
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
