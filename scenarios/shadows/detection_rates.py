"""Measure the false-negative and false-detection rates of the shadow detector.

Rendered fields of rocks of all shapes, or of one, are seen from random positions. A rock whose
shadow patch should have q^2 pixels counts as found if a detection lies on it with a radius within a
factor of two; as merged if its patch runs into another one; and as missed otherwise. A detection
without a rock is false. The position of a hazard is cleared if the rock is not found and the image
gives evidence that no such rock is there (`ClearEvidence`). Lines are fitted to the rates against q
(shadow EKF paper, III.C).

Each field is seen in eight images. The defaults of `DetectionRates` are the lines printed by

python scenarios/shadows/detection_rates.py
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.optimize import least_squares, minimize
from scipy.spatial import cKDTree

from lunarsim import Grid, Heightfield, Terrain
from lunarsim.api import State, gimbal_mount
from lunarsim.frames import direction_from_angles
from lunarsim.models.pinhole import View
from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections, detect_rocks
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.camera import Camera
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.world import World
from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO, SUN_DIAMETER_RAD, Light
from lunarsim.world.terrain import place_rocks

EDGES = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0, 20.0])
FIELD = 160.0
SHAPES = ("hemisphere", "ellipsoid", "cube", "irregular", "mixed")
ALL = "all"
# Minimum diameter of the rocks that must not be cleared, m.
MIN_HAZARD_DIAMETER = 0.5
# Number of images of one field.
IMAGES_PER_FIELD = 8
# Light settings: only the Sun direction, or all effects of docs/explanation/rendering.md.
LIGHTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "full": {
        "photometry": "hapke", "diameter": SUN_DIAMETER_RAD, "scattered_light": True,
        "earthshine": FULL_EARTH_IRRADIANCE_RATIO, "albedo_variation": 0.05, "boulder_albedo": 1.3,
        "boulder_albedo_variation": 0.15,
    },
}  # fmt: skip


def make_world(
    shape: str, elevation: float, rng: np.random.Generator, light: str = "plain"
) -> World:
    """Generate a rock field on horizontal terrain by Golombek's law with 5 % cover.

    `elevation` is that of the Sun (rad); `light` is a name in `LIGHTS`.
    """
    grid = Grid.centred((0.0, 0.0), FIELD, 2.0)
    relief = Heightfield(grid, np.zeros(grid.shape, np.float32))
    diameters = sample_diameters(FIELD**2, 0.05, 0.3, 3.0, rng)
    rocks = place_rocks(relief, diameters, rng, model=rock_model_of(shape))
    return World(Terrain(relief, rocks), 1.622, Light(0.0, elevation, **LIGHTS[light]))


def rock_model_of(shape: str) -> RockModel:
    """Return the population of rocks of one shape without burial."""
    return RockModel(shape, burial=(0.0, 0.0))  # type: ignore[arg-type]


def take_image(world: World, model: ShapeMixture, rng: np.random.Generator) -> dict[str, Any]:
    """Simulate one image; return shadow size and detection result of each rock.

    The shadow size `q` is the square root of the expected number of shadow pixels. The result
    holds, by name: for rocks in view "rocks_q" and the flags "missed" and "merged"; for detections
    "detections_q" and the flag "false"; for hazards "hazards_q" and the flag "cleared".
    """
    altitude = np.exp(rng.uniform(np.log(25.0), np.log(250.0)))
    depression = rng.uniform(np.radians(22.0), np.pi / 2)
    back = direction_from_angles(rng.uniform(0.0, 2.0 * np.pi), depression)
    position = back * altitude / back[2]
    state = State(position, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1000.0)
    camera = replace(Camera(), mount=gimbal_mount(state.attitude, -position))
    photo = camera.expose(world, state, 0.0, rng)
    seen = detect_rocks(photo.counts, camera, state, world.light.direction, model=model)
    model.update_fractions(seen.shapes, seen.q)
    rocks = world.terrain.rocks
    xy = np.column_stack((rocks.x, rocks.y))
    away = position[:2] - xy
    level = np.hypot(*away.T)
    azimuth = np.arctan2(away[:, 0], away[:, 1]) - world.light.azimuth
    pixel = np.hypot(level, altitude) / camera.fx
    q = model.visible_q(rocks.a, azimuth, np.arctan2(altitude, level), pixel)
    view = camera.view(state)
    s = (np.column_stack((xy, np.zeros(len(xy)))) - position) @ view.axes
    uv = view.pinhole.project(s)
    inside = (s[:, 2] > 0.0) & (uv > 25.0).all(1) & (uv < np.array([615.0, 455.0])).all(1)
    found = np.zeros(len(xy), bool)
    false = np.zeros(len(seen), bool)
    if len(seen):
        near = cKDTree(seen.terrain_xy).query_ball_point(xy, np.maximum(rocks.a, 1.5 * pixel))
        found = np.array(
            [
                any(0.5 < seen.radius[j] / rocks.a[i] < 2.0 for j in hits)
                for i, hits in enumerate(near)
            ]
        )
        reach = np.maximum(1.5 * seen.radius, 2.0 * np.median(pixel))
        false = np.array(
            [not hits for hits in cKDTree(xy).query_ball_point(seen.terrain_xy, reach)]
        )
    # A rock whose patch runs into another one is not detected separately: dark, but not missed.
    unit = model.patch(azimuth, np.arctan2(altitude, level))
    sun = np.array([np.sin(world.light.azimuth), np.cos(world.light.azimuth)])
    offset = np.stack((unit.along, unit.across), -1) @ np.array([sun, [-sun[1], sun[0]]])
    middle = np.column_stack((xy + rocks.a[:, None] * offset, np.zeros(len(xy)))) - position
    s = middle @ view.axes
    u, v = np.rint(view.pinhole.project(s)).T
    u, v = np.clip(u, 0, 639).astype(int), np.clip(v, 0, 479).astype(int)
    patch = seen.labels[v, u]
    # Patches below the minimum size are dark but no detections: those rocks are missed.
    size = np.bincount(seen.labels.ravel())
    merged = ~found & (patch > 0) & (size[patch] > 1.7 * q**2) & (size[patch] >= 4)
    hazard = inside & (2.0 * rocks.a >= MIN_HAZARD_DIAMETER) & (len(seen) > 0)
    return {
        "hazards_q": q[hazard],
        "cleared": (is_cleared(world, view, seen, model) & ~found)[hazard],
        "rocks_q": q[inside], "missed": (~found & ~merged)[inside], "merged": merged[inside],
        "detections_q": seen.q, "false": false,
    }  # fmt: skip


def is_cleared(
    world: World, view: View, detections: Detections, model: ShapeMixture
) -> NDArray[np.bool_]:
    """Return for each rock (n,) whether one image gives evidence that it is absent.

    This is evidence of lit terrain, and none of a shadow, within half the rock's radius of its
    center. `detections` are those in the image.
    """
    rocks = world.terrain.rocks
    grid = Grid.centred((0.0, 0.0), FIELD, 0.25)
    sizes = MIN_HAZARD_DIAMETER * 1.4 ** np.arange(4)
    evidence = ClearEvidence(grid, model, sizes, np.ones(4), DetectionRates())
    evidence.add_image(view, world.light.direction, detections, lambda xy: np.zeros(len(xy)))
    of = np.clip(np.searchsorted(0.5 * sizes, rocks.a, side="right") - 1, 0, 3)
    centre = grid.centres().reshape(-1, 2)
    near = cKDTree(centre).query_ball_point(
        np.column_stack((rocks.x, rocks.y)), np.maximum(0.5 * rocks.a, 0.18)
    )
    lit, dark = evidence.lit.reshape(4, -1), evidence.dark.reshape(4, -1)
    return np.array(
        [bool(lit[k, at].any() and not dark[k, at].any()) for k, at in zip(of, near, strict=True)]
    )


def measure_field(case: Case) -> list[dict[str, Any]]:
    """Simulate the images of one field; count results by bin of shadow size q.

    The bins are those of `EDGES`. A row has the limits of its bin and the numbers of rocks in view,
    of those missed and merged, of detections and false ones, and of hazards and cleared ones.
    """
    shape = SHAPES[case.number % len(SHAPES)] if case["shape"] == ALL else case["shape"]
    elevation = np.radians(case["sun_elevation"])
    images = []
    for k in range(IMAGES_PER_FIELD):
        key = (case.number * IMAGES_PER_FIELD + k,)
        rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=key))
        if k == 0:
            world = make_world(shape, elevation, rng, case["light"])
            model = ShapeMixture(elevation)
        images.append(take_image(world, model, rng))
    found = {name: np.concatenate([image[name] for image in images]) for name in images[0]}
    counts = {}
    for number, flags in FLAGS.items():
        q = found[f"{number}_q"]
        counts[number], _ = np.histogram(q, EDGES)
        counts |= {flag: np.histogram(q[found[flag]], EDGES)[0] for flag in flags}
    return [
        {"from": low, "to": high} | {name: int(count[n]) for name, count in counts.items()}
        for n, (low, high) in enumerate(pairwise(EDGES.tolist()))
    ]


def pooled_rates(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return rates and numbers of samples over all fields, and fitted lines.

    The rates ("missed", "merged", "false", "cleared") and numbers ("rocks", "detections",
    "hazards") are by bin of shadow size q (bins,), with the bin "edges". "lines" has start, slope
    and floor of each line; only bins with 30 samples or more are fitted.
    """
    sums = {
        name: np.array([sum(r[name] for r in rows if r["from"] == low) for low in EDGES[:-1]])
        for name in rows[0] if name not in {"from", "to", "number"}
    }  # fmt: skip
    middle = 0.5 * (EDGES[1:] + EDGES[:-1])
    data: dict[str, Any] = {"edges": EDGES, "lines": {}}
    for number, flags in FLAGS.items():
        many = sums[number] >= 30
        data[number] = sums[number]
        for flag in flags:
            data[flag] = sums[flag] / np.maximum(sums[number], 1)
            if flag in FITS:
                line = FITS[flag](middle[many], data[flag][many], sums[number][many])
                data["lines"][flag] = line
    return data


def fit_least_squares(
    bin_centers: NDArray[Any], rates: NDArray[Any], counts: NDArray[Any]
) -> list[float]:
    """Fit a clipped line to rates by least squares; return its start, slope and floor.

    `bin_centers` are values of q (square root of the number of shadow pixels); `counts` are the
    numbers of samples. The line is clip(start + slope q, floor, 1).
    """
    weight = np.sqrt(np.minimum(counts, 500.0))

    def off(x: NDArray[Any]) -> NDArray[Any]:
        return weight * (np.clip(x[0] + x[1] * bin_centers, x[2], 1.0) - rates)

    best = min(
        (
            least_squares(off, [a, b, 0.02], bounds=([0.0, -2.0, 1e-3], [4.0, 0.0, 0.5]))
            for a in (0.3, 1.0, 2.0)
            for b in (-0.05, -0.3, -0.8)
        ),
        key=lambda r: r.cost,
    )
    return [float(v) for v in best.x]


def fit_maximum_likelihood(
    bin_centers: NDArray[Any], rates: NDArray[Any], counts: NDArray[Any]
) -> list[float]:
    """Fit a clipped line by maximum likelihood; return its start, slope and floor.

    The arguments are those of `fit_least_squares`. The likelihood gives small rates more weight:
    whether 1 % or 3 % of the hazards are cleared matters. The line starts at 1 or more because a
    rock that covers no pixel is always cleared.
    """
    hits = rates * counts

    def off(x: NDArray[Any]) -> float:
        if not (x[0] >= 1.0 and x[1] <= 0.0 and 1e-3 <= x[2] <= 0.5):
            return np.inf
        p = np.clip(x[0] + x[1] * bin_centers, x[2], 1.0 - 1e-9)
        return -float((hits * np.log(p) + (counts - hits) * np.log1p(-p)).sum())

    starts = [(a, b, c) for a in (1.0, 1.1, 1.3) for b in (-0.2, -0.3, -0.45) for c in (0.01, 0.03)]
    settings = {"xatol": 1e-5, "fatol": 1e-6, "maxiter": 4000}
    best = min(
        (minimize(off, start, method="Nelder-Mead", options=settings) for start in starts),
        key=lambda r: r.fun,
    )
    return [float(v) for v in best.x]


# Samples of each kind, the flags that they can have, and the fit to the rates of a flag.
FLAGS = {"rocks": ("missed", "merged"), "detections": ("false",), "hazards": ("cleared",)}
FITS = {
    "missed": fit_least_squares, "false": fit_least_squares, "cleared": fit_maximum_likelihood,
}  # fmt: skip


def report_rates(report: Report) -> None:
    """Print the error rates of the shadow detector by shadow size, and fitted lines.

    The rates are those of missed and merged rocks, false detections and cleared hazards. If there
    is an output folder, they are also plotted.
    """
    data, options = pooled_rates(report.rows), report.options
    images = IMAGES_PER_FIELD * len(report.groups("number"))
    shape = options["shape"]
    table = Table(
        title=f"{shape}, Sun at {options['sun_elevation']:g} deg, {options['light']} light, "
        f"{images} images"
    )
    for heading in ("q (pixels)", "rocks", "merged", "missed", "line", "detections", "false",
                    "line", "hazards", "cleared", "line"):  # fmt: skip
        table.add_column(heading, justify="right")
    for k, (low, high) in enumerate(pairwise(EDGES)):
        missed, false, clear = (
            float(np.clip(start + slope * 0.5 * (low + high), floor, 1.0))
            for start, slope, floor in data["lines"].values()
        )
        table.add_row(
            f"{low:g} - {high:g}", str(data["rocks"][k]), f"{data['merged'][k]:.3f}",
            f"{data['missed'][k]:.3f}", f"{missed:.3f}", str(data["detections"][k]),
            f"{data['false'][k]:.4f}", f"{false:.4f}",
            str(data["hazards"][k]), f"{data['cleared'][k]:.4f}", f"{clear:.4f}",
        )  # fmt: skip
    report.print(table)
    for name, (start, slope, floor) in data["lines"].items():
        report.print(f"{name}: clip({start:.3f} {slope:+.3f} q, {floor:.4f}, 1)")
    if report.out is not None:
        from figures import draw_rates

        draw_rates(data, shape, report.out / f"rates_{shape}.png")


study = Study(
    measure_field,
    repeats="fields",
    count=10,
    options=(
        click.Option(
            ["--shape"], type=click.Choice((ALL, *SHAPES)), default=ALL, show_default=True,
            help="Rock shape; all: each rock field has another shape in turn.",
        ),
        click.Option(
            ["--sun-elevation"], type=float, default=20.0, show_default=True,
            help="Elevation of the Sun above the horizon (deg).",
        ),
        click.Option(
            ["--light"], type=click.Choice(tuple(LIGHTS)), default="plain", show_default=True,
            help="Light: plain (the Sun is a point source) or full (all light effects).",
        ),
    ),
    report=report_rates,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
