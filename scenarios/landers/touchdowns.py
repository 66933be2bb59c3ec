"""Compare the static touchdown criteria with the simulated motion on the legs.

A vehicle touches down at random positions on relief with rocks, with random speeds, tilts and
rates. Each touchdown is evaluated twice: by the static limits, and by a simulation of the motion on
legs with spring, damping and crush. The table counts both outcomes; the fraction of static-safe
touchdowns that tip over is given with its 95 % interval.

python scenarios/landers/touchdowns.py --touchdowns 500 --jobs 2
python scenarios/landers/touchdowns.py --touchdowns 100 --relief 8 --lateral-speed-sigma 0.5
--com-height 3.2
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from lunarsim import RandomStreams, Terrain, flight_seed
from lunarsim.api import Lander, State, quat_rotate
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion
from lunarsim.frames import attitude_from_thrust, quat_from_rotation_vector, quat_multiply
from lunarsim.rocks.population import RockPopulation
from lunarsim.vehicle import Dynamics, evaluate_touchdown, pad_contacts
from lunarsim.vehicle.legs import Legs, evaluate_motion
from lunarsim.world.terrain_models.fractal import FractalTerrain

RELIEFS = (0.0, 3.0, 6.0)  # RMS slope, deg
COVERS = (0.02, 0.05)
GRAVITY = 1.622
PER_GROUND = 10
Array = NDArray[np.float64]


@dataclass(frozen=True)
class TouchdownTask:
    """Settings of several simulated touchdowns on one terrain.

    `number` is the number of the terrain and `count` that of the touchdowns. `relief` is the RMS
    slope (deg), `cover` the rock cover (fraction), `lateral_speed_sigma` the lateral speed (1 sigma
    per axis, m/s), `com_height` the height of the center of mass above the pads (m) and `friction`
    the coefficient between pads and terrain.
    """

    number: int
    count: int
    relief: float
    cover: float
    seed: int
    friction: float
    lateral_speed_sigma: float
    com_height: float


@dataclass(frozen=True)
class TouchdownOutcome:
    """Outcome of one touchdown by the static criteria and by the simulated motion.

    `static` and `motion` list the failed criteria (empty: safe). `tilt_deg` and `stroke_m` are tilt
    and maximum leg stroke at rest; NaN if the vehicle does not come to rest.
    """

    relief: float
    cover: float
    static: tuple[str, ...]
    motion: tuple[str, ...]
    tilt_deg: float
    stroke_m: float


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


def simulate_touchdowns(task: TouchdownTask) -> list[TouchdownOutcome]:
    """Evaluate touchdowns on one terrain by static criteria and simulated motion."""
    seed = flight_seed(task.seed, task.number)
    rocks = RockPopulation(cover=task.cover, min_diameter=0.2)
    terrain = FractalTerrain(size=80.0, rms_slope=np.deg2rad(task.relief)).build(
        rocks, RandomStreams(seed)
    )
    rng = np.random.default_rng(seed.spawn(1)[0])
    lander, legs = Lander(com_height=task.com_height), Legs(friction=task.friction)
    dynamics = Dynamics(lander, GRAVITY)
    found = []
    while len(found) < task.count:
        state = first_contact_state(lander, terrain, rng, task.lateral_speed_sigma)
        if state is None:
            continue
        static = evaluate_touchdown(lander, state, terrain, GRAVITY)
        motion, rest = evaluate_motion(legs, dynamics, state, terrain)
        tilt = float("nan") if rest is None else float(np.rad2deg(rest.tilt))
        stroke = float("nan") if rest is None else float(rest.strokes.max())
        found.append(
            TouchdownOutcome(
                task.relief, task.cover, static.failure_causes, motion.failure_causes, tilt, stroke
            )
        )
    return found


def count_outcome_pairs(touchdowns: list[TouchdownOutcome]) -> dict[str, int]:
    """Count the touchdowns for each pair of outcomes by static criteria and by motion."""
    counts = Counter(
        f"static {'safe' if not one.static else 'unsafe'}, "
        f"motion {'safe' if not one.motion else 'unsafe'}"
        for one in touchdowns
    )
    return dict(counts)


@click.command()
@click.option("--touchdowns", type=click.IntRange(min=1), default=500, show_default=True,
              help="Number of simulated touchdowns.")  # fmt: skip
@click.option("--friction", type=click.FloatRange(0.0, 3.0, min_open=True), default=0.7,
              show_default=True, help="Friction coefficient between pads and terrain.")  # fmt: skip
@click.option("--relief", "reliefs", type=click.FloatRange(0.0, 25.0), multiple=True,
              default=RELIEFS, show_default=True,
              help="RMS slope of the terrain (deg); repeat the option for several "
              "slopes.")  # fmt: skip
@click.option("--lateral-speed-sigma", type=click.FloatRange(0.0, 5.0), default=0.25,
show_default=True,
              help="Random lateral speed at touchdown, 1 sigma per axis (m/s).")  # fmt: skip
@click.option("--com-height", type=click.FloatRange(0.5, 6.0), default=Lander().com_height,
              show_default=True,
              help="Height of the centre of mass above the landing pads (m).")  # fmt: skip
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option(
    "--json",
    "out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="JSON file for all results. Default: none.",
)
def main(
    touchdowns: int, friction: float, reliefs: tuple[float, ...], lateral_speed_sigma: float,
    com_height: float, seed: int, jobs: int, out: Path | None,
) -> None:  # fmt: skip
    """Compare the static touchdown criteria with simulated motion on the legs."""
    console = plain_console(120)
    cases = [(relief, cover) for relief in reliefs for cover in COVERS]
    tasks, left = [], touchdowns
    while left > 0:
        relief, cover = cases[len(tasks) % len(cases)]
        count = min(PER_GROUND, left)
        tasks.append(
            TouchdownTask(
                len(tasks), count, relief, cover, seed, friction, lateral_speed_sigma, com_height
            )
        )
        left -= count
    landed = [
        one
        for some in collect_results(simulate_touchdowns, tasks, jobs, console, "terrains")
        for one in some
    ]
    report(console, landed)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        rows = [asdict(one) for one in landed]
        out.write_text(
            json.dumps({"confusion": count_outcome_pairs(landed), "touchdowns": rows}, indent=1)
        )


def report(console: Console, touchdowns: list[TouchdownOutcome]) -> None:
    """Print both outcomes by terrain, and failures in motion that are safe statically."""
    table = Table(title="Touchdown outcomes by static criteria and by motion")
    for name in (
        "RMS slope (deg)",
        "rock cover",
        "touchdowns",
        "both safe",
        "static only safe",
        "motion only safe",
        "neither safe",
    ):
        table.add_column(name, justify="right")
    for relief, cover in [*sorted({(one.relief, one.cover) for one in touchdowns}), (None, None)]:
        some = [o for o in touchdowns if relief is None or (o.relief, o.cover) == (relief, cover)]
        both = Counter((not o.static, not o.motion) for o in some)
        name = ("all", "") if relief is None else (f"{relief:g}", f"{cover:g}")
        cells = [both[True, True], both[True, False], both[False, True], both[False, False]]
        table.add_row(*name, str(len(some)), *map(str, cells))
    console.print(table)
    safe = [one for one in touchdowns if not one.static]
    tipped = sum("tip-over" in one.motion for one in safe)
    console.print(
        f"Static-safe touchdowns that tip over: {tipped} of {len(safe)}, "
        f"{Proportion(tipped, len(safe))}; "
        "target: below 0.01"
    )
    why = dict(Counter(f for one in safe for f in one.motion))
    console.print(f"Failed motion criteria of static-safe touchdowns: {why}")
    console.print(
        f"All touchdowns that tip over: {sum('tip-over' in one.motion for one in touchdowns)}"
    )


if __name__ == "__main__":
    main()
