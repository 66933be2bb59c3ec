"""Terrain beyond the map: coarser fractal or measured levels on a spherical Moon.

A point is located by its arc east and north of the map's origin on the sphere. Each level fades
out towards its edge, and heights at the map's edge blend into the surrounding level, so that the
height above the sphere is continuous. A level is built when it is first needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_raster_size
from lunarsim.models.gravity import CentralGravity
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.rng import RandomStreams
from lunarsim.typing import Array
from lunarsim.world.terrain import Heightfield, RayHits, Terrain, fractal_relief

_MAX_POSTS_PER_SIDE = 4_000
Numbers = float | tuple[float, ...]
# Samples along a ray before bisection of the first crossing, and bisection steps.
_SAMPLES, _BISECTIONS = 400, 40


@dataclass(frozen=True)
class FarTerrainSettings:
    """Settings of the terrain beyond the map: nested square grids ("levels").

    The height beyond the map is the sum of all levels. Each level is a fractal heightfield; the
    raster at `path`, if given, is the first level, with its middle at the map's origin.
    """

    sizes: tuple[float, ...] = quantity(
        (40_960.0, 1_024_000.0),
        "m",
        gt=0,
        help="sides of the nested terrain squares around the map; the square with the finest grid "
        "is first",
    )
    postings: tuple[float, ...] = quantity(
        (40.0, 1_000.0),
        "m",
        gt=0,
        help="grid spacing of each nested terrain square, in the order of sizes_m",
    )
    rms_slopes: tuple[float, ...] = quantity(
        (3.0, 1.0),
        "deg",
        ge=0,
        lt=45,
        help="RMS slope of each nested terrain square over a baseline of its grid spacing, in the "
        "order of sizes_m",
    )
    hurst: float = quantity(0.8, gt=0, lt=1, help="Hurst exponent of all nested terrain squares")
    margin: float = quantity(
        0.3,
        gt=0,
        le=1,
        help="width of the strip inside each edge of the map, and of each finer square, in which "
        "heights change to those of the coarser terrain; as a fraction of half its side",
    )
    path: Path | None = quantity(
        None,
        help="elevation raster file of the terrain square with the finest grid, relative to the "
        "scenario file; omitted: fractal terrain",
    )
    dtm_posting: float | None = quantity(
        None,
        "m",
        gt=0,
        help="grid spacing of the elevation raster if the file has no georeferencing; if the file "
        "has it but no square grid: spacing to which the raster is resampled; omitted: as in the "
        "file",
    )
    dtm_unit: str | None = quantity(
        None,
        help="unit of the raster's heights: m, km, ft or us-ft; omitted: unit stated in the file",
    )
    dtm_nodata: Numbers | None = quantity(
        None,
        help="raster values that mark missing heights, in addition to those stated in the file; "
        "[]: none; omitted: none, but a raster is rejected if some of its heights are outliers, "
        "such as -9999, that can be such marks",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "far_terrain")
        for name in ("postings", "rms_slopes"):
            if len(getattr(self, name)) != len(self.sizes):
                count = len(getattr(self, name))
                raise InputError(
                    f"far_terrain.{name}", getattr(self, name),
                    f"must have as many values as sizes_m, which has {len(self.sizes)}, but has "
                    f"{count}", show_value=False,
                )  # fmt: skip
        for size, posting in zip(self.sizes, self.postings, strict=True):
            check_raster_size("far_terrain.sizes", size, posting, _MAX_POSTS_PER_SIDE, "points")

    def posts_read(self) -> int:
        """Return the number of raster points stated in the file's header.

        Without a raster the number is 0.

        Raises
        ------
        InputError
            If the file cannot be opened.
        """
        from lunarsim.world.terrain.dtm import read_size  # noqa: PLC0415  (rasterio loads slowly)

        return read_size(self.path, posting=self.dtm_posting).posts if self.path else 0

    def build(self, terrain: Terrain, moon: CentralGravity, streams: RandomStreams) -> FarTerrain:
        """Return the terrain around the map of one flight.

        `terrain` is the map, `moon` the sphere; `streams` are the flight's random streams, from
        which the fractal levels are sampled.
        """

        @cache
        def level(n: int) -> Heightfield:
            if n == 0 and self.path is not None:
                return _load_measured(self)
            grid = Grid.centred((0.0, 0.0), self.sizes[n], self.postings[n])
            drawn = fractal_relief(
                grid, streams.get(f"surroundings.{n}"), hurst=self.hurst,
                rms_slope=self.rms_slopes[n], baseline=self.postings[n],
            )  # fmt: skip
            return Heightfield(grid, drawn.z - drawn.z[grid.rows // 2, grid.cols // 2])

        return FarTerrain(terrain, moon, self, level)


def _load_measured(settings: FarTerrainSettings) -> Heightfield:
    """Load the raster of the first level, shifted to height 0 at its centre.

    The centre of the raster is placed at the origin of the map.
    """
    from lunarsim.world.terrain.dtm import load_terrain  # noqa: PLC0415  (rasterio loads slowly)

    assert settings.path is not None
    try:
        z = load_terrain(
            settings.path, posting=settings.dtm_posting, unit=settings.dtm_unit,
            nodata=settings.dtm_nodata,
        )  # fmt: skip
    except InputError as error:  # the keys have the same names in [terrain]
        field, problem, remedy = (
            text.replace("terrain.", "far_terrain.")
            for text in (error.field, error.problem, error.remedy)
        )
        raise InputError(field, error.value, problem, remedy, error.show_value) from None
    if not np.isfinite(z.z).all():
        raise InputError(
            "far_terrain.path",
            str(settings.path),
            "must be a raster without gaps",
            "Fill its gaps or choose another raster.",
        )
    g = z.grid
    x0, y0 = (-0.5 * (n - 1) * g.posting for n in (g.cols, g.rows))
    middle = z.z[g.rows // 2, g.cols // 2]
    return Heightfield(Grid(x0, y0, g.posting, g.rows, g.cols), z.z - middle)


def _smoothstep(x: Array) -> Array:
    """Return 1 - 3 x^2 + 2 x^3, which falls smoothly from 1 at x <= 0 to 0 at x >= 1."""
    s = np.clip(x, 0.0, 1.0)
    return np.asarray(1.0 - s * s * (3.0 - 2.0 * s))


@dataclass(frozen=True)
class FarTerrain:
    """Terrain of a map and of its surroundings on a spherical Moon.

    The surroundings are nested square heightfields ("levels"), built by `FarTerrainSettings`.

    Attributes
    ----------
    terrain
        Terrain of the map.
    moon
        Sphere and central gravity.
    settings
        Sizes and blending margins.
    level
        Function that returns a level by its number and builds it on first use.
    """

    terrain: Terrain
    moon: CentralGravity
    settings: FarTerrainSettings
    level: Callable[[int], Heightfield] = field(repr=False, compare=False)

    def surface_arc(self, position: ArrayLike) -> Array:
        """Return surface coordinates (..., 2) of the points below positions (..., 3).

        Positions are ENU, m. The coordinates are the arc lengths east and north from the map's
        origin along the sphere, m.
        """
        r = self.moon.position_from_centre(position)
        lateral = np.hypot(r[..., 0], r[..., 1])
        arc = self.moon.radius * np.arctan2(lateral, r[..., 2])
        unit = r[..., :2] / np.maximum(lateral, 1e-12)[..., None]
        return np.asarray(unit * arc[..., None])

    def elevation(self, arc: ArrayLike) -> Array:
        """Return the terrain height above the sphere (...,), m, at surface points.

        `arc` (..., 2) are arc lengths east and north, m, as returned by `surface_arc`. On the map
        the height is that of the map; beyond its edge it blends into the sum of the levels.
        """
        xy = np.asarray(arc, dtype=np.float64)
        flat_arc = xy.reshape(-1, 2)
        west, east, south, north = self.terrain.bounds
        edge = np.clip(flat_arc, (west, south), (east, north))
        beyond = np.hypot(*(flat_arc - edge).T)
        over = self.settings.margin * 0.5 * min(east - west, north - south)
        share = _smoothstep(beyond / over)
        z = np.zeros(len(flat_arc))
        outside = beyond > 0.0
        if outside.any():
            z[outside] = (1.0 - share[outside]) * self._sum_levels(flat_arc[outside])
        near = share > 0.0
        if near.any():
            # The map is flat: the sphere curves down below it.
            drop = (edge[near] ** 2).sum(axis=1) / (2.0 * self.moon.radius)
            z[near] += share[near] * (self.terrain.elevation(edge[near]) + drop)
        return z.reshape(xy.shape[:-1])

    def _sum_levels(self, arc: Array) -> Array:
        """Return the summed heights (n,), m, of all levels at arc lengths `arc` (n, 2)."""
        z = np.zeros(len(arc))
        for n, size in enumerate(self.settings.sizes):
            max_offset = np.abs(arc).max(axis=1)
            half = 0.5 * size
            inside = max_offset < half
            if not inside.any():
                continue
            one = self.level(n)
            half = min(half, -one.grid.x0, -one.grid.y0)
            share = _smoothstep((max_offset / half - 1.0) / self.settings.margin + 1.0)
            g = one.grid
            at = (arc[:, 1] - g.y0) / g.posting, (arc[:, 0] - g.x0) / g.posting
            z += share * ndimage.map_coordinates(one.z, at, order=1, mode="nearest")
        return z

    def clearance(self, position: ArrayLike) -> Array:
        """Return the heights (...,), m, of positions (..., 3), ENU, above the terrain."""
        return np.asarray(self.moon.height(position) - self.elevation(self.surface_arc(position)))

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Intersect rays from one point with the terrain on the spherical Moon.

        Parameters
        ----------
        origin
            Start of all rays (3,), ENU, m.
        direction
            Unit vectors (n, 3), ENU.
        max_range
            Maximum range, m; more distant hits are misses.

        Returns
        -------
        RayHits
            Range, surface normal and rock index (-1 terrain, -2 miss) of each ray.
        """
        origin = np.asarray(origin, dtype=np.float64)
        rays = np.atleast_2d(np.asarray(direction, dtype=np.float64))
        found = np.array([self._first_hit_range(origin, ray, max_range) for ray in rays])
        points = origin + np.where(np.isfinite(found), found, 0.0)[:, None] * rays
        normal = np.where(np.isfinite(found)[:, None], self._normal(points), np.nan)
        rock = np.where(np.isfinite(found), -1, -2).astype(np.int32)
        return RayHits(found, normal, rock)

    def _first_hit_range(self, origin: Array, ray: Array, max_range: float) -> float:
        """Return the range, m, at which one ray first hits the terrain; NaN if it misses.

        The clearance is sampled along the ray, and the first crossing is bisected.
        """
        r = self.moon.position_from_centre(origin)
        along, height = float(r @ ray), float(self.moon.height(origin))
        # Terrain lies above a sphere 20 km below the datum: no hit lies beyond that sphere.
        low = self.moon.radius - 20_000.0
        root = along * along - float(r @ r) + low * low
        far = -along - np.sqrt(root) if root > 0.0 else -along
        far = min(max_range, far)
        if along >= 0.0 or (height < 0.0 and far <= 0.0):
            return float("nan")
        t = np.linspace(0.0, far, _SAMPLES)
        under = np.flatnonzero(self.clearance(origin + t[:, None] * ray) <= 0.0)
        if len(under) == 0 or under[0] == 0:
            return float("nan")
        a, b = t[under[0] - 1], t[under[0]]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (a + b)
            above = self.clearance(origin + middle * ray) > 0.0
            a, b = (middle, b) if above else (a, middle)
        return float(0.5 * (a + b))

    def _normal(self, points: Array) -> Array:
        """Return terrain normals below points (n, 3), ENU, from differences over 1 m."""

        def rise(step: Array) -> Array:
            ahead, behind = self.surface_arc(points + step), self.surface_arc(points - step)
            return self.elevation(ahead) - self.elevation(behind)

        slope = np.stack([rise(0.5 * e) for e in np.eye(3)], axis=-1)
        out = self.moon.up(points) - slope
        return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))

    @property
    def nbytes(self) -> int:
        """Memory of the map and of all levels, bytes; builds the levels."""
        made = (self.level(n) for n in range(len(self.settings.sizes)))
        return self.terrain.nbytes + sum(one.z.nbytes for one in made)
