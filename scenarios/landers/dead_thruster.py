"""What it is worth to notice a thruster that does not push: flights with and without the watch.

python scenarios/landers/dead_thruster.py
"""

from __future__ import annotations

import click
import numpy as np
from rich.console import Console

from lunarsim.onboard.control.jets import JetLoop
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

SMALL = {
    "terrain": {"kind": "fractal", "size_m": 120.0, "posting_m": 1.0, "rms_slope_deg": 3.0},
    "rocks": {"cover": 0.02},
    "vehicle": {"kind": "jet-lander"},
    "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix", "position_bias_m": 0.5}},
    "mappers": {},
    "tasking": {},
}
FROM = 5.0  # when the thruster dies, s


def fly(control: str, shut: int, seed: int, watch: bool) -> tuple[bool, float, float]:
    """Return whether a flight landed safe, its tilt there, deg, and when it noticed, s."""
    faults = {"jets_shut": [shut], "jets_from_s": FROM}
    scenario = Scenario.from_dict({**SMALL, "control": {"kind": control}, "faults": faults})
    sim = Simulation(scenario, seed, "no-divert")
    loop = sim.computer.attitude_loop
    assert isinstance(loop, JetLoop)
    if not watch:
        loop.watch.see = lambda *_: []  # type: ignore[method-assign]
    flight = sim.run()
    told = [e for e in flight.events if e["name"] == "thruster-failed"]
    noticed = next((e["time"] for e in told if e["thruster"] == shut), np.nan)
    touchdown = flight.verdict.touchdown
    tilt = np.nan if touchdown is None else float(np.rad2deg(touchdown.tilt))
    return flight.verdict.safe, tilt, noticed


@click.command()
@click.option("--seeds", type=click.IntRange(min=1), default=3, show_default=True, help="Of each.")
def main(seeds: int) -> None:
    """Fly landers with a dead thruster with and without the watch, and print what becomes."""
    console = Console(width=120)
    for control in ("phase-plane", "quaternion-feedback"):
        for watch in (False, True):
            rows = np.array([
                fly(control, shut, seed, watch)
                for shut in (0, 1, 4, 5) for seed in range(1, seeds + 1)
            ])  # fmt: skip
            seen = rows[np.isfinite(rows[:, 2]), 2]
            when = f", noticed {len(seen)}, at {np.median(seen):.1f} s" if len(seen) else ""
            how = "with" if watch else "without"
            safe, tilt = int(rows[:, 0].sum()), rows[:, 1]
            console.print(
                f"{control}, {how} the watch: {safe} of {len(rows)} safe, "
                f"tilt {np.nanmedian(tilt):.1f} deg (median), {np.nanmax(tilt):.1f} (most){when}"
            )


if __name__ == "__main__":
    main()
