"""Simulate the Apollo 11 powered descent and compare it with the flight record.

Three runs over a rotating spherical Moon: (1) P63, P64 and the automatic P65; (2) P66 with the
pilot model from 500 ft; (3) the same with a pilot who first flies past a crater, as Armstrong did.
The targets are those loaded into the Apollo 11 computer
(scenarios/data/lm_targets_apollo11.csv). The ignition algorithm with this load places ignition
260 nautical miles uprange. No parameter is fitted to the record, which is read after the flights.
A fourth run uses the sample values listed for Apollo 10 half a year earlier (lm_targets.csv).

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
from landers.apollo11_figure import draw_descent
from rich.table import Table

from lunarsim import Flight, Scenario, Simulation
from lunarsim.console import plain_console
from lunarsim.onboard.phases import Phase

LOW_GATE = 500.0 * apollo11.FEET
# Low gate is 560 m short of the site. With a pitch limit of 15 deg (0.43 m/s^2), distance / 40 s is
# the highest speed that can be removed on the way. Above 5 m/s the pilot holds the altitude.
PILOT = {"velocity_time_s": 40.0, "hold_height_speed_m_s": 5.0}
# The mission report puts the landing point about 400 m west of the crater at which P64 aimed. The
# crew called out descent rates up to 6 1/2 ft/s below 330 ft. The pilot stops from 100 ft: at the
# default height of the pilot model, 10 m, the vehicle is still too fast.
FLY_PAST_CRATER = {
    "overshoot_m": 400.0,
    "max_rate_m_s": 6.5 * apollo11.FEET,
    "zero_speed_height_m": 100.0 * apollo11.FEET,
}
HERE = Path(__file__).resolve().parent
MEASURED: dict[str, Any] = {
    "terrain": {
        "kind": "dtm", "path": str(HERE / "data/moon_apollo15_nac_dtm_2m.tif"),
        "dtm_posting_m": 2.0, "height_step_m": 0.192, "posting_m": 0.5, "detail": True,
    },
    "far_terrain": {
        "path": str(HERE / "data/moon_shackleton_ridge_lola_40m.tif"), "dtm_posting_m": 40.0,
        "sizes_m": [10_240.0, 1_024_000.0],
    },
}  # fmt: skip


@dataclass
class ApolloDescentRun:
    """One simulated Apollo 11 descent with its name.

    `sim` is the simulation, `flight` the recorded flight and `results` the values of the table and
    the output file.
    """

    name: str
    flight: Flight
    sim: Simulation
    results: dict[str, Any]


def scenario_of(isp: float, terrain: str, targets_file: str = apollo11.FLOWN) -> Scenario:
    """Return the Apollo 11 descent from ignition with the guidance targets of a file.

    `isp` is the specific impulse (s), `terrain` "random" or "measured", and `targets_file` a file
    name in `scenarios/data`.
    """
    base = Scenario.load(HERE / "landers/apollo11.toml")
    base = base.changed(vehicle={"specific_impulse_s": isp})
    if terrain == "measured":
        base = base.changed(**MEASURED)
    return apollo11.with_ignition_start(apollo11.with_targets(base, targets_file), targets_file)


def with_pilot(scenario: Scenario, **pilot: float) -> Scenario:
    """Return the descent with manual rate-of-descent control (P66) below 500 ft.

    `pilot` holds changed parameters of the pilot model.
    """
    taken = scenario.changed(approach={"takeover_altitude_m": LOW_GATE})
    return taken.changed(terminal_descent={"kind": "rate-of-descent", **PILOT, **pilot})


def fly(name: str, scenario: Scenario, seed: int) -> ApolloDescentRun:
    """Simulate one descent without diverts; compare it with the Apollo 11 record.

    `name` is the name of the run in the table. The results also have the terrain heights, the
    visibility of the site and the computing speed.
    """
    start_time = time.process_time()
    sim = Simulation(scenario, seed, "no-divert")
    flight = sim.run()
    seconds = time.process_time() - start_time
    moon, lander = sim.world.moon, sim.lander
    assert moon is not None
    results = apollo11.flight_summary(flight, moon, lander.com_height, lander.engine.gap_upper)
    results |= {"run": name, "times_real_time": flight.duration / seconds}
    results |= _record_differences(
        apollo11.track_of(flight, moon, lander.com_height)
    ) | _terrain_and_visibility(sim, flight)
    return ApolloDescentRun(name, flight, sim, results)


def _record_differences(track: apollo11.DescentTrack) -> dict[str, float]:
    """Return RMS differences of altitude (m) and pitch (deg) from the record by phase."""
    recorded, out = apollo11.read_flight_record(), {}
    ends = (apollo11.LOCK_ON, apollo11.P64, apollo11.P66, apollo11.LANDING)
    for name, since, until in zip(("p63", "p64", "p66"), ends, ends[1:], strict=False):
        b = apollo11.record_difference(track, recorded, since, until)
        out |= {f"{name}_altitude_m": b.altitude, f"{name}_pitch_deg": float(np.rad2deg(b.pitch))}
    return out


def _terrain_and_visibility(sim: Simulation, flight: Flight) -> dict[str, float]:
    """Return terrain heights under the braking path (m), and visibility of the site.

    The visibility is the fraction of the approach phase with the site in the window.
    """
    phase, about = flight.trajectory["phase"], sim.world.far_terrain
    braking = flight.positions[phase == Phase.BRAKING][::10]
    assert about is not None
    terrain_height = about.elevation(about.surface_arc(braking))
    out = {
        "ground_rms_m": float(np.sqrt(np.mean(terrain_height**2))),
        "ground_least_m": float(terrain_height.min()),
        "ground_most_m": float(terrain_height.max()),
    }
    look = look_angles(flight)[phase == Phase.APPROACH]
    window = Scenario.load(HERE / "landers/apollo11.toml").window.make()
    inside = (look >= window.upper_edge) & (look <= window.lower_edge)
    return out | {"site_in_window": float(inside.mean()) if len(look) else float("nan")}


def look_angles(flight: Flight) -> np.ndarray:
    """Return the angle of the site below the forward body axis at all times (n,), rad."""
    from lunarsim.api import quat_rotate
    from lunarsim.frames import quat_conjugate

    q = np.column_stack([flight.trajectory[f"attitude_{a}"] for a in "xyzw"])
    body = quat_rotate(quat_conjugate(q), flight.target - flight.positions)
    return np.asarray(np.arctan2(-body[:, 2], body[:, 1]))


def _outcome_text(results: dict[str, Any]) -> str:
    """Return "safe landing" or the failed criteria."""
    return "safe landing" if results["safe"] else ", ".join(results["failure_causes"])


def table_of(runs: list[ApolloDescentRun]) -> Table:
    """Return the table of all descents: quantities by row, descents by column."""
    table = Table(title="Simulated Apollo 11 descent")
    table.add_column("")
    for run in runs:
        table.add_column(run.name, justify="right")
    total = apollo11.REPORTED
    rows: list[tuple[str, Any]] = [
        ("landing outcome", _outcome_text),
        ("throttle recovery: time (s) / altitude (m)", lambda t: _time_and_altitude(t, "recovery")),
        ("high gate (P64): time (s) / altitude (m)", lambda t: _time_and_altitude(t, "approach")),
        ("last phase: time (s) / altitude (m)", lambda t: _time_and_altitude(t, "last")),
        ("touchdown: time (s) / distance from the site (m)",
        lambda t: f"{t['duration_s']:.0f} / {t['miss_m']:.0f}"),
        ("propellant, ignition to touchdown (kg)", lambda t: f"{t['propellant_kg']:.0f}"),
        ("propellant in P63 / P64 / last phase (kg)", _by_phase),
        (f"propellant with insertion (kg), reported {total:.0f}", _relative_to_report),
        (f"propellant with insertion (kg), chart {apollo11.CHART:.0f}", _relative_to_chart),
        (f"propellant until lock-on (kg), chart {apollo11.CHART_LOCK_ON:.0f}",
         lambda t: f"{t['burnt_at_lock_on_kg'] + apollo11.INSERTION:.0f}"),
        (f"propellant after lock-on (kg), chart {apollo11.CHART - apollo11.CHART_LOCK_ON:.0f}",
         lambda t: f"{t['propellant_kg'] - t['burnt_at_lock_on_kg']:.0f}"),
        ("thruster propellant (kg)", lambda t: f"{t['thruster_propellant_kg']:.0f}"),
        ("altitude difference from the record, RMS (m): P63 / P64", lambda t: _rms_text(t,
        "altitude_m")),
        ("pitch difference from the record, RMS (deg): P63 / P64", lambda t: _rms_text(t,
        "pitch_deg")),
        ("the same during P66 of the record (m / deg)",
         lambda t: f"{t['p66_altitude_m']:.0f} / {t['p66_pitch_deg']:.1f}"),
        ("terrain height while braking, RMS / minimum / maximum (m)",
         lambda t: f"{t['ground_rms_m']:.0f} / {t['ground_least_m']:.0f} / "
                   f"{t['ground_most_m']:.0f}"),
        ("fraction of P64 with the site in the window", lambda t: f"{t['site_in_window']:.2f}"),
        ("simulation speed (times real time)", lambda t: f"{t['times_real_time']:.0f}"),
    ]  # fmt: skip
    for label, of in rows:
        table.add_row(label, *(of(run.results) for run in runs))
    return table


def _time_and_altitude(results: dict[str, Any], name: str) -> str:
    """Format time (s) and altitude (m) of an event: "recovery", "approach" or "last".

    These are throttle recovery, the start of the approach, and the start of the last phase.
    """
    return f"{results[f'{name}_s']:.0f} / {results[f'{name}_altitude_m']:.0f}"


def _rms_text(results: dict[str, Any], unit: str) -> str:
    """Format the RMS differences from the record in P63 (braking) and P64 (approach).

    `unit` is "altitude_m" or "pitch_deg".
    """
    digits = 0 if unit.endswith("_m") else 1
    return " / ".join(f"{results[f'{name}_{unit}']:.{digits}f}" for name in ("p63", "p64"))


def _relative_to_report(results: dict[str, Any], reported: float = apollo11.REPORTED) -> str:
    """Format total propellant (kg) and its difference from the mission report (%).

    `reported` is the propellant in the report, kg.
    """
    total = results["propellant_kg"] + apollo11.INSERTION
    return f"{total:.0f}, {100.0 * (total / reported - 1.0):+.1f} %"


def _relative_to_chart(results: dict[str, Any]) -> str:
    """Format total propellant (kg) and its difference from the Apollo 11 chart (%)."""
    return _relative_to_report(results, apollo11.CHART)


def _by_phase(results: dict[str, Any]) -> str:
    """Format the propellant used in braking, approach and last phase (kg)."""
    return " / ".join(f"{results[f'{name}_kg']:.0f}" for name in ("braking", "approach", "last"))


def _hover(run: ApolloDescentRun) -> str:
    """Format the propellant (kg) for hovering until the landing time of Apollo 11."""
    results, mass = run.results, run.flight.trajectory["mass"]
    longer = apollo11.LANDING - results["duration_s"]
    flow = mass[-1] * run.sim.world.gravity / run.sim.lander.exhaust_velocity
    total = results["propellant_kg"] + apollo11.INSERTION + longer * flow
    return (
        f"{run.name}: the record is {longer:.0f} s longer. Hovering for that time uses "
        f"{flow:.2f} kg/s, {longer * flow:.0f} kg; the total is {total:.0f} kg, "
        f"{100.0 * (total / apollo11.REPORTED - 1.0):+.1f} % relative to the report."
    )


@click.command()
@click.option(
    "--isp",
    type=click.FloatRange(301.0, 305.0),
    default=303.0,
    show_default=True,
    help="Specific impulse of the engine (s), from 301 (value in the Apollo computer) to 305 "
    "(maximum of the engine).",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option(
    "--terrain",
    type=click.Choice(["random", "measured"]),
    default="random",
    show_default=True,
    help="Terrain under the descent: random, or measured at other places of the Moon.",
)
@click.option(
    "--sample/--no-sample",
    default=True,
    show_default=True,
    help="Whether to fly also with the sample guidance targets that are listed for Apollo 10.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the figure and the flight records. Default: none.",
)
@click.option(
    "--json",
    "json_file",
    type=click.Path(path_type=Path),
    help="JSON file for the results of all runs. Default: none.",
)
def main(
    isp: float, seed: int, terrain: str, sample: bool, out: Path | None, json_file: Path | None
) -> None:
    """Fly the descent automatically and manually; compare it with the flight record."""
    console = plain_console(130)
    base = scenario_of(isp, terrain)
    console.print(f"Ignition {apollo11.uprange(base) / 1852.0:.1f} nautical miles uprange.")
    runs = [
        fly("P65", base, seed),
        fly("P66", with_pilot(base), seed),
        fly("P66, flown on", with_pilot(base, **FLY_PAST_CRATER), seed),
    ]
    if sample:
        runs.append(fly("P65, sample", scenario_of(isp, terrain, apollo11.SAMPLE), seed))
    console.print(table_of(runs))
    for run in runs[:3]:
        console.print(_hover(run))
    about = runs[0].sim.world.far_terrain
    assert about is not None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    console.print(
        f"Far terrain: {about.nbytes / 2**20:.0f} MiB in all levels; peak memory {peak:.0f} MiB."
    )
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for run in runs:
            run.flight.save(out / run.name.replace(",", "").replace(" ", "-"))
        console.print(f"Figure: {draw_descent(runs[:3], look_angles, out / 'descent.png')}")
    if json_file is not None:
        json_file.write_text(json.dumps([run.results for run in runs], indent=1))


if __name__ == "__main__":
    main()
