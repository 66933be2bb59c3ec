"""Where level ground and uniform gravity will do, and how far: beside a round, turning Moon.

For places about a site: how far the sphere lies below the site's level, by how much what moves a
body there differs (gravity's size and direction, centrifugal), and what comes of that in a fall of
30 s. Then flights of the last kilometre on both, the same seeds.

python scenarios/guidance/round_and_flat.py --flights 5
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.models.gravity import RoundMoon
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.vehicle import Dynamics, State

PLACES = ((0.6, 0.5), (1.0, 1.0), (3.0, 1.0), (10.0, 2.5), (50.0, 6.0), (440.0, 15.0))  # km
GRAVITY, SECONDS = 1.622, 30.0
FLOWN: dict[str, Any] = {
    "name": "round-and-flat",
    "terrain": {"kind": "fractal", "size_m": 200.0, "rms_slope_deg": 1.0},
    "rocks": {"cover": 0.0},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}


def fallen(moon: Any, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return where a body falls to in 30 s (3,), m; `moon` None: over level ground."""
    dynamics = Dynamics(Lander(), GRAVITY, 0.1, moon)
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(position, velocity, upright, np.zeros(3), 1500.0)
    for _ in range(round(SECONDS / 0.1)):
        state = dynamics.advance(state, 0.0, np.zeros(3))
    return state.position


def places() -> Table:
    """Return what differs at places about the site."""
    moon = RoundMoon().gravity(GRAVITY)
    table = Table(title="A round, turning Moon beside level ground")
    for heading in ("from the site km", "up km", "sphere below the level m", "pull aside m/s^2",
                    "pull less m/s^2", "apart after a fall of 30 s m"):  # fmt: skip
        table.add_column(heading, justify="right")
    for way, height in PLACES:
        angle, r = 1e3 * way / moon.radius, moon.radius + 1e3 * height
        place = np.array([-r * np.sin(angle), 0.0, r * np.cos(angle) - moon.radius])
        velocity = np.array([40.0 * way, 0.0, -20.0]) if way < 40.0 else np.array([1e3, 0.0, -20.0])
        pull = moon.felt(place, np.zeros(3)) + np.array([0.0, 0.0, GRAVITY])
        apart = np.linalg.norm(fallen(moon, place, velocity) - fallen(None, place, velocity))
        below = moon.radius * (1.0 - np.cos(angle))
        table.add_row(
            f"{way:g}", f"{height:g}", f"{below:.2f}", f"{pull[0]:.5f}", f"{pull[2]:.5f}",
            f"{apart:.2f}",
        )  # fmt: skip
    return table


@click.command()
@click.option("--flights", type=click.IntRange(min=1), default=5, show_default=True,
              help="Of each.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="First.")
def main(flights: int, seed: int) -> None:
    """Print where round and level ground differ, and flights of the last kilometre on both."""
    console = plain_console(120)
    console.print(places())
    flat = Scenario.from_dict(FLOWN)
    apart, more = [], []
    for n in range(seed, seed + flights):
        a, b = (Simulation(s, n, "no-divert").run() for s in (flat, flat.changed(moon={})))
        rows = min(len(a.positions), len(b.positions))
        apart.append(np.abs(a.positions[:rows] - b.positions[:rows]).max())
        more.append(b.propellant_used - a.propellant_used)
    console.print(
        f"{flights} flights from 600 m away and 500 m up: paths at most {max(apart):.3f} m apart; "
        f"on the sphere {np.mean(more):+.3f} kg of propellant (from {min(more):+.3f} to "
        f"{max(more):+.3f})."
    )


if __name__ == "__main__":
    main()
