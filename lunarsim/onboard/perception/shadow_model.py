"""Model of the dark patch of a rock as seen from a given direction.

A camera sees two dark parts of a rock: the side away from the Sun, and the visible part of the
shadow on the terrain behind the rock. Projected along the line of sight onto the terrain they form
one dark patch. Its size in units of the rock's radius depends only on the directions of Sun and
camera and on the shape. The shadow EKF paper (III.A) assumes half spheres seen from above. Here
the patch of any population of shapes is tabulated by ray casting; for half spheres from above this
reproduces the paper's model, from the centre to the tip at radius / sin(Sun elevation).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import ndtr

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.onboard.perception._table_kernels import interpolate_table
from lunarsim.onboard.perception.table_cache import cached_table
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.rock_on_plane import RockOnPlane
from lunarsim.typing import Array

# Tabulated directions: depression of the camera, and azimuth from the Sun.
_DEPRESSIONS = np.radians([8.0, 15.0, 22.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0])
_AZIMUTHS = np.radians(np.arange(0.0, 181.0, 15.0))
_ROCKS_PER_SHAPE = 5
# Samples across a radius.
_SAMPLES_PER_RADIUS = 12
# Standard deviations of radius and centre (per axis), in radii, that many observations do not
# average out. `scenarios/shadows/rock_measurements.py` finds 0.09 and 0.37 for cubes, 0.15 to 0.16
# and 0.18 to 0.22 for irregular, mixed rocks and ellipsoids, 0.06 and 0.14 for half spheres.
_PERSISTENT_SIGMAS = (0.12, 0.28)
# A rock of radius 1 with less dark area is shadowless; number of samples to estimate their
# fraction.
_MIN_DARK_AREA, _SHADOWLESS_SAMPLES = 0.15, 64
# Ratio of the tangents of neighbouring tabulated Sun elevations.
_TANGENT_STEP = 1.1
MIN_SUN_ELEVATION = np.deg2rad(2.0)
MAX_SUN_ELEVATION = np.deg2rad(80.0)


@dataclass(frozen=True)
class ShadowPatch:
    """Dark patches of rocks of radius 1 on the terrain, seen from (...) directions.

    The origin is the rock's centre: `along` points to the azimuth of the Sun, `across` to its left
    as seen from above.

    Attributes
    ----------
    along, across
        Mean position along the azimuth of the Sun and across it, to the left (...).
    length, width
        Sides of the rectangle along the Sun with the same variances (...). End-to-end extents would
        depend on single pixels.
    skew
        Covariance of the two coordinates (...).
    area
        Dark area (...).
    along_sigma, across_sigma, length_sigma, width_sigma
        Standard deviations of position, length and width over the population of shapes (...).
    """

    along: Array
    across: Array
    length: Array
    width: Array
    skew: Array
    area: Array
    along_sigma: Array
    across_sigma: Array
    length_sigma: Array
    width_sigma: Array


class ShadowModel:
    """Model of the dark patches of rocks of given shapes under one Sun elevation.

    Parameters
    ----------
    elevation
        Sun elevation, rad, from 2 to 80 degrees.
    shapes
        Expected population of rocks; default: half spheres, as in the paper. The radius is half the
        diameter defined by `RockModel.draw`.

    Attributes
    ----------
    height
        Mean height of the rocks above the terrain, in radii.
    elongation
        Maximum half axis of a rock, in radii; half the side for a cube.
    longer_axis
        Mean and standard deviation of the longer half axis of a rock, in radii.
    slope
        Spread of the terrain slope, tangent; 0, since rocks stand on horizontal terrain.
    shadowless_fraction
        Fraction of the rocks without any dark area, from `faceted_shadowless_fraction`.
    outline
        Mean and standard deviation of the distance from a rock's centre to its outline, over all
        directions and shapes, in radii.
    radius_sigma, centre_sigma
        Uncertainty of radius and centre (per axis) due to the unknown shape that remains for any
        number of observations, in radii.

    Raises
    ------
    InputError
        If the Sun elevation is out of range.
    """

    slope = 0.0

    def __init__(self, elevation: float, shapes: RockModel | None = None) -> None:
        number = isinstance(elevation, float | int | np.floating)
        if not (number and MIN_SUN_ELEVATION <= elevation <= MAX_SUN_ELEVATION):
            raise InputError(
                "sun.elevation",
                elevation,
                "must be a number between 0.035 and 1.396 rad (2 and 80 deg)",
            )
        self.elevation = elevation
        self.shapes = shapes or RockModel()
        self._table = _tabulate(round(elevation, 3), self.shapes)
        drawn = self.shapes.draw(np.full(64, 2.0), np.random.default_rng(1972))
        self.height = float(np.mean(drawn.base + drawn.height))
        round_or_square = self.shapes.shape in {"hemisphere", "cube"}
        faceted = {"irregular": 1.0, "mixed": 0.5}.get(self.shapes.shape, 0.0)
        self.shadowless_fraction = (
            faceted * faceted_shadowless_fraction(round(elevation, 3)) if faceted else 0.0
        )
        self.elongation = 1.0 if round_or_square else float(self.shapes.axis_ratio[0] ** -0.5)
        self.longer_axis = (1.0, 0.0) if round_or_square else _longer_axis(*self.shapes.axis_ratio)
        self.outline, self.radius_sigma, self.centre_sigma = _outline(self.shapes)

    def under(self, elevation: float) -> ShadowModel:
        """Return the model of the same shapes under another Sun elevation (rad).

        The elevation is rounded to the steps of `tabulated_elevation`.
        """
        nearest = tabulated_elevation(elevation, self.elevation)
        return self if nearest == self.elevation else _model_under(nearest, self.shapes)

    def probability_longer_than(self, half_axis: float, radius: Array, sigma: Array) -> Array:
        """Return the probability that the longer half axis of rocks exceeds a value (n,).

        Parameters
        ----------
        half_axis
            Limit of the half axis, m.
        radius, sigma
            Radii of discs with the area of the rocks, and their standard deviations, positive (n,),
            m.
        """
        mean, spread = self.longer_axis
        unknown = np.hypot(mean * sigma, spread * radius)
        return np.asarray(ndtr((mean * radius - half_axis) / unknown))

    def patch(self, azimuth: Any, depression: Any) -> ShadowPatch:
        """Return the dark patches of rocks of radius 1 seen from given directions.

        Parameters
        ----------
        azimuth
            Azimuth of the camera from the rock minus that of the Sun (...), rad, clockwise from
            above; 0: the Sun is behind the camera.
        depression
            Depression of the line of sight below the horizon (...), rad.
        """
        relative_azimuth = (
            np.mod(np.asarray(azimuth, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi
        )
        down = np.clip(depression, _DEPRESSIONS[0], _DEPRESSIONS[-1])
        relative_azimuth, down = np.broadcast_arrays(relative_azimuth, down)
        columns = interpolate_table(
            self._table, _AZIMUTHS, _DEPRESSIONS, abs(relative_azimuth).ravel(), down.ravel()
        )
        along, across, length, width, skew, *rest = (
            c.reshape(relative_azimuth.shape) for c in columns
        )
        across, skew = (np.where(relative_azimuth < 0.0, -v, v) for v in (across, skew))
        return ShadowPatch(along, across, length, width, skew, *rest)

    def visible_q(self, radius: Any, azimuth: Any, depression: Any, pixel: Any) -> Array:
        """Return q, the square root of the number of dark pixels of a rock's patch (...).

        Parameters
        ----------
        radius
            Radius of the rocks (...), m.
        azimuth, depression
            Azimuth of the camera from the rock minus that of the Sun, and depression of the line of
            sight (...), rad.
        pixel
            Size of a pixel across the line of sight at the rock (...), m.
        """
        # Terrain above the camera is not visible.
        area = self.patch(azimuth, depression).area * np.sin(np.maximum(depression, 0.0))
        return np.asarray(np.asarray(radius) * np.sqrt(area) / pixel)


def _longer_axis(min_ratio: float, max_ratio: float) -> tuple[float, float]:
    """Return mean and standard deviation of the longer half axis of rocks, in radii.

    It is r^-1/2 for an axis ratio r that is uniform between `min_ratio` and `max_ratio`.
    """
    if max_ratio - min_ratio < 1e-6:
        return min_ratio**-0.5, 0.0
    mean = 2.0 * (np.sqrt(max_ratio) - np.sqrt(min_ratio)) / (max_ratio - min_ratio)
    square = np.log(max_ratio / min_ratio) / (max_ratio - min_ratio)
    return float(mean), float(np.sqrt(max(square - mean**2, 0.0)))


@lru_cache(maxsize=128)
def _model_under(elevation: float, shapes: RockModel) -> ShadowModel:
    """Return the cached shadow model of given shapes for a Sun elevation (rad)."""
    return ShadowModel(elevation, shapes)


def tabulated_elevation(elevation: float, reference: float) -> float:
    """Return the nearest Sun elevation, rad, for which shadow tables are computed.

    The tangents of these elevations differ from that of `reference`, rad, by powers of 1.1, so the
    length of shadows is accurate to 5 %. The result lies between 2 and 80 degrees, also if the Sun
    is below a plane that slopes away from it.
    """
    elevation = float(np.clip(elevation, MIN_SUN_ELEVATION, MAX_SUN_ELEVATION))
    steps = round(np.log(np.tan(elevation) / np.tan(reference)) / np.log(_TANGENT_STEP))
    nearest = float(np.arctan(np.tan(reference) * _TANGENT_STEP**steps)) if steps else reference
    return float(np.clip(nearest, MIN_SUN_ELEVATION, MAX_SUN_ELEVATION))


@lru_cache(maxsize=16)
def faceted_shadowless_fraction(
    elevation: float, height_ratio: tuple[float, float] = RockModel.height_ratio
) -> float:
    """Return the fraction of faceted rocks without dark areas at a Sun elevation, rad.

    The higher the Sun, the more rocks have all faces lit and no shadow beyond their outline: 1 of
    60 at 45 deg, 1 of 5 at 60 deg, fewer for higher rocks. `height_ratio` gives mean and deviation
    of height over width. Rounded rocks and cubes always have a dark side.
    """
    shapes = RockModel("irregular", height_ratio=height_ratio, burial=(0.0, 0.0))
    field = shapes.draw(np.full(_SHADOWLESS_SAMPLES, 2.0), np.random.default_rng(1969))
    sun = direction_from_angles(0.0, elevation)
    above = np.array([0.0, 0.0, 1.0])
    reach = shadow_reach(elevation)
    dark = [_dark_patch(RockOnPlane(field, k), sun, above, reach)[-1] for k in range(len(field))]
    return float(np.mean(np.array(dark) < _MIN_DARK_AREA))


def shadow_reach(elevation: float) -> float:
    """Return how far the dark patch of a rock of radius 1 extends away from the Sun.

    `elevation` is that of the Sun, rad; the result is an upper bound, in radii.
    """
    return 1.6 * (1.0 + 1.0 / float(np.tan(elevation))) + 0.5


@lru_cache(maxsize=128)
def _tabulate(elevation: float, shapes: RockModel) -> Array:
    """Return the cached table of dark patches for a Sun elevation (rad) and shapes.

    The table (azimuths, depressions, 10) contains the fields of `ShadowPatch`.
    """
    key = f"{elevation!r} {shapes!r}"
    return cached_table("shadows", key, lambda: _compute_table(elevation, shapes))


def _compute_table(elevation: float, shapes: RockModel) -> Array:
    """Compute the table of dark patches for a Sun elevation (rad) by ray casting.

    The table (azimuths, depressions, 10) contains the fields of `ShadowPatch`.
    """
    rng = np.random.default_rng(1953)
    one = shapes.shape == "hemisphere"
    field = shapes.draw(np.full(1 if one else _ROCKS_PER_SHAPE, 2.0), rng)
    table = np.empty((_AZIMUTHS.size, _DEPRESSIONS.size, 10))
    scenes = [RockOnPlane(field, k) for k in range(len(field))]
    sun = direction_from_angles(0.0, elevation)
    reach = shadow_reach(elevation)
    for i, azimuth in enumerate(_AZIMUTHS):
        for j, depression in enumerate(_DEPRESSIONS):
            camera = direction_from_angles(azimuth, depression)
            seen = np.array([_dark_patch(scene, sun, camera, reach) for scene in scenes])
            table[i, j] = np.concatenate((seen.mean(0), seen.std(0)[:4]))
    return table


def visible_points_around_rock(
    scene: RockOnPlane, camera: Array, reach: float, step: float
) -> tuple[tuple[int, int], Array, Array, Array]:
    """Return the points of rock or terrain that a camera sees around a rock.

    The lines of sight lead to a grid of positions on the terrain. Where the rock, of radius 1,
    hides a position, the visible point is on the rock.

    Parameters
    ----------
    scene
        Rock; the Sun is in the north.
    camera
        Direction towards the camera (3,).
    reach
        Maximum length of the shadow, to the south.
    step
        Spacing of the positions.

    Returns
    -------
    shape
        Rows and columns of the positions.
    position, point, normal
        Positions on the terrain, the visible point on the line of sight to each, slightly above
        the surface, and the surface normal there (n, 3).
    """
    lean = 2.0 * camera[:2] / camera[2]
    x = np.arange(min(0.0, -lean[0]) - 1.6, max(0.0, -lean[0]) + 1.6, step)
    y = np.arange(min(-reach, -lean[1] - 1.6), max(0.0, -lean[1]) + 1.6, step)
    xx, yy = np.meshgrid(x, y)
    position = np.column_stack((xx.ravel(), yy.ravel(), np.zeros(xx.size)))
    start = position + 60.0 * camera
    distance, normal = scene.cast(start, np.broadcast_to(-camera, start.shape))
    return xx.shape, position, start - distance[:, None] * camera + 1e-4 * normal, normal


def _dark_patch(scene: RockOnPlane, sun: Array, camera: Array, reach: float) -> tuple[float, ...]:
    """Return position, length, width, skew and area of the dark patch of a rock.

    The rock has radius 1. `sun` and `camera` (3,) are directions, and `reach` is the maximum length
    of the shadow. The results are along, across, length, width, skew and area as in `ShadowPatch`.
    The Sun is in the north, so `along` is y and `across`, to its left, is -x. `scene` is the rock
    on a plane.
    """
    step = 1.0 / _SAMPLES_PER_RADIUS
    _, position, point, normal = visible_points_around_rock(scene, camera, reach, step)
    lit = normal @ sun > 0.0
    shaded = np.ones(len(point), bool)
    towards = np.broadcast_to(sun, (int(lit.sum()), 3))
    shaded[lit] = np.isfinite(scene.cast(point[lit], towards)[0])
    if not shaded.any():
        # Nothing is visible: a patch without extent at the centre.
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    along, across = position[shaded, 1], -position[shaded, 0]
    return (
        along.mean(), across.mean(), np.sqrt(12.0) * along.std(), np.sqrt(12.0) * across.std(),
        np.mean(along * across) - along.mean() * across.mean(), float(shaded.sum()) * step**2,
    )  # fmt: skip


@lru_cache(maxsize=8)
def _outline(shapes: RockModel) -> tuple[tuple[float, float], float, float]:
    """Return outline, radius and centre uncertainty of rocks, as in `ShadowModel`.

    The outline is mean and standard deviation of the distance from the centre to the outline. All
    are in radii.
    """
    if shapes.shape == "hemisphere":
        return (1.0, 0.0), *_PERSISTENT_SIGMAS
    field = shapes.draw(np.full(64, 2.0), np.random.default_rng(1972))
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    radius = np.linspace(0.02, 2.4, 240)
    points = radius[:, None, None] * np.stack((np.cos(angle), np.sin(angle)), -1)
    reach = np.empty((len(field), angle.size))
    for k in range(len(field)):
        inside = RockOnPlane(field, k).covers(points)
        reach[k] = radius[:, None].repeat(angle.size, 1).max(0, where=inside, initial=0.0)
    return (float(reach.mean()), float(reach.std())), *_PERSISTENT_SIGMAS
