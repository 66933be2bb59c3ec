"""Count random faults that ruin navigation without being declared.

Each flight draws a scenario, which sets the sensors, and one fault: a sensor fault of random kind,
size, start and end, initial errors larger than stated, or a wrong direction of the Sun. A tenth of
the flights has none. An error is too large if position, velocity or attitude exceeds five standard
deviations on an axis in the last control cycle. It is undeclared if navigation does not declare
itself lost in that cycle. Policies are not informed of the fault.

python scenarios/navigation/random_faults.py --flights 300 --jobs 2
"""

from __future__ import annotations

from typing import Any

import numpy as np
from navigation_errors import SCENARIOS, error_of
from rich.table import Table
from undeclared_failures import count_text

from lunarsim import Scenario, Simulation, flight_seed
from lunarsim.frames import rotation_about_up
from lunarsim.onboard.hazards.shadows import ShadowMapper
from lunarsim.studies import Case, Report, Study, run_script

SETS = ("instruments", "mare", "camera_and_lidar", "shadow_nominal", "morpheus", "all_sensors")
MAX_ERROR_SIGMA = 5.0  # standard deviations
# Kinds of faults of each sensor, and the smallest and largest error of each measured quantity, SI
# units: about one to a hundred standard deviations of the sensors' noise.
ADDITIVE = ("bias", "drift", "noise")
OTHER = ("dropout", "frozen", "latency")
SIZES = {
    "range": (1.0, 100.0), "speed": (0.03, 3.0), "attitude": (5e-4, 5e-2), "rate": (5e-5, 5e-3),
    "acceleration": (0.01, 1.0), "position": (1.0, 100.0), "velocity": (0.03, 3.0),
}  # fmt: skip
CHANNELS = {
    "imu": ("rate", "acceleration"), "radar-altimeter": ("range",), "velocimeter": ("speed",),
    "star-tracker": ("attitude",), "flash-lidar": ("range",), "camera": (),
    "navigation-fix": ("position", "velocity", "attitude"),
}  # fmt: skip
# Time in which a drift reaches its size, bounds of start and of duration, s.
DRIFT_S, START_S, DURATION_S = 20.0, (2.0, 30.0), (2.0, 15.0)
# Range of the initial errors over their stated standard deviations, and of the error of the Sun.
INITIAL_SCALE, SUN_DEG = (2.0, 6.0), (5.0, 90.0)
SUN, INITIAL, NONE = "wrong Sun", "initial errors", "none"


def log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Sample a value whose logarithm is uniform between two bounds."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def drawn_fault(scenario: Scenario, rng: np.random.Generator) -> tuple[str, dict[str, Any], float]:
    """Draw the fault of a flight: its name, changes of the scenario, and error of the Sun, rad."""
    has_camera = any(s.kind == "camera" for s in scenario.sensors.values())
    draw = rng.random()
    if draw < 0.1:
        return NONE, {}, 0.0
    if draw < 0.25:
        return INITIAL, {"truth": {"initial_error_scale": log_uniform(rng, INITIAL_SCALE)}}, 0.0
    if draw < 0.35 and has_camera:
        return SUN, {}, float(np.deg2rad(log_uniform(rng, SUN_DEG) * rng.choice((-1.0, 1.0))))
    name = str(rng.choice(sorted(scenario.sensors)))
    kind = scenario.sensors[name].kind
    channels = CHANNELS[kind]
    faults = [f"{fault} of {channel}" for channel in channels for fault in ADDITIVE]
    fault = str(rng.choice([*faults, *(OTHER if kind != "imu" else ())]))
    start = float(rng.uniform(*START_S))
    table: dict[str, Any] = {"kind": fault.split(maxsplit=1)[0], "sensor": name, "start_s": start}
    if rng.random() < 0.5:
        table["end_s"] = start + float(rng.uniform(*DURATION_S))
    if " of " in fault:
        channel = fault.rsplit(maxsplit=1)[-1]
        size = log_uniform(rng, SIZES[channel])
        table["channel"] = channel
        if channel in ("attitude", "rate", "acceleration", "position", "velocity"):
            direction = rng.standard_normal(3)
            table["direction"] = (direction / np.linalg.norm(direction)).tolist()
        elif table["kind"] != "noise":
            size *= float(rng.choice((-1.0, 1.0)))
        rate = size / DRIFT_S
        key = {"bias": ("size", size), "drift": ("rate", rate), "noise": ("sigma", size)}
        table |= dict([key[table["kind"]]])
    elif fault == "latency":
        table["delay_s"] = log_uniform(rng, (0.1, 3.0))
    return f"{kind}: {fault}", {"sensor_faults": {"drawn": table}}, 0.0


def fly(case: Case) -> dict[str, Any]:
    """Simulate one flight with a random fault.

    The row has the scenario (`set`), the fault, the largest errors of position, velocity and
    attitude over their standard deviations in the last control cycle (`sigmas`), whether one
    exceeds five (`far`), whether navigation is then lost (`lost`) and ever was (`ever_lost`),
    whether the covariance was inflated, and whether the landing was safe.
    """
    rng = np.random.default_rng([case.seed, case.number])
    name = SETS[case.number % len(SETS)]
    scenario = Scenario.load(SCENARIOS / f"{name}.toml")
    fault, changes, sun = drawn_fault(scenario, rng)
    simulation = Simulation(
        scenario.changed(**changes), flight_seed(case.seed, case.number), "safest"
    )
    for mapper in simulation.computer.mappers.values():
        if isinstance(mapper, ShadowMapper):
            mapper.sun = rotation_about_up(sun) @ mapper.sun
    sigmas, lost = [0.0, 0.0, 0.0], False
    while not simulation.done:
        # Only in flight: no measurements are taken at rest.
        errors = error_of(simulation) / np.sqrt(np.diag(simulation.estimate.covariance))
        sigmas = [float(v) for v in np.abs(errors).reshape(3, 3).max(axis=1)]
        lost = simulation.computer.estimate.lost
        simulation.step()
    names = [event for _, event, _ in simulation.computer.telemetry]
    return {
        "set": name, "fault": fault, "changes": changes, "sigmas": sigmas,
        "far": max(sigmas) > MAX_ERROR_SIGMA, "lost": lost, "ever_lost": "lost" in names,
        "inflated": names.count("covariance-inflated"), "safe": simulation.outcome.safe,
    }  # fmt: skip


def print_undeclared(report: Report) -> None:
    """Print large and undeclared errors by scenario and by fault, and the undeclared flights."""
    rows = report.rows
    right = [row for row in rows if row["fault"] == NONE]
    faulty = [row for row in rows if row["fault"] != NONE]
    faults = sorted({row["fault"] for row in rows})
    for title, groups in (
        ("Flights with a random fault", {n: [r for r in faulty if r["set"] == n] for n in SETS}),
        ("By fault", {n: [r for r in rows if r["fault"] == n] for n in faults}),
        ("In total", {"with a fault": faulty, "without": right}),
    ):
        table = Table(title=title)
        for heading in (
            "", "flights", "over 5 sigma", "of these,\nnot declared", "undeclared [95 %]",
            "declared lost", "safe landings",
        ):  # fmt: skip
            table.add_column(heading, justify="right" if heading else "left")
        for name, group in groups.items():
            far = [row for row in group if row["far"]]
            undeclared = sum(not row["lost"] for row in far)
            table.add_row(
                name, str(len(group)), str(len(far)), str(undeclared),
                count_text(undeclared, len(group)), str(sum(row["lost"] for row in group)),
                str(sum(row["safe"] for row in group)),
            )  # fmt: skip
        report.print(table)
    for row in faulty:
        if row["far"] and not row["lost"]:
            sigmas = ", ".join(f"{s:.1f}" for s in row["sigmas"])
            fault = row["changes"].get("sensor_faults", {}).get("drawn", row["changes"])
            values = ", ".join(f"{k} {v:.3g}" for k, v in fault.items() if isinstance(v, float))
            report.print(f"{row['set']}, {row['fault']} ({values}): {sigmas} sigma")


study = Study(fly, repeats="flights", count=30, seed=6401, report=print_undeclared)

if __name__ == "__main__":
    run_script(study)
