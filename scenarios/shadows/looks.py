"""How centres of rocks, as their shadows show them, differ from look to look and as the view turns.

A camera comes down to a rendered field along a straight path, its pose known. Where each picture
shows the rocks is set against where they are. What differs between two pictures a tenth of a second
apart is noise of each look: beside it stands what the detector says (`look_covariance`). What
differs more after the view has turned is a rock's own, or alike for all, and wanders
(`RockFilter.turn`); both are in radii after a radian, as `TrackerSettings.view_wander` has them.
What is left when the looks of a rock are averaged is its shape: `ShadowModel` holds such figures.
And the first look that is good enough to begin a rock, against those that follow: it was chosen,
they were not, so that a tracker begins anew with the second.

python scenarios/shadows/looks.py
python scenarios/shadows/looks.py --shape irregular --sun-elevation 10
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import click
import numpy as np
from numpy.typing import NDArray
from rates import SHAPES, make_world, model_of
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial import cKDTree

from lunarsim.console import plain_console
from lunarsim.frames import direction_from_angles
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.hazards.shadows import TrackerSettings
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.sensors.camera import Camera
from lunarsim.vehicle import State
from lunarsim.world import World

Array = NDArray[np.float64]

# Pixels a radius, by which looks are told apart.
EDGES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
# From the field, m, and pictures a second; along the path the lander comes down so fast, m/s.
FAR, NEAR, RATE, SPEED = 160.0, 25.0, 10.0, 12.0
# Pictures between two whose differences tell of the wander, and the least turn, rad.
LAG, LEAST_TURN = 20, 0.05
# What is found is a rock's that is no farther off, pixels or its radius, and no less alike in size.
MOST_OFF, ALIKE = 2.5, 1.6
# Looks at a rock whose mean has its shape left, more than their noise.
MANY = 10
# Pictures after the first good one from which on looks count as settled.
SETTLED = 6
# Rocks that must show in both pictures for what they share.
FEWEST = 8


@dataclass(frozen=True)
class Looks:
    """What pictures showed of rocks.

    Attributes
    ----------
    off, said
        How far off each was seen along the Sun and across, m, and the deviation that the detector
        says of a look, (pictures, rocks, 2); NaN for one not seen.
    pixel
        What a pixel spans along and across there, m (pictures, rocks, 2).
    sight
        Directions to the rocks (pictures, rocks, 3).
    ratio
        Radius that a patch was read as over the true one (pictures, rocks).
    radius
        m (rocks,).
    good
        Which looks could begin a rock (pictures, rocks).
    """

    off: Array
    said: Array
    pixel: Array
    sight: Array
    ratio: Array
    radius: Array
    good: NDArray[np.bool_]


def descend(world: World, model: ShadowModel, rng: np.random.Generator) -> Looks:
    """Come down towards the middle of a field, and look."""
    rocks, sun = world.terrain.rocks, world.light.direction
    true = np.column_stack((rocks.x, rocks.y, np.zeros(len(rocks))))
    tree = cKDTree(true[:, :2])
    level = sun[:2] / np.hypot(*sun[:2])
    axes = np.array([level, [-level[1], level[0]]]).T
    back = direction_from_angles(rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(30.0, 60.0)))
    # A little beside the line of sight: the view turns.
    aside = np.append(rng.uniform(-0.3, 0.3, 2), 0.0)
    rows = []
    for way in np.arange(0.0, FAR - NEAR, SPEED / RATE):
        position = back * (FAR - way) + aside * way
        state = State(position, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1.0)
        camera = replace(Camera(), mount=gimbal_mount(state.attitude, -position))
        counts = camera.expose(world, state, 0.0, rng).counts
        seen = detect_rocks(counts, camera, state, sun, model=model)
        row = np.full((len(rocks), 11), np.nan)
        if len(seen):
            away, nearest = tree.query(seen.ground)
            like = np.abs(np.log(seen.radius / rocks.a[nearest])) < np.log(ALIKE)
            view = camera.view(state)
            pixel = np.linalg.norm(true[nearest] - position, axis=1) / view.pinhole.fx
            # A limit of a radius would cut off what small rocks err by.
            at = (away < np.maximum(rocks.a[nearest], MOST_OFF * pixel)) & like
            of = nearest[at]
            by_place = view.pinhole.jacobian((true[of] - position) @ view.axes, view.axes[:2].T)
            on_ground = np.linalg.inv(by_place @ axes)
            moved = seen.pixel[at] - view.pinhole.project((true[of] - position) @ view.axes)
            own = on_ground @ seen.look_covariance[at] @ np.swapaxes(on_ground, 1, 2)
            row[of, :2] = np.einsum("nij,nj->ni", on_ground, moved)
            row[of, 2:4] = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
            row[of, 9] = seen.radius[at] / rocks.a[of]
            row[of, 10] = seen.q[at]
            row[of, 4:6] = 1.0 / np.linalg.norm(by_place @ axes, axis=1)
        sight = true - position
        row[:, 6:9] = sight / np.linalg.norm(sight, axis=1)[:, None]
        rows.append(row)
    table = np.array(rows)
    off, said, pixel, sight = np.split(table[..., :9], (2, 4, 6), axis=-1)
    ratio, q = table[..., 9], table[..., 10]
    begins, read = TrackerSettings(), ratio * rocks.a
    sharp = said.max(axis=-1) < np.maximum(begins.birth_sigma, read / 3.0)
    good = (q >= begins.birth_q) & (read >= begins.least_radius) & sharp
    return Looks(off, said, pixel, sight, ratio, rocks.a, good)


def look_to_look(looks: list[Looks]) -> Array:
    """Return of pairs of looks (n, 5): pixels a radius, change along and across over what is said.

    And the change along and across in pixels; both for one look, not for a difference of two.
    """
    out = []
    for one in looks:
        change = np.diff(one.off, axis=0)
        change -= np.nanmedian(change, axis=1, keepdims=True)
        said = np.hypot(one.said[1:], one.said[:-1])
        pixel = np.sqrt(2.0) * one.pixel[1:]
        size = np.broadcast_to(one.radius, change.shape[:2]) / one.pixel[1:].mean(axis=-1)
        out.append(np.concatenate((size[..., None], change / said, change / pixel), axis=-1))
    rows = np.concatenate([o.reshape(-1, 5) for o in out])
    return rows[np.isfinite(rows).all(1)]


def after_the_first(looks: list[Looks]) -> Array:
    """Return by how much the first good look and those after differ from what comes later (n, 4).

    Of rocks that were seen and not good enough before: along the Sun and across, pixels, and their
    deviations. Later are looks `SETTLED` to twice as many pictures after the first.
    """
    out = []
    for one in looks:
        for rock in np.flatnonzero(one.good.any(axis=0) & ~one.good[0]):
            first = int(np.argmax(one.good[:, rock]))
            late = one.off[first + SETTLED : first + 2 * SETTLED, rock]
            if len(late) < SETTLED or np.isfinite(late[:, 0]).sum() < SETTLED // 2:
                continue
            row = one.off[first : first + SETTLED, rock] - np.nanmean(late, axis=0)
            out.append(row / one.pixel[first, rock])
    if len(out) < 2:
        return np.full((SETTLED, 4), np.nan)
    rows = np.array(out)
    count = np.maximum(np.isfinite(rows[..., 0]).sum(axis=0), 2)[:, None]
    error = np.nanstd(rows, axis=0, ddof=1) / np.sqrt(count)
    return np.concatenate((np.nanmean(rows, axis=0), error), axis=1)


def wanders(looks: list[Looks]) -> tuple[Array, Array]:
    """Return what centres wander by, in radii after a radian.

    Returns
    -------
    own
        Of rocks, along the Sun and across (2,), what differs from look to look taken off.
    shared
        Of all rocks together, along and across (2,).
    """
    own, shared = [], []
    for one in looks:
        dot = np.einsum("kij,kij->ki", one.sight[LAG:], one.sight[:-LAG])
        turn = np.arccos(np.clip(dot, -1.0, 1.0))
        change = (one.off[LAG:] - one.off[:-LAG]) / one.radius[:, None]
        noise = (one.said[LAG:] ** 2 + one.said[:-LAG] ** 2) / one.radius[:, None] ** 2
        for move, said, angle in zip(change, noise, turn, strict=True):
            both = np.isfinite(move).all(1) & (np.abs(move) < 1.2).all(1)
            if both.sum() < FEWEST or angle[both].mean() < LEAST_TURN:
                continue
            mean, angle_mean = move[both].mean(axis=0), angle[both].mean()
            spread = move[both].var(axis=0, ddof=1)
            own.append((spread - said[both].mean(axis=0)) / angle_mean)
            shared.append((mean**2 - spread / both.sum()) / angle_mean)
    if not own:
        return np.full(2, np.nan), np.full(2, np.nan)
    roots = [np.sqrt(np.maximum(np.mean(v, axis=0), 0.0)) for v in (own, shared)]
    return roots[0], roots[1]


def shapes(looks: list[Looks]) -> tuple[float, float, int]:
    """Return what many looks do not average out, and of how many rocks it was found.

    Scatter between rocks of the mean radius, over the radius, and root mean square of how far the
    mean place is off on an axis, in radii; of rocks with `MANY` looks or more, what looks differ by
    taken off.
    """
    sizes, places = [], []
    for one in looks:
        count = np.isfinite(one.ratio).sum(axis=0)
        some = count >= MANY
        ratio = one.ratio[:, some]
        place = one.off[:, some] / one.radius[some, None]
        noise = np.nanvar(ratio, axis=0, ddof=1) / count[some]
        spread = (np.nanvar(place, axis=0, ddof=1) / count[some, None]).mean(axis=1)
        sizes.append(np.column_stack((np.nanmean(ratio, axis=0), noise)))
        mean = np.nanmean(place, axis=0)
        mean = mean - mean.mean(axis=0)
        places.append((mean**2).mean(axis=1) - spread)
    size, place = np.concatenate(sizes), np.concatenate(places)
    if len(size) < 2:
        return np.nan, np.nan, len(size)
    left = size[:, 0].var(ddof=1) - size[:, 1].mean()
    return float(np.sqrt(max(left, 0.0))), float(np.sqrt(max(place.mean(), 0.0))), len(size)


def show(looks: list[Looks], console: Console) -> None:
    """Print the tables."""
    rows = look_to_look(looks)
    table = Table(title="From look to look")
    for heading in ("pixels a radius", "looks", "along the Sun (pixels)", "across (pixels)",
                    "along, over what is said", "across, over what is said"):  # fmt: skip
        table.add_column(heading, justify="right")
    for low, high in pairwise(EDGES):
        at = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(at) < 2:
            continue
        along, across, along_px, across_px = np.sqrt(np.mean(at[:, 1:] ** 2, axis=0))
        table.add_row(f"{low:g} - {high:g}", f"{len(at)}", f"{along_px:.2f}", f"{across_px:.2f}",
                      f"{along:.2f}", f"{across:.2f}")  # fmt: skip
    console.print(table)
    table = Table(title="After the first look that could begin a rock, against settled ones")
    for heading in ("look", "along the Sun (pixels)", "across (pixels)"):
        table.add_column(heading, justify="right")
    for k, (along, across, e, f) in enumerate(after_the_first(looks)):
        table.add_row(f"{k + 1}", f"{along:+.2f} ± {e:.2f}", f"{across:+.2f} ± {f:.2f}")
    console.print(table)
    own, shared = wanders(looks)
    console.print(
        f"Wander as the view turns, radii after a radian: a rock's own {own[0]:.2f} along the Sun, "
        f"{own[1]:.2f} across; of all {shared[0]:.2f} along, {shared[1]:.2f} across"
    )
    radius, centre, rocks = shapes(looks)
    console.print(
        f"Left by {MANY} looks and more, of {rocks} rocks: radius {radius:.2f} of itself, centre "
        f"{centre:.2f} radii an axis"
    )


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=4, show_default=True,
              help="Each with a path of its own.")  # fmt: skip
@click.option("--shape", type=click.Choice(SHAPES), default="cube", show_default=True,
              help="Of the rocks, which the detector knows.")  # fmt: skip
@click.option("--sun-elevation", type=click.FloatRange(2.0, 80.0), default=20.0, show_default=True,
              help="deg")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
def main(fields: int, shape: str, sun_elevation: float, seed: int) -> None:
    """Measure what centres of rocks differ by from look to look, and as the view turns."""
    elevation = np.radians(sun_elevation)
    model = ShadowModel(elevation, model_of(shape))
    looks = []
    for k in track(range(fields), description="fields"):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(k,)))
        looks.append(descend(make_world(shape, elevation, rng), model, rng))
    show(looks, plain_console(120))


if __name__ == "__main__":
    main()
