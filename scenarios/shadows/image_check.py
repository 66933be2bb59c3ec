"""Measure how often the image check rejects good images and accepts faulty ones.

Fields of rocks by Golombek's law on relief are seen from random positions, with one image each. All
faults below are applied to every image. Each image is evaluated independently; good ones are also
evaluated as in a flight in which the Sun direction has already been confirmed.

python scenarios/shadows/image_check.py --fields 2 --seed 7 --out out/image_check
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import product
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from lunarsim import Grid, Heightfield, Terrain
from lunarsim.api import State, gimbal_mount
from lunarsim.frames import direction_from_angles
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.image_quality import ImageQualityCheck
from lunarsim.onboard.perception.shadow_direction import measure_shadow_angle
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.camera import Camera
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.world import World
from lunarsim.world.light import Light
from lunarsim.world.terrain import fractal_relief, place_rocks

COVERS = (0.02, 0.05, 0.08, 0.15)
SLOPES = (0.0, 2.0, 4.0)
SUNS = (5.0, 10.0, 20.0, 45.0, 60.0)
ALTITUDES = (10.0, 30.0, 100.0)
SHAPES = ("cube", "mixed", "hemisphere", "irregular", "ellipsoid")
FIELD = 130.0
# Good images after one that confirmed the Sun direction, as in most of a flight.
SEEN = "none, the Sun seen before"
Counts = NDArray[np.uint8]


def field_index(case: Case) -> int:
    """Return the index of a field among the fields of all covers and slopes.

    It sets the random numbers of the field.
    """
    cell = COVERS.index(case["cover"]) * len(SLOPES) + SLOPES.index(case["slope"])
    return case.number * len(COVERS) * len(SLOPES) + cell


def make_terrain(case: Case, rng: np.random.Generator) -> Terrain:
    """Generate fractal terrain 1 km wide with rocks around its center."""
    grid = Grid.centred((0.0, 0.0), 1000.0, 4.0)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(case["slope"]))
    low, high = (int(k) for k in np.searchsorted(grid.x, [-0.5 * FIELD, 0.5 * FIELD]))
    inner = Grid(grid.x[low], grid.y[low], 4.0, high - low, high - low)
    middle = Heightfield(inner, np.ascontiguousarray(relief.z[low:high, low:high]))
    diameters = sample_diameters(FIELD**2, case["cover"], 0.2, 3.0, rng)
    shape = RockModel(SHAPES[field_index(case) % len(SHAPES)])  # type: ignore[arg-type]
    return Terrain(relief, place_rocks(middle, diameters, rng, model=shape))


def check_images(case: Case) -> list[dict[str, Any]]:
    """Simulate good and faulty images of a field, and check each of them.

    There is one view for each Sun elevation and altitude; views with terrain too close to the
    camera are skipped. A row has Sun elevation (deg), altitude (m), name of the fault, and result
    of `check_result`.
    """
    rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(field_index(case),)))
    terrain = make_terrain(case, rng)
    rows = []
    for elevation, altitude in product(SUNS, ALTITUDES):
        light = Light(rng.uniform(0.0, 2.0 * np.pi), np.radians(elevation))
        aim = np.append(rng.uniform(-15.0, 15.0, 2), 0.0)
        aim[2] = float(terrain.elevation(aim[None, :2])[0])
        back = direction_from_angles(rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.8, 0.5 * np.pi))
        position = aim + back * altitude / back[2]
        if position[2] < float(terrain.elevation(position[None, :2])[0]) + 0.5 * altitude:
            continue
        state = State(position, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1000.0)
        camera = replace(Camera(), mount=gimbal_mount(state.attitude, aim - position))
        counts = camera.expose(World(terrain, 1.622, light), state, 0.0, rng).counts
        images = [("none", counts, 0.0), (SEEN, counts, 0.0)]
        for name, image, turn in images + (faulty_images(counts, rng) if case["faults"] else []):
            sun = direction_from_angles(light.azimuth + turn, light.elevation)
            health = ImageQualityCheck()
            health.sun.confirmed = name == SEEN
            result = check_result(image, camera, state, sun, aim[2], health)
            rows.append({"sun": elevation, "altitude": altitude, "fault": name, "result": result})
    return rows


def check_result(
    image: Counts,
    camera: Camera,
    state: State,
    sun: Any,
    terrain_height: float,
    check: ImageQualityCheck,
) -> str:
    """Return why the image check rejects an image; "counts" if the image is accepted.

    `sun` (3,) is the assumed direction to the Sun and `terrain_height` is in m. Reasons without an
    alarm are in parentheses.
    """
    checked = check.before_detection(image, camera, state)
    if checked.good:
        # The rock population is unknown to the check.
        model = ShadowModel(float(np.arcsin(sun[2])))
        seen = detect_rocks(image, camera, state, sun, terrain=terrain_height, model=model)
        points = np.column_stack((seen.terrain_xy, np.full(len(seen), terrain_height)))
        noise = checked.metrics["noise"]
        turn = measure_shadow_angle(seen, camera.view(state), points, sun, model, noise)
        checked = check.after_detection(seen, turn, noise)
    if checked.fault is None:
        return "counts"
    return f"{'' if checked.alarm else '('}{checked.fault.name}{'' if checked.alarm else ')'}"


def faulty_images(counts: Counts, rng: np.random.Generator) -> list[tuple[str, Any, float]]:
    """Return faulty versions of an image: fault, image, error of the Sun azimuth, rad."""
    grey, shape = counts.astype(np.float32), counts.shape
    out: list[tuple[str, Any, float]] = [
        ("black", np.zeros_like(counts), 0.0), ("white", np.full_like(counts, 255), 0.0),
        ("no numbers", np.full(shape, np.nan), 0.0),
        ("noise", rng.integers(0, 256, shape).astype(np.uint8), 0.0),
    ]  # fmt: skip
    for share in (0.1, 0.3):
        noise = share * np.median(grey) * rng.standard_normal(shape)
        out.append((f"under noise of {share}", add_read_noise(grey + noise, rng), 0.0))
    for sigma in (1.0, 1.5, 2.0, 3.0):
        out.append(
            (f"defocus {sigma} px", add_read_noise(cv2.GaussianBlur(grey, (0, 0), sigma), rng), 0.0)
        )
    for length in (4, 6, 8, 12):
        out.append((f"smear {length} px", add_read_noise(smear_image(grey, length, rng), rng), 0.0))
    half = counts.copy()
    rows, cols = shape
    half[(np.s_[rows // 2 :], np.s_[: rows // 2], np.s_[:, cols // 2 :], np.s_[:, : cols // 2])[
        rng.integers(4)
    ]] = 0  # fmt: skip
    out.append(("half black", half, 0.0))
    out += [(f"Sun {turn:+d} deg", counts, float(np.radians(turn))) for turn in (30, -30, 180)]
    return out


def add_read_noise(gray_values: Any, rng: np.random.Generator) -> Counts:
    """Add read noise to gray values and round them to counts (0 to 255)."""
    noisy = gray_values + 0.6 * rng.standard_normal(gray_values.shape)
    return np.asarray(np.rint(noisy).clip(0, 255), np.uint8)


def smear_image(gray_values: NDArray[np.float32], length: int, rng: np.random.Generator) -> Any:
    """Smear an image by `length` pixels in a random direction, as by motion."""
    angle = rng.uniform(0.0, np.pi)
    kernel = np.zeros((2 * length + 1,) * 2, np.float32)
    for t in np.linspace(-0.5, 0.5, 100) * length:
        kernel[length + round(t * np.sin(angle)), length + round(t * np.cos(angle))] += 0.01
    return cv2.filter2D(gray_values, -1, kernel)


def print_results(report: Report) -> None:
    """Print accepted and rejected fractions by condition, and results by fault."""
    good = [r for r in report.rows if r["fault"] == SEEN]
    for key in ("sun", "altitude", "cover", "slope"):
        table = Table(title=f"Good images with confirmed Sun direction, by {key}")
        for heading in (
            key, "images", "accepted (fraction)", "insufficient (fraction)", "rejected (fraction)",
        ):  # fmt: skip
            table.add_column(heading, justify="right")
        for value in sorted({r[key] for r in good}):
            of = [r["result"] for r in good if r[key] == value]
            counts = sum(v == "counts" for v in of)
            little = sum(v.startswith("(") for v in of)
            shares = (n / len(of) for n in (counts, little, len(of) - counts - little))
            table.add_row(str(value), str(len(of)), *(f"{share:.3f}" for share in shares))
        report.print(table)
    table = Table(title="Results of the image check")
    for heading in ("fault", "images", "accepted", "reasons of rejection"):
        table.add_column(heading, justify="left" if heading == "fault" else "right")
    for (name,), rows in report.groups("fault").items():
        by = Counter(r["result"] for r in rows)
        why = ", ".join(f"{v} {n}" for v, n in by.most_common() if v != "counts")
        table.add_row(name, str(by.total()), str(by["counts"]), why)
    report.print(table)


study = Study(
    check_images,
    repeats="fields",
    count=1,
    seed=7,
    factors={"cover": COVERS, "slope": SLOPES},
    factor_help={"cover": "Rock cover (fraction).", "slope": "RMS slope of the terrain (deg)."},
    options=(
        click.Option(
            ["--faults/--no-faults"], default=True, show_default=True,
            help="Whether to check faulty images also.",
        ),
    ),
    report=print_results,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
