"""Compare attitude control with and without propellant slosh.

Four tanks around the center of the default lander with thrusters. The table reports the attitude
error, body rates, thruster firings and thruster propellant over the descent, and the touchdown.

python scenarios/landers/slosh.py --flights 10
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from rich.console import Console

from lunarsim import Scenario, Simulation
from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.frames import quat_angle
from lunarsim.simulation.recorder import MessageRecorder

BASE_SCENARIO = {
    "terrain": {"kind": "fractal", "size_m": 120.0, "posting_m": 1.0, "rms_slope_deg": 3.0},
    "rocks": {"cover": 0.02},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}
# Tanks of 100 kg each when full, 0.3 m deep, with the liquid at the height of the center of mass.
TANKS = [[0.5, 0.0, -0.15], [0.0, 0.5, -0.15], [-0.5, 0.0, -0.15], [0.0, -0.5, -0.15]]
# End of the initial turn; length of the final interval that is reported separately, s.
BEGIN, END = 5.0, 4.0
CONTROLS = ("phase-plane", "quaternion-feedback")
CASES: dict[str, dict[str, object]] = {
    "none": {},
    "baffled, 0.05": {"tanks_m": TANKS, "damping": 0.05},
    "smooth, 0.005": {"tanks_m": TANKS, "damping": 0.005},
    "undamped": {"tanks_m": TANKS, "damping": 0.0},
    "one wide tank, 0.005": {
        "tanks_m": [[0.0, 0.0, -0.15]], "radius_m": 0.6, "damping": 0.005
    },
}  # fmt: skip


@dataclass(frozen=True)
class SloshTask:
    """Settings of one simulated flight of the propellant slosh study.

    `control` is the kind of attitude control, `case` the name of the tanks in `CASES`.
    """

    control: str
    case: str
    seed: int


@dataclass(frozen=True)
class SloshFlight:
    """Results of one simulated flight of the propellant slosh study.

    `error_deg` and `rate_deg_s` are RMS attitude error and body rate after the initial turn;
    `end_error_deg` and `end_rate_deg_s` are those of the last 4 s. `thruster_kg` is the thruster
    propellant, `slosh_deg` the maximum slosh angle and `side_m_s` the lateral speed at touchdown.
    """

    control: str
    case: str
    seed: int
    safe: bool
    error_deg: float
    rate_deg_s: float
    end_error_deg: float
    end_rate_deg_s: float
    thruster_kg: float
    firings: int
    slosh_deg: float
    side_m_s: float


def fly(task: SloshTask) -> SloshFlight:
    """Simulate one flight; evaluate attitude and thrusters after the first 5 s."""
    vehicle = {"kind": "jet-lander", "slosh": CASES[task.case]}
    scenario = Scenario.from_dict(
        {**BASE_SCENARIO, "vehicle": vehicle, "control": {"kind": task.control}}
    )
    tap = MessageRecorder()
    flight = Simulation(scenario, task.seed, "no-divert", tap=tap).run()
    t = flight.trajectory
    n = min(len(t["time"]), len(tap.exchanges))
    rate = np.stack([t[f"rate_{axis}"] for axis in "xyz"], axis=1)[-n:]
    actual = np.stack([t[f"attitude_{axis}"] for axis in "xyzw"], axis=1)[-n:]
    wanted = np.array([command.attitude for _, command, _ in tap.exchanges])[-n:]
    time = np.asarray(t["time"])[-n:]
    error = np.rad2deg(quat_angle(actual, wanted))
    speed = np.rad2deg(np.linalg.norm(rate, axis=1))
    spans = (time > BEGIN, time > time[-1] - END)
    (all_error, all_rate), (end_error, end_rate) = (
        [float(np.sqrt(np.mean(x[span] ** 2))) for x in (error, speed)] for span in spans
    )
    last, touchdown = flight.events[-1], flight.outcome.touchdown
    return SloshFlight(
        task.control, task.case, task.seed, flight.outcome.safe, all_error, all_rate, end_error,
        end_rate, float(last["thruster_propellant_kg"]), int(np.sum(last["thruster_firings"])),
        float(np.max(last.get("slosh_most_deg", 0.0))),
        np.nan if touchdown is None else float(touchdown.horizontal_speed),
    )  # fmt: skip


def report(console: Console, flights: list[SloshFlight]) -> None:
    """Print medians over the flights for each kind of control and each set of tanks."""
    console.print(
        "| control | tanks | safe landings | attitude error, RMS (deg) | body rate, RMS (deg/s) | "
        "both, last 4 s | "
        "thruster propellant (kg) | firings | slosh angle, maximum (deg) | lateral speed (m/s) |"
    )
    console.print("|" + " --- |" * 10)
    for control in CONTROLS:
        for case in CASES:
            some = [one for one in flights if (one.control, one.case) == (control, case)]
            if not some:
                continue

            def middle(name: str, of: list[SloshFlight] = some) -> float:
                return float(np.nanmedian([getattr(one, name) for one in of]))

            most = max(one.slosh_deg for one in some)
            console.print(
                f"| `{control}` | {case} | {sum(o.safe for o in some)} of {len(some)} | "
                f"{middle('error_deg'):.2f} | {middle('rate_deg_s'):.2f} | "
                f"{middle('end_error_deg'):.2f}, {middle('end_rate_deg_s'):.2f} | "
                f"{middle('thruster_kg'):.2f} | {middle('firings'):.0f} | {most:.1f} | "
                f"{middle('side_m_s'):.2f} |"
            )


@click.command()
@click.option(
    "--flights",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    help="Number of flights for each set of tanks and kind of attitude control.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Random seed of the first flight; each further flight adds 1.",
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
    """Fly the same descents with and without propellant slosh."""
    console = plain_console(180, soft_wrap=True)
    tasks = [
        SloshTask(control, case, seed + n)
        for control in CONTROLS for case in CASES for n in range(flights)
    ]  # fmt: skip
    flown = collect_results(fly, tasks, jobs, console, "flights")
    report(console, flown)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps([asdict(one) for one in flown], indent=1))


if __name__ == "__main__":
    main()
