"""Compare hazard maps with thruster and with ideal attitude control.

The shadow EKF paper turns its vehicle along the great circle to the commanded attitude at a limited
rate (section IV.A.3). Here the same descents, over the same terrain and with the same noise, are
flown with that ideal attitude and with on-off thrusters. The vehicle navigates with its own
instruments and maps by LiDAR. The report compares the map quality and the landing position.

python scenarios/landers/thrusters_and_map.py --flights 20
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from rich.console import Console

from lunarsim import Flight, Scenario, Simulation, flight_seed, map_quality
from lunarsim.api import Estimate, LidarScan, State
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.comparisons import mean_difference
from lunarsim.evaluation.map_quality import true_elevation_in_map_frame
from lunarsim.evaluation.statistics import Proportion
from lunarsim.frames import quat_angle
from lunarsim.simulation.recorder import MessageRecorder

WORLD = {
    "terrain": {"kind": "fractal", "size_m": 300.0, "posting_m": 1.0, "rms_slope_deg": 4.0},
    "rocks": {"cover": 0.08, "min_diameter_m": 0.4},
    "expected_rocks": {"cover": 0.08},
    "sensors": {
        "imu": {"kind": "imu"},
        "altimeter": {"kind": "radar-altimeter"},
        "velocimeter": {"kind": "velocimeter"},
        "stars": {"kind": "star-tracker"},
        "flash": {"kind": "flash-lidar"},
    },
    "navigation": {"kind": "inertial"},
}
# The first entry is the reference of the comparison.
WAYS: dict[str, dict[str, object]] = {
    "ideal": {"control": {"kind": "ideal"}},
    "phase-plane": {"control": {"kind": "phase-plane"}, "vehicle": {"kind": "jet-lander"}},
    "quaternion-feedback": {
        "control": {"kind": "quaternion-feedback"}, "vehicle": {"kind": "jet-lander"}
    },
}  # fmt: skip
METRICS = {
    "position_m": "position error at scans without mean, RMS (m)",
    "attitude_mrad": "attitude error at scans, RMS (mrad)",
    "rate_deg_s": "body rate at scans, RMS (deg/s)",
    "height_m": "map height error, RMS (m)",
    "mean_m": "map height error, mean (m)",
    "precision": "precision",
    "recall": "recall",
    "miss_m": "touchdown distance from the site (m)",
    "tilt_deg": "tilt at touchdown (deg)",
    "thruster_kg": "thruster propellant (kg)",
    "engine_kg": "total propellant (kg)",
}


@dataclass(frozen=True)
class ThrusterMapTask:
    """Settings of one simulated flight of the thruster and map study.

    `way` is the kind of attitude control in `WAYS`; `flight` and `seed` (root seed) determine the
    random numbers.
    """

    way: str
    flight: int
    seed: int


@dataclass(frozen=True)
class ThrusterMapFlight:
    """Results of one simulated flight of the thruster and map study.

    `way` is the kind of attitude control, `failed` the failed landing criteria and `figures` the
    values of `METRICS` by name, NaN where there is no data.
    """

    way: str
    flight: int
    safe: bool
    failed: str
    figures: dict[str, float]


def fly(task: ThrusterMapTask) -> ThrusterMapFlight:
    """Simulate one flight; compute errors at the LiDAR scans, map quality and landing."""
    scenario = Scenario.from_dict({**WORLD, **WAYS[task.way]})
    tap = MessageRecorder()
    simulation = Simulation(scenario, flight_seed(task.seed, task.flight), "safest", tap=tap)
    seen: list[tuple[State, Estimate]] = []
    while not simulation.done:
        now = simulation.state, simulation.estimate
        simulation.step()
        if any(isinstance(item, LidarScan) for _, item in tap.exchanges.pop()[0].items):
            seen.append(now)
    flight = simulation.flight()
    place = np.array([e.position - s.position for s, e in seen])
    figures = {
        "position_m": _rms(np.linalg.norm(place - place.mean(axis=0), axis=1)),
        "attitude_mrad": 1e3
        * _rms(np.array([quat_angle(e.attitude, s.attitude) for s, e in seen])),
        "rate_deg_s": float(np.rad2deg(_rms(np.array([np.linalg.norm(s.rate) for s, _ in seen])))),
    } | _map_metrics(simulation, flight)
    touchdown, last = flight.outcome.touchdown, flight.events[-1]
    if touchdown is not None:
        site = flight.sites[-1] - flight.map_error
        figures["miss_m"] = float(np.linalg.norm((touchdown.position - site)[:2]))
        figures["tilt_deg"] = float(np.rad2deg(touchdown.tilt))
    figures["thruster_kg"] = float(last.get("thruster_propellant_kg", 0.0))
    figures["engine_kg"] = flight.propellant_used
    metrics = {name: figures.get(name, float("nan")) for name in METRICS}
    outcome = flight.outcome
    return ThrusterMapFlight(
        task.way, task.flight, outcome.safe, ", ".join(outcome.failure_causes), metrics
    )


def _rms(values: np.ndarray) -> float:
    """Return the root mean square of the values."""
    return float(np.sqrt(np.mean(values**2)))


def _map_metrics(simulation: Simulation, flight: Flight) -> dict[str, float]:
    """Return height errors (m), precision and recall of the last hazard map.

    The result is empty without a map of elevations.
    """
    found, error = flight.hazard_map, flight.map_error
    if found is None or found.elevation is None:
        return {}
    true_height = true_elevation_in_map_frame(simulation.world.terrain, found.grid, error)
    known = found.observed & np.isfinite(found.elevation) & np.isfinite(true_height)
    off = (found.elevation - true_height)[known].astype(np.float64)
    quality = map_quality(found, simulation.truth, error)
    return {
        "height_m": _rms(off), "mean_m": float(off.mean()), "precision": quality.precision,
        "recall": quality.recall,
    }  # fmt: skip


def report(console: Console, flights: list[ThrusterMapFlight], seed: int) -> None:
    """Print mean metrics by kind of attitude control, and paired differences.

    The differences are relative to the ideal control and have 95 % bootstrap intervals; `seed` is
    that of the bootstrap.
    """
    ways = list(dict.fromkeys(one.way for one in flights))
    of = {way: [one for one in flights if one.way == way] for way in ways}
    console.print("| | " + " | ".join(ways) + " | " + " | ".join(
        f"{way} minus {ways[0]} [95 % interval]" for way in ways[1:]) + " |")  # fmt: skip
    console.print("|" + " --- |" * (2 * len(ways)))
    landed = [str(Proportion(sum(o.safe for o in of[w]), len(of[w]))) for w in ways]
    console.print("| safe landings | " + " | ".join(landed) + " |" + " |" * (len(ways) - 1))
    rng = np.random.default_rng(seed)
    for name, words in METRICS.items():
        values = {w: np.array([o.figures[name] for o in of[w]]) for w in ways}
        cells = [f"{np.nanmean(values[w]):.3f}" for w in ways]
        for way in ways[1:]:
            d = mean_difference(values[ways[0]], values[way], (ways[0], way), rng)
            cells.append(f"{d.value:+.3f} [{d.low:+.3f}, {d.high:+.3f}]")
        console.print(f"| {words} | " + " | ".join(cells) + " |")
    why = {w: [o.failed for o in of[w] if o.failed] for w in ways}
    console.print(f"Failed criteria: {why}")


@click.command()
@click.option(
    "--flights",
    type=click.IntRange(min=2),
    default=20,
    show_default=True,
    help="Number of flights for each variant of the attitude control.",
)
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
def main(flights: int, seed: int, jobs: int, out: Path | None) -> None:
    """Fly descents with ideal and thruster control; compare the maps."""
    console = plain_console(220, soft_wrap=True)
    tasks = [ThrusterMapTask(way, n, seed) for way in WAYS for n in range(flights)]
    flown = collect_results(fly, tasks, jobs, console, "flights")
    report(console, flown, seed)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps([asdict(one) for one in flown], indent=1))


if __name__ == "__main__":
    main()
