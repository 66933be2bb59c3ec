"""Measure the false-negative and false-detection rates of the shadow detector.

Rendered fields of rocks of all shapes, or of one, are seen from random positions. A rock whose
shadow patch should have q^2 pixels counts as found if a detection lies on it with a radius within a
factor of two; as merged if its patch runs into another one; and as missed otherwise. A detection
without a rock is false. The position of a hazard is cleared if the rock is not found and the image
gives evidence that no such rock is there (`ClearEvidence`). Lines are fitted to the rates against q
(shadow EKF paper, III.C).

The defaults of `DetectionRates` are the lines printed by

python scenarios/shadows/detection_rates.py
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import least_squares, minimize
from scipy.spatial import cKDTree

from lunarsim import Grid, Heightfield, Terrain
from lunarsim.api import State, gimbal_mount
from lunarsim.console import plain_console
from lunarsim.frames import direction_from_angles
from lunarsim.models.pinhole import View
from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections, detect_rocks
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.camera import Camera
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
    holds, by name: for rocks in view q and the flags "missed" and "merged"; for detections "seen_q"
    and the flag "false"; for hazards "hazard_q" and the flag "cleared".
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
    q = model.visible_pixels(rocks.a, azimuth, np.arctan2(altitude, level), pixel)
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
    offset = np.stack((unit.along, unit.side), -1) @ np.array([sun, [-sun[1], sun[0]]])
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
        "hazard_q": q[hazard], "cleared": (is_cleared(world, view, seen,
        model) & ~found)[hazard],
        "q": q[inside], "missed": (~found & ~merged)[inside], "merged": merged[inside],
        "seen_q": seen.q, "false": false,
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


def rates_by_size(q: NDArray[Any], flag: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the fraction of samples with a flag, and their number, by bin of q.

    `q` (n,) is the square root of the number of shadow pixels; `EDGES` holds the bin limits.
    """
    number, _ = np.histogram(q, EDGES)
    hits, _ = np.histogram(q[flag], EDGES)
    return hits / np.maximum(number, 1), number


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


def show(data: dict[str, Any], title: str, console: Console) -> None:
    """Print false-negative, false-detection and clearing rates against shadow size.

    `data` holds the measured rates by bin of q (square root of the number of shadow pixels) and the
    fitted lines.
    """
    table = Table(title=title)
    for heading in ("q (pixels)", "rocks", "merged", "missed", "line", "detections", "false",
                    "line", "hazards", "cleared", "line"):  # fmt: skip
        table.add_column(heading, justify="right")
    for k, (low, high) in enumerate(pairwise(data["edges"])):
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
    console.print(table)
    for name, (start, slope, floor) in data["lines"].items():
        console.print(f"{name}: clip({start:.3f} {slope:+.3f} q, {floor:.4f}, 1)")


@click.command()
@click.option("--images", type=click.IntRange(min=4), default=80, show_default=True,
              help="Number of simulated images.")  # fmt: skip
@click.option(
    "--shape",
    type=click.Choice((ALL, *SHAPES)),
    default=ALL,
    show_default=True,
    help="Rock shape; all: each rock field has another shape in turn.",
)
@click.option(
    "--sun-elevation",
    default=20.0,
    show_default=True,
    help="Elevation of the Sun above the horizon (deg).",
)
@click.option("--light", type=click.Choice(tuple(LIGHTS)), default="plain", show_default=True,
              help="Light: plain (the Sun is a point source) or full (all light "
              "effects).")  # fmt: skip
@click.option(
    "--seed",
    type=int,
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure and its data. Default: none.")  # fmt: skip
def main(
    images: int, shape: str, sun_elevation: float, light: str, seed: int, out: Path | None
) -> None:
    """Measure the rates of the shadow detector and fit lines to them."""
    console = plain_console(130)
    elevation = np.radians(sun_elevation)
    looks = []
    for k in track(range(images), description="images"):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(k,)))
        if k % IMAGES_PER_FIELD == 0:
            own = SHAPES[k // IMAGES_PER_FIELD % len(SHAPES)] if shape == ALL else shape
            world, model = make_world(own, elevation, rng, light), ShapeMixture(elevation)
        looks.append(take_image(world, model, rng))
    q, lost, run, seen_q, false, hazard_q, gone = (
        np.concatenate([one[name] for one in looks])
        for name in ("q", "missed", "merged", "seen_q", "false", "hazard_q", "cleared")
    )
    missed, rocks = rates_by_size(q, lost)
    merged, _ = rates_by_size(q, run)
    made_up, detections = rates_by_size(seen_q, false)
    clear, hazards = rates_by_size(hazard_q, gone)
    middle = 0.5 * (EDGES[1:] + EDGES[:-1])
    many, some, few = rocks >= 30, detections >= 30, hazards >= 30
    lines = {
        "missed": fit_least_squares(middle[many], missed[many], rocks[many]),
        "false": fit_least_squares(middle[some], made_up[some], detections[some]),
        "cleared": fit_maximum_likelihood(middle[few], clear[few], hazards[few]),
    }
    data = {
        "edges": EDGES.tolist(), "rocks": rocks.tolist(), "missed": missed.tolist(),
        "merged": merged.tolist(), "detections": detections.tolist(), "false": made_up.tolist(),
        "hazards": hazards.tolist(), "cleared": clear.tolist(), "lines": lines,
    }  # fmt: skip
    title = f"{shape}, Sun at {sun_elevation:g} deg, {light} light, {images} images"
    show(data, title, console)
    if out is not None:
        from figures import draw_rates

        out.mkdir(parents=True, exist_ok=True)
        (out / f"rates_{shape}.json").write_text(json.dumps(data, indent=1), encoding="utf-8")
        draw_rates(data, shape, out / f"rates_{shape}.png")


if __name__ == "__main__":
    main()
