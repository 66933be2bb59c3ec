"""Compare flat terrain and uniform gravity with a rotating spherical Moon.

For positions at several distances from a site, the table gives: the depth of the sphere below the
horizontal plane of the site, the acceleration difference (gravity magnitude and direction,
centrifugal), and the resulting position difference after a fall of 30 s. Then flights of the last
kilometre are compared on both models with the same seeds.

python scenarios/guidance/spherical_and_flat_moon.py --flights 5
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table

from lunarsim import Scenario, Simulation
from lunarsim.api import Lander, State
from lunarsim.models.gravity import RoundMoon
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.vehicle import Dynamics

# distance from the site, height, km
DISTANCE_AND_HEIGHT_KM = (
    (0.6, 0.5),
    (1.0, 1.0),
    (3.0, 1.0),
    (10.0, 2.5),
    (50.0, 6.0),
    (440.0, 15.0),
)
GRAVITY, SECONDS = 1.622, 30.0
BASE_SCENARIO: dict[str, Any] = {
    "name": "round-and-flat",
    "terrain": {"kind": "fractal", "size_m": 200.0, "rms_slope_deg": 1.0},
    "rocks": {"cover": 0.0},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}


def free_fall_position(moon: Any, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the position (3,), m, after a free fall of 30 s.

    `moon` is the gravity model of the spherical Moon; None: flat terrain and uniform gravity.
    """
    dynamics = Dynamics(Lander(), GRAVITY, 0.1, moon)
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(position, velocity, upright, np.zeros(3), 1500.0)
    for _ in range(round(SECONDS / 0.1)):
        state = dynamics.advance(state, 0.0, np.zeros(3))
    return state.position


def model_differences() -> Table:
    """Return the table of spherical minus flat Moon by distance from the site.

    It compares terrain height, acceleration, and position after a free fall of 30 s.
    """
    moon = RoundMoon().gravity(GRAVITY)
    table = Table(title="Rotating spherical Moon compared with flat terrain")
    for heading in ("distance (km)", "height (km)", "sphere below plane (m)",
    "horizontal acceleration difference (m/s^2)",
                    "vertical acceleration difference (m/s^2)",
                    "position difference after 30 s (m)"):  # fmt: skip
        table.add_column(heading, justify="right")
    for way, height in DISTANCE_AND_HEIGHT_KM:
        angle, r = 1e3 * way / moon.radius, moon.radius + 1e3 * height
        place = np.array([-r * np.sin(angle), 0.0, r * np.cos(angle) - moon.radius])
        velocity = np.array([40.0 * way, 0.0, -20.0]) if way < 40.0 else np.array([1e3, 0.0, -20.0])
        pull = moon.free_fall_acceleration(place, np.zeros(3)) + np.array([0.0, 0.0, GRAVITY])
        apart = np.linalg.norm(
            free_fall_position(moon, place, velocity) - free_fall_position(None, place, velocity)
        )
        below = moon.radius * (1.0 - np.cos(angle))
        table.add_row(
            f"{way:g}", f"{height:g}", f"{below:.2f}", f"{pull[0]:.5f}", f"{pull[2]:.5f}",
            f"{apart:.2f}",
        )  # fmt: skip
    return table


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight on the spherical and on the flat Moon; compare the two.

    "path_m" is the maximum difference of any coordinate at equal times, until the earlier
    touchdown, m. "propellant_kg" is the propellant on the spherical Moon minus that on the flat
    Moon, kg.
    """
    flat = Scenario.from_dict(BASE_SCENARIO)
    a, b = (
        Simulation(s, case.seed + case.number, "no-divert").run()
        for s in (flat, flat.changed(moon={}))
    )
    n = min(len(a.positions), len(b.positions))
    return {
        "path_m": float(np.abs(a.positions[:n] - b.positions[:n]).max()),
        "propellant_kg": b.propellant_used - a.propellant_used,
    }


def print_differences(report: Report) -> None:
    """Print the differences between spherical and flat Moon: models, then flights."""
    report.print(model_differences())
    apart, more = report.column("path_m"), report.column("propellant_kg")
    report.print(
        f"{len(apart)} flights from a distance of 600 m and a height of 500 m: maximum path "
        f"difference {max(apart):.3f} m; "
        f"propellant difference on the sphere {np.mean(more):+.3f} kg (from {min(more):+.3f} to "
        f"{max(more):+.3f})."
    )


study = Study(fly, repeats="flights", count=5, report=print_differences)

if __name__ == "__main__":
    run_script(study)
