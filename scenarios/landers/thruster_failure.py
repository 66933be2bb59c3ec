"""Compare flights with a failed thruster with and without fault detection.

The fault detection was tuned on thrusters 0, 1, 4 and 5 and seeds 1 to 3. `--held-out` flies with
failures of the other thrusters, and `--nominal` adds flights without failure to count false alarms.

python scenarios/landers/thruster_failure.py
python scenarios/landers/thruster_failure.py --held-out --first-seed 101 --seeds 2 --nominal 50
"""

from __future__ import annotations

import click
import numpy as np
from rich.console import Console

from lunarsim import Scenario, Simulation
from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion
from lunarsim.onboard.control.jets import JetLoop

BASE_SCENARIO = {
    "terrain": {"kind": "fractal", "size_m": 120.0, "posting_m": 1.0, "rms_slope_deg": 3.0},
    "rocks": {"cover": 0.02},
    "vehicle": {"kind": "jet-lander"},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}
FAILURE_TIME_S = 5.0  # time of the failure, s
TUNED_ON = (0, 1, 4, 5)


def fly(
    control: str, failed_thruster: int | None, seed: int, detects_faults: bool
) -> tuple[bool, float, float, int]:
    """Simulate one flight with one thruster stuck shut from 5 s, or none.

    `control` is the kind of attitude control and `failed_thruster` the number of the thruster
    (None: no failure); `detects_faults` enables fault detection. Returns whether the landing was
    safe, the tilt at touchdown (deg), the time of detection (s), and the number of working
    thrusters that were isolated.
    """
    faults = {
        "jets_stuck_shut": [] if failed_thruster is None else [failed_thruster],
        "jets_stuck_from_s": FAILURE_TIME_S,
    }
    scenario = Scenario.from_dict({**BASE_SCENARIO, "control": {"kind": control}, "faults": faults})
    sim = Simulation(scenario, seed, "no-divert")
    loop = sim.computer.attitude_loop
    assert isinstance(loop, JetLoop)
    if not detects_faults:
        loop.failure_detector.update = lambda *_: []  # type: ignore[method-assign]
    flight = sim.run()
    detections = [e for e in flight.events if e["name"] == "thruster-failed"]
    noticed = next((e["time"] for e in detections if e["thruster"] == failed_thruster), np.nan)
    touchdown = flight.outcome.touchdown
    tilt = np.nan if touchdown is None else float(np.rad2deg(touchdown.tilt))
    wrong = sum(e["thruster"] != failed_thruster for e in detections)
    return flight.outcome.safe, tilt, noticed, wrong


def fly_without_failure(console: Console, control: str, flights: int, first_seed: int) -> None:
    """Fly without thruster failure and print the rate of false alarms.

    `control` is the kind of attitude control, `flights` the number of flights and `first_seed`
    their first seed.
    """
    rows = [fly(control, None, first_seed + n, detects_faults=True) for n in range(flights)]
    alarms = Proportion(sum(row[3] > 0 for row in rows), flights)
    safe = sum(row[0] for row in rows)
    console.print(
        f"{control}, no failure: {safe} of {flights} safe, false alarms in {alarms.count}: {alarms}"
    )


@click.command()
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="Number of flights for each failed thruster, with one random seed each.",
)
@click.option("--first-seed", type=click.IntRange(min=0), default=1, show_default=True,
              help="Random seed of the first flight; each further flight adds 1.")  # fmt: skip
@click.option(
    "--held-out",
    is_flag=True,
    help="Use only failed thrusters for which the fault detection was not tuned.",
)
@click.option("--nominal", "flights", type=click.IntRange(min=0), default=0, show_default=True,
              help="Number of additional flights without failure for each kind of attitude "
              "control.")  # fmt: skip
def main(seeds: int, first_seed: int, held_out: bool, flights: int) -> None:
    """Fly with a failed thruster, with and without fault detection."""
    console = plain_console(160)
    shut_ones = [n for n in range(16) if (n in TUNED_ON) != held_out]
    for control in ("phase-plane", "quaternion-feedback"):
        for watch in (False, True):
            rows = np.array([
                fly(control, shut, seed, watch)
                for shut in shut_ones for seed in range(first_seed, first_seed + seeds)
            ])  # fmt: skip
            seen = rows[np.isfinite(rows[:, 2]), 2]
            when = (
                f", detected {len(seen)}, after {np.median(seen) - FAILURE_TIME_S:.1f} s (median; "
                f"maximum "
                f"{seen.max() - FAILURE_TIME_S:.1f}), false isolations {rows[:, 3].sum():.0f}"
            ) if len(seen) else ""  # fmt: skip
            how = "with" if watch else "without"
            safe, tilt = int(rows[:, 0].sum()), rows[:, 1]
            console.print(
                f"{control}, {how} fault detection: {safe} of {len(rows)} safe, "
                f"tilt {np.nanmedian(tilt):.1f} deg (median), {np.nanmax(tilt):.1f} deg "
                f"(maximum){when}"
            )
        if flights:
            fly_without_failure(console, control, flights, first_seed)


if __name__ == "__main__":
    main()
