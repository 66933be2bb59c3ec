"""The Apollo 11 descent from ignition to the ground, flown by guidance, beside its record.

Three runs over a sphere that turns: P63, P64 and the automatic P65; the same with P66 and the pilot
model from 500 ft on; and a pilot who flies on past a crater first, as Armstrong did. Targets are
those that Apollo 11's computer was loaded with (scenarios/data/lm_targets_apollo11.csv), and
ignition is where that load's ignition algorithm puts it, 260 nautical miles uprange. Nothing is
fitted to the record: it is read after the flights. A last column flies the sample values that were
listed for Apollo 10 half a year before (lm_targets.csv).

python scenarios/apollo11_descent.py --out out/apollo11 --json apollo11.json
"""

from __future__ import annotations

import json
import resource
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from landers import apollo11
from landers.apollo11_figure import drawn
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.onboard.computer import APPROACH, BRAKING
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.flight import Flight

LOW_GATE = 500.0 * apollo11.FEET
# Low gate is 560 m short of the site: with a lean of 15 deg, 0.43 m/s^2, a speed of distance over
# 40 s is the fastest that can be taken out on the way. Above 5 m/s he keeps his height.
PILOT = {"speed_time_s": 40.0, "hold_speed_m_s": 5.0}
# The mission report has the lander about 400 m west of the crater at which P64 aimed. On the way
# the crew called out rates of descent of up to 6 1/2 ft/s below 330 ft. From 100 ft on he has room
# to stop: at the model's own 10 m he is still too fast.
FLOWN_ON = {
    "beyond_m": 400.0,
    "fastest_m_s": 6.5 * apollo11.FEET,
    "still_height_m": 100.0 * apollo11.FEET,
}
HERE = Path(__file__).resolve().parent
MEASURED: dict[str, Any] = {
    "terrain": {
        "kind": "dtm", "path": str(HERE / "data/moon_apollo15_nac_dtm_2m.tif"),
        "dtm_posting_m": 2.0, "height_step_m": 0.192, "posting_m": 0.5, "detail": True,
    },
    "surroundings": {
        "path": str(HERE / "data/moon_shackleton_ridge_lola_40m.tif"), "dtm_posting_m": 40.0,
        "sizes_m": [10_240.0, 1_024_000.0],
    },
}  # fmt: skip


@dataclass
class Run:
    """A flight and what came of it; `told` goes into the table and the file."""

    name: str
    flight: Flight
    sim: Simulation
    told: dict[str, Any]


def scenario_of(isp: float, ground: str, load: str = apollo11.FLOWN) -> Scenario:
    """Return the descent with a load's targets from its own ignition, over a ground."""
    base = Scenario.load(HERE / "landers/apollo11.toml")
    base = base.changed(vehicle={"specific_impulse_s": isp})
    if ground == "measured":
        base = base.changed(**MEASURED)
    return apollo11.started(apollo11.loaded(base, load), load)


def piloted(scenario: Scenario, **pilot: float) -> Scenario:
    """Return the descent with P66 and the pilot from low gate on; `pilot` changes his ways."""
    taken = scenario.changed(approach={"takeover_altitude_m": LOW_GATE})
    return taken.changed(descent={"kind": "rate-of-descent", **PILOT, **pilot})


def fly(name: str, scenario: Scenario, seed: int) -> Run:
    """Fly one descent and set it beside the record."""
    begun = time.process_time()
    sim = Simulation(scenario, seed, "no-divert")
    flight = sim.run()
    seconds = time.process_time() - begun
    moon, lander = sim.world.moon, sim.lander
    assert moon is not None
    told = apollo11.told_of(flight, moon, lander.com_height, lander.engine.gap_to)
    told |= {"run": name, "times_real_time": flight.duration / seconds}
    told |= _compared(apollo11.flown(flight, moon, lander.com_height)) | _seen(sim, flight)
    return Run(name, flight, sim, told)


def _compared(track: apollo11.Track) -> dict[str, float]:
    """Return root mean squares beside the record by its phases."""
    told, out = apollo11.record(), {}
    ends = (apollo11.LOCK_ON, apollo11.P64, apollo11.P66, apollo11.LANDING)
    for name, since, until in zip(("p63", "p64", "p66"), ends, ends[1:], strict=False):
        b = apollo11.beside(track, told, since, until)
        out |= {f"{name}_altitude_m": b.altitude, f"{name}_pitch_deg": float(np.rad2deg(b.pitch))}
    return out


def _seen(sim: Simulation, flight: Flight) -> dict[str, float]:
    """Return the ground under the altimeter while braking, and the look angle to the site."""
    phase, about = flight.trajectory["phase"], sim.world.surroundings
    braking = flight.positions[phase == BRAKING][::10]
    assert about is not None
    ground = about.elevation(about.way(braking))
    out = {
        "ground_rms_m": float(np.sqrt(np.mean(ground**2))),
        "ground_least_m": float(ground.min()),
        "ground_most_m": float(ground.max()),
    }
    look = look_angles(flight)[phase == APPROACH]
    window = Scenario.load(HERE / "landers/apollo11.toml").window.make()
    inside = (look >= window.highest) & (look <= window.lowest)
    return out | {"site_in_window": float(inside.mean()) if len(look) else float("nan")}


def look_angles(flight: Flight) -> np.ndarray:
    """Return the angle of the site below the forward direction, body axes (n,), rad."""
    from lunarsim.frames import quat_conjugate, quat_rotate

    q = np.column_stack([flight.trajectory[f"attitude_{a}"] for a in "xyzw"])
    body = quat_rotate(quat_conjugate(q), flight.target - flight.positions)
    return np.asarray(np.arctan2(-body[:, 2], body[:, 1]))


def _verdict(told: dict[str, Any]) -> str:
    return "landed safe" if told["safe"] else ", ".join(told["failed"])


def table_of(runs: list[Run]) -> Table:
    """Return the table of all runs, a column each."""
    table = Table(title="Apollo 11's descent, flown by guidance")
    table.add_column("")
    for run in runs:
        table.add_column(run.name, justify="right")
    whole = apollo11.REPORTED
    rows: list[tuple[str, Any]] = [
        ("verdict", _verdict),
        ("throttle recovery s / m up", lambda t: _pair(t, "recovery")),
        ("high gate (P64) s / m up", lambda t: _pair(t, "approach")),
        ("last phase s / m up", lambda t: _pair(t, "last")),
        ("touchdown s / m from the site", lambda t: f"{t['duration_s']:.0f} / {t['miss_m']:.0f}"),
        ("burnt from ignition to the end kg", lambda t: f"{t['propellant_kg']:.0f}"),
        ("of it in P63 / P64 / last phase", _by_phase),
        (f"with insertion, against {whole:.0f} kg", _against),
        (f"against the chart's {apollo11.CHART:.0f} kg", _against_chart),
        (f"burnt by lock-on, with insertion, against {apollo11.CHART_LOCK_ON:.0f} kg",
         lambda t: f"{t['burnt_at_lock_on_kg'] + apollo11.INSERTION:.0f}"),
        (f"burnt since, against {apollo11.CHART - apollo11.CHART_LOCK_ON:.0f} kg",
         lambda t: f"{t['propellant_kg'] - t['burnt_at_lock_on_kg']:.0f}"),
        ("thrusters kg", lambda t: f"{t['thruster_propellant_kg']:.0f}"),
        ("altitude off the record, rms m: P63 / P64", lambda t: _rms(t, "altitude_m")),
        ("pitch off the record, rms deg: P63 / P64", lambda t: _rms(t, "pitch_deg")),
        ("P66's time, which a man flew: m / deg",
         lambda t: f"{t['p66_altitude_m']:.0f} / {t['p66_pitch_deg']:.1f}"),
        ("ground under the altimeter while braking, rms / least / most m",
         lambda t: f"{t['ground_rms_m']:.0f} / {t['ground_least_m']:.0f} / "
                   f"{t['ground_most_m']:.0f}"),
        ("share of P64 with the site in the window", lambda t: f"{t['site_in_window']:.2f}"),
        ("times real time", lambda t: f"{t['times_real_time']:.0f}"),
    ]  # fmt: skip
    for label, of in rows:
        table.add_row(label, *(of(run.told) for run in runs))
    return table


def _pair(told: dict[str, Any], name: str) -> str:
    return f"{told[f'{name}_s']:.0f} / {told[f'{name}_altitude_m']:.0f}"


def _rms(told: dict[str, Any], unit: str) -> str:
    digits = 0 if unit.endswith("_m") else 1
    return " / ".join(f"{told[f'{name}_{unit}']:.{digits}f}" for name in ("p63", "p64"))


def _against(told: dict[str, Any], reported: float = apollo11.REPORTED) -> str:
    whole = told["propellant_kg"] + apollo11.INSERTION
    return f"{whole:.0f}, {100.0 * (whole / reported - 1.0):+.1f} %"


def _against_chart(told: dict[str, Any]) -> str:
    return _against(told, apollo11.CHART)


def _by_phase(told: dict[str, Any]) -> str:
    return " / ".join(f"{told[f'{name}_kg']:.0f}" for name in ("braking", "approach", "last"))


def _hover(run: Run) -> str:
    """Return what the record's longer time after P64 comes to at the thrust of a hover."""
    told, mass = run.told, run.flight.trajectory["mass"]
    longer = apollo11.LANDING - told["duration_s"]
    flow = mass[-1] * run.sim.world.gravity / run.sim.lander.exhaust_velocity
    whole = told["propellant_kg"] + apollo11.INSERTION + longer * flow
    return (
        f"{run.name}: the record is {longer:.0f} s longer; hovering for these takes "
        f"{flow:.2f} kg/s, {longer * flow:.0f} kg, in all {whole:.0f} kg, "
        f"{100.0 * (whole / apollo11.REPORTED - 1.0):+.1f} % of the report's."
    )


@click.command()
@click.option(
    "--isp",
    type=click.FloatRange(301.0, 305.0),
    default=303.0,
    show_default=True,
    help="Specific impulse, s: 301 is the computer's, 305 the engine's best.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
@click.option(
    "--ground",
    type=click.Choice(["drawn", "measured"]),
    default="drawn",
    show_default=True,
    help="Measured: the terrain models at hand, of other places.",
)
@click.option(
    "--sample/--no-sample",
    default=True,
    show_default=True,
    help="Fly the sample values listed for Apollo 10 besides.",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Figure and flights.")
@click.option("--json", "file", type=click.Path(path_type=Path), help="Every figure of every run.")
def main(
    isp: float, seed: int, ground: str, sample: bool, out: Path | None, file: Path | None
) -> None:
    """Fly the descent automatically and by two pilots, and set it beside the record."""
    console = plain_console(130)
    base = scenario_of(isp, ground)
    console.print(f"Ignition {apollo11.uprange(base) / 1852.0:.1f} nautical miles uprange.")
    runs = [
        fly("P65", base, seed),
        fly("P66", piloted(base), seed),
        fly("P66, flown on", piloted(base, **FLOWN_ON), seed),
    ]
    if sample:
        runs.append(fly("P65, sample", scenario_of(isp, ground, apollo11.SAMPLE), seed))
    console.print(table_of(runs))
    for run in runs[:3]:
        console.print(_hover(run))
    about = runs[0].sim.world.surroundings
    assert about is not None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    console.print(
        f"Ground: {about.nbytes / 2**20:.0f} MiB in all its levels; process at most {peak:.0f} MiB."
    )
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for run in runs:
            run.flight.save(out / run.name.replace(",", "").replace(" ", "-"))
        console.print(f"Figure: {drawn(runs[:3], look_angles, out / 'descent.png')}")
    if file is not None:
        file.write_text(json.dumps([run.told for run in runs], indent=1))


if __name__ == "__main__":
    main()
