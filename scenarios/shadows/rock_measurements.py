"""Measure how rock centers from shadows vary between images and views.

A camera with known pose descends to a rendered field along a straight path, and the detected rock
positions are compared with the true ones. The difference between two images 0.1 s apart is
measurement noise; the table compares it with the covariance of the detector
(`independent_covariance`). The additional difference after a rotation of the view is specific to a
rock or common to all rocks (`RockFilter.turn`); both are random walks, in radii per square root of
a radian, as in `TrackerSettings.view_wander`. The remaining error after averaging the measurements
of a rock comes from its shape; `ShadowModel` contains such values. The first measurement good
enough to start a track is compared with the later ones: the first is selected by its quality and
the later ones are not, so a tracker restarts with the second one.

python scenarios/shadows/rock_measurements.py
python scenarios/shadows/rock_measurements.py --shape irregular --sun-elevation 10
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import click
import numpy as np
from detection_rates import SHAPES, make_world, rock_model_of
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial import cKDTree

from lunarsim.api import State, gimbal_mount
from lunarsim.frames import direction_from_angles
from lunarsim.onboard.hazards.shadows import TrackerSettings
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.sensors.camera import Camera
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.world import World

Array = NDArray[np.float64]

# Bins of the rock radius, pixels.
EDGES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
# First and last distance from the field, m; image rate, Hz; descent speed along the path, m/s.
FAR, NEAR, RATE, SPEED = 160.0, 25.0, 10.0, 12.0
# Number of images between two that measure the random walk; minimum rotation, rad.
LAG, MIN_TURN = 20, 0.05
# Maximum distance of a detection from a rock, pixels (or the rock radius), and maximum size ratio.
MAX_DISTANCE_PX, MAX_SIZE_RATIO = 2.5, 1.6
# Minimum number of measurements of a rock whose mean error is attributed to its shape.
MIN_MEASUREMENTS = 10
# Number of images after the first good one from which measurements count as settled.
SETTLED = 6
# Minimum number of rocks visible in both images for the common error.
MIN_COMMON_ROCKS = 8


@dataclass(frozen=True)
class RockMeasurements:
    """Shadow measurements of rocks in a sequence of images.

    Attributes
    ----------
    error, sigma
        Position error along and across the Sun direction, m, and its standard deviation by the
        detector (images, rocks, 2); NaN without a measurement.
    pixel
        Size of a pixel on the terrain along and across, m (images, rocks, 2).
    direction
        Unit vectors from the camera to the rocks (images, rocks, 3).
    radius_ratio
        Measured over true radius (images, rocks).
    radius
        True radius, m (rocks,).
    can_start_track
        Whether the measurement is good enough to start a track (images, rocks).
    """

    error: Array
    sigma: Array
    pixel: Array
    direction: Array
    radius_ratio: Array
    radius: Array
    can_start_track: NDArray[np.bool_]


def measure_descent(world: World, model: ShadowModel, rng: np.random.Generator) -> RockMeasurements:
    """Simulate a descent towards a field and measure the rocks in each image.

    `model` predicts shadows for the Sun elevation and rock shape.
    """
    rocks, sun = world.terrain.rocks, world.light.direction
    true = np.column_stack((rocks.x, rocks.y, np.zeros(len(rocks))))
    tree = cKDTree(true[:, :2])
    level = sun[:2] / np.hypot(*sun[:2])
    axes = np.array([level, [-level[1], level[0]]]).T
    back = direction_from_angles(rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(30.0, 60.0)))
    # Slightly off the line of sight, so that the view rotates.
    lateral = np.append(rng.uniform(-0.3, 0.3, 2), 0.0)
    rows = []
    for way in np.arange(0.0, FAR - NEAR, SPEED / RATE):
        position = back * (FAR - way) + lateral * way
        state = State(position, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1.0)
        camera = replace(Camera(), mount=gimbal_mount(state.attitude, -position))
        counts = camera.expose(world, state, 0.0, rng).counts
        seen = detect_rocks(counts, camera, state, sun, model=model)
        row = np.full((len(rocks), 11), np.nan)
        if len(seen):
            away, nearest = tree.query(seen.terrain_xy)
            like = np.abs(np.log(seen.radius / rocks.a[nearest])) < np.log(MAX_SIZE_RATIO)
            view = camera.view(state)
            pixel = np.linalg.norm(true[nearest] - position, axis=1) / view.pinhole.fx
            # A limit of one radius would cut off the errors of small rocks.
            at = (away < np.maximum(rocks.a[nearest], MAX_DISTANCE_PX * pixel)) & like
            of = nearest[at]
            by_place = view.pinhole.jacobian((true[of] - position) @ view.axes, view.axes[:2].T)
            to_terrain = np.linalg.inv(by_place @ axes)
            moved = seen.pixel[at] - view.pinhole.project((true[of] - position) @ view.axes)
            own = to_terrain @ seen.independent_covariance[at] @ np.swapaxes(to_terrain, 1, 2)
            row[of, :2] = np.einsum("nij,nj->ni", to_terrain, moved)
            row[of, 2:4] = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
            row[of, 9] = seen.radius[at] / rocks.a[of]
            row[of, 10] = seen.q[at]
            row[of, 4:6] = 1.0 / np.linalg.norm(by_place @ axes, axis=1)
        sight = true - position
        row[:, 6:9] = sight / np.linalg.norm(sight, axis=1)[:, None]
        rows.append(row)
    table = np.array(rows)
    off, sigma, pixel, sight = np.split(table[..., :9], (2, 4, 6), axis=-1)
    ratio, q = table[..., 9], table[..., 10]
    begins, read = TrackerSettings(), ratio * rocks.a
    sharp = sigma.max(axis=-1) < np.maximum(begins.max_birth_sigma, read / 3.0)
    good = (q >= begins.min_birth_q) & (read >= begins.min_radius) & sharp
    return RockMeasurements(off, sigma, pixel, sight, ratio, rocks.a, good)


def measure_field(case: Case) -> dict[str, Any]:
    """Simulate the descent to one field; return samples of the statistics of rocks.

    The samples are those of `successive_changes`, `biases_after_first`, `random_walks` and
    `persistent_errors`.
    """
    rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(case.number,)))
    elevation = np.radians(case["sun_elevation"])
    world = make_world(case["shape"], elevation, rng)
    model = ShadowModel(elevation, rock_model_of(case["shape"]))
    descent = measure_descent(world, model, rng)
    return {
        "changes": successive_changes(descent), "biases": biases_after_first(descent),
        "walks": random_walks(descent), "remaining": persistent_errors(descent),
    }  # fmt: skip


def successive_changes(one: RockMeasurements) -> Array:
    """Return sums of the changes between successive images by rock radius (bins, 5).

    Columns: number of changes; sums of squares of the change along and across the Sun direction
    over its standard deviation, and of the change along and across in pixels, scaled to a single
    measurement. The median change of all rocks is subtracted. The bins are those of `EDGES`.
    """
    change = np.diff(one.error, axis=0)
    change -= np.nanmedian(change, axis=1, keepdims=True)
    sigma = np.hypot(one.sigma[1:], one.sigma[:-1])
    pixel = np.sqrt(2.0) * one.pixel[1:]
    size = np.broadcast_to(one.radius, change.shape[:2]) / one.pixel[1:].mean(axis=-1)
    ratios = np.concatenate((change / sigma, change / pixel), axis=-1)
    known = np.isfinite(ratios).all(axis=-1) & np.isfinite(size)
    sums = []
    for low, high in pairwise(EDGES):
        at = ratios[known & (size >= low) & (size < high)]
        sums.append([len(at), *np.sum(at**2, axis=0)])
    return np.array(sums)


def biases_after_first(one: RockMeasurements) -> Array:
    """Return errors of the first good measurements of rocks (n, SETTLED, 2), pixels.

    Row i has the errors of one rock in the first image good enough to start a track and in the
    images that follow. The errors along and across the Sun direction are relative to the mean of
    later measurements, from `SETTLED` to twice as many images after the first. Rocks that are
    measured well in the first image of the descent are omitted.
    """
    out = []
    for rock in np.flatnonzero(one.can_start_track.any(axis=0) & ~one.can_start_track[0]):
        first = int(np.argmax(one.can_start_track[:, rock]))
        late = one.error[first + SETTLED : first + 2 * SETTLED, rock]
        if len(late) < SETTLED or np.isfinite(late[:, 0]).sum() < SETTLED // 2:
            continue
        row = one.error[first : first + SETTLED, rock] - np.nanmean(late, axis=0)
        out.append(row / one.pixel[first, rock])
    return np.array(out).reshape(-1, SETTLED, 2)


def random_walks(one: RockMeasurements) -> Array:
    """Return variances of rock centers per rotation of the view direction (n, 2, 2).

    A sample compares two images; the variances are in squared rock radii per radian: of each rock
    without noise, and common to all rocks; along and across the Sun direction. Pairs of images with
    a small rotation or few rocks in common are omitted.
    """
    out = []
    dot = np.einsum("kij,kij->ki", one.direction[LAG:], one.direction[:-LAG])
    turn = np.arccos(np.clip(dot, -1.0, 1.0))
    change = (one.error[LAG:] - one.error[:-LAG]) / one.radius[:, None]
    noise = (one.sigma[LAG:] ** 2 + one.sigma[:-LAG] ** 2) / one.radius[:, None] ** 2
    for move, sigma, angle in zip(change, noise, turn, strict=True):
        both = np.isfinite(move).all(1) & (np.abs(move) < 1.2).all(1)
        if both.sum() < MIN_COMMON_ROCKS or angle[both].mean() < MIN_TURN:
            continue
        mean, spread = move[both].mean(axis=0), move[both].var(axis=0, ddof=1)
        own, shared = spread - sigma[both].mean(axis=0), mean**2 - spread / both.sum()
        out.append(np.stack((own, shared)) / angle[both].mean())
    return np.array(out).reshape(-1, 2, 2)


def persistent_errors(one: RockMeasurements) -> Array:
    """Return the errors of each rock that remain after averaging over images (n, 3).

    Columns: mean radius / true radius, the variance of its noise, and the mean squared position
    error per axis without noise and without the mean error of the descent, in squared radii. Only
    rocks with `MIN_MEASUREMENTS` measurements or more are used.
    """
    count = np.isfinite(one.radius_ratio).sum(axis=0)
    some = count >= MIN_MEASUREMENTS
    ratio = one.radius_ratio[:, some]
    place = one.error[:, some] / one.radius[some, None]
    noise = np.nanvar(ratio, axis=0, ddof=1) / count[some]
    spread = (np.nanvar(place, axis=0, ddof=1) / count[some, None]).mean(axis=1)
    mean = np.nanmean(place, axis=0)
    mean = mean - mean.mean(axis=0)
    return np.column_stack((np.nanmean(ratio, axis=0), noise, (mean**2).mean(axis=1) - spread))


def report_errors(report: Report) -> None:
    """Print noise, bias of the first measurement, random walk and remaining errors."""
    table = Table(title="Change between successive measurements")
    for heading in ("radius (pixels)", "measurements", "along the Sun (pixels)", "across (pixels)",
                    "along / predicted", "across / predicted"):  # fmt: skip
        table.add_column(heading, justify="right")
    sums = np.sum([row["changes"] for row in report.rows], axis=0)
    for (low, high), (count, *squares) in zip(pairwise(EDGES), sums, strict=True):
        if count >= 2:
            along, across, *pixels = (f"{np.sqrt(square / count):.2f}" for square in squares)
            table.add_row(f"{low:g} - {high:g}", f"{count:.0f}", *pixels, along, across)
    report.print(table)
    table = Table(
        title="Bias after the first measurement that can start a track, relative to settled ones"
    )
    for heading in ("measurement", "along the Sun (pixels)", "across (pixels)"):
        table.add_column(heading, justify="right")
    biases = _joined(report, "biases", (SETTLED, 2))
    if len(biases) < 2:
        biases = np.full((2, SETTLED, 2), np.nan)
    count = np.maximum(np.isfinite(biases[..., 0]).sum(axis=0), 2)[:, None]
    error = np.nanstd(biases, axis=0, ddof=1) / np.sqrt(count)
    for k, pairs in enumerate(np.stack((np.nanmean(biases, axis=0), error), axis=-1)):
        table.add_row(f"{k + 1}", *(f"{mean:+.2f} ± {sigma:.2f}" for mean, sigma in pairs))
    report.print(table)
    walks = _joined(report, "walks", (2, 2))
    mean = walks.mean(axis=0) if len(walks) else np.full((2, 2), np.nan)
    own, shared = np.sqrt(np.maximum(mean, 0.0))
    report.print(
        f"Random walk with the view rotation (radii per sqrt(rad)): per rock {own[0]:.2f} along "
        f"the Sun, {own[1]:.2f} across; common {shared[0]:.2f} along, {shared[1]:.2f} across"
    )
    ratio, noise, place = _joined(report, "remaining", (3,)).T
    radius = centre = np.nan
    if len(ratio) >= 2:
        radius = np.sqrt(max(ratio.var(ddof=1) - noise.mean(), 0.0))
        centre = np.sqrt(max(place.mean(), 0.0))
    report.print(
        f"Remaining error after {MIN_MEASUREMENTS} measurements or more ({len(ratio)} rocks): "
        f"radius {radius:.2f} (relative), center {centre:.2f} radii per axis"
    )


def _joined(report: Report, name: str, shape: tuple[int, ...]) -> Array:
    """Return the samples (n, *shape) of column `name`, joined over all fields.

    `shape` is the shape of one sample.
    """
    samples = [np.array(row[name], dtype=np.float64).reshape(-1, *shape) for row in report.rows]
    return np.concatenate(samples)


study = Study(
    measure_field,
    repeats="fields",
    count=4,
    options=(
        click.Option(
            ["--shape"], type=click.Choice(SHAPES), default="cube", show_default=True,
            help="Shape of the rocks; the detector knows it.",
        ),
        click.Option(
            ["--sun-elevation"], type=click.FloatRange(2.0, 80.0), default=20.0, show_default=True,
            help="Elevation of the Sun above the horizon (deg).",
        ),
    ),
    report=report_errors,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
