"""Terrain beyond the map: coarser fractal or measured levels.

The Moon is flat or a sphere. A point is located by its arc east and north of the map's origin on
the sphere; on a flat Moon, by its coordinates. Each level fades out towards its edge, and heights
at the map's edge blend into the surrounding level, so that the height above the datum is
continuous. A level is built when it is first needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_raster_size
from lunarsim.models.gravity import CentralGravity
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.rng import RandomStreams
from lunarsim.typing import Array, BoolArray
from lunarsim.world import _far_terrain_kernels as kernels
from lunarsim.world.terrain import Heightfield, RayHits, Terrain, fractal_relief

_MAX_POSTS_PER_SIDE = 4_000
Numbers = float | tuple[float, ...]
# Local frame of a raster (`raster_frame.Frame`) and its coordinate reference system.
MapFrame = tuple[Any, Any]
# Maximum number of points of the map along a side at which heights are compared with a raster.
_MAX_COMPARED = 256
# A ray to the far terrain takes about this time, microseconds.
_RAY_TIME_US = 4.0


@dataclass(frozen=True)
class FarTerrainSettings:
    """Settings of the terrain beyond the map: nested square grids ("levels").

    The height beyond the map is the sum of all levels. Each level is a fractal heightfield; the
    raster at `path`, if given, is the first level.

    Attributes
    ----------
    centre
        Position of the raster's centre (east, north), m. None: if raster and map have a coordinate
        reference, the raster lies where they state; otherwise its centre is the map's origin.
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
    centre: tuple[float, float] | None = quantity(
        None,
        "m",
        help="position of the raster's centre relative to the map's origin (east, north); omitted: "
        "by the coordinate references of raster and map, or the map's origin if one has none",
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
        if self.centre is not None and self.path is None:
            raise InputError(
                "far_terrain.centre", self.centre, "places the raster at far_terrain.path, but "
                "there is none", "Delete the key, or name a raster.",
            )  # fmt: skip

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

    def build(
        self, terrain: Terrain, moon: CentralGravity | None, streams: RandomStreams,
        map_frame: MapFrame | None = None,
    ) -> FarTerrain:  # fmt: skip
        """Return the terrain around the map of one flight.

        Parameters
        ----------
        terrain, moon
            Terrain of the map, and the sphere; None: flat.
        streams
            Random streams of the flight, from which the fractal levels are sampled.
        map_frame
            Local frame and coordinate reference system of a measured map, by which a raster is
            placed; None: none.
        """
        is_placed = self.path is not None and (self.centre is not None or _has_crs(self, map_frame))

        @cache
        def level(n: int) -> Heightfield:
            if n == 0 and is_placed:
                frame = map_frame if self.centre is None else None
                return _placed_raster(self, terrain, moon, frame)
            if n == 0 and self.path is not None:
                return _load_measured(self)
            grid = Grid.centred((0.0, 0.0), self.sizes[n], self.postings[n])
            drawn = fractal_relief(
                grid, streams.get(f"surroundings.{n}"), hurst=self.hurst,
                rms_slope=self.rms_slopes[n], baseline=self.postings[n],
            )  # fmt: skip
            return Heightfield(grid, drawn.z - drawn.z[grid.rows // 2, grid.cols // 2])

        return FarTerrain(terrain, moon, self, level, is_placed)


def _load_measured(settings: FarTerrainSettings) -> Heightfield:
    """Load the raster of the first level, shifted to height 0 at its centre.

    The centre of the raster is placed at the origin of the map.
    """
    field = _load_raster(settings, None)
    _check_gaps(settings, np.isfinite(field.z))
    g = field.grid
    x0, y0 = (-0.5 * (n - 1) * g.posting for n in (g.cols, g.rows))
    middle = field.z[g.rows // 2, g.cols // 2]
    return Heightfield(Grid(x0, y0, g.posting, g.rows, g.cols), field.z - middle)


def _has_crs(settings: FarTerrainSettings, map_frame: MapFrame | None) -> bool:
    """Return whether map and raster have a coordinate reference system."""
    from lunarsim.world.terrain.dtm import read_frame  # noqa: PLC0415  (rasterio loads slowly)

    assert settings.path is not None
    if map_frame is None or map_frame[1] is None:
        return False
    return read_frame(settings.path, posting=settings.dtm_posting)[1] is not None


def _load_raster(settings: FarTerrainSettings, map_frame: MapFrame | None) -> Heightfield:
    """Load the raster of the first level, in its frame or in that of the map.

    Without a frame of the map, the origin is the raster's centre.
    """
    from lunarsim.world.terrain import dtm  # noqa: PLC0415  (rasterio loads slowly)

    assert settings.path is not None
    options: dict[str, Any] = {
        "posting": settings.dtm_posting, "unit": settings.dtm_unit, "nodata": settings.dtm_nodata
    }  # fmt: skip
    try:
        if map_frame is not None:
            return dtm.load_around_map(settings.path, map_frame, 0.5 * settings.sizes[0], **options)
        return dtm.load_terrain(settings.path, **options)
    except InputError as error:  # the keys have the same names in [terrain]
        name, problem, remedy = (
            text.replace("terrain.", "far_terrain.")
            for text in (error.field, error.problem, error.remedy)
        )
        raise InputError(name, error.value, problem, remedy, error.show_value) from None


def _check_gaps(settings: FarTerrainSettings, known: BoolArray) -> None:
    """Raise InputError unless all heights (rows, cols) of the raster are known."""
    if not known.all():
        raise InputError(
            "far_terrain.path",
            str(settings.path),
            "must be a raster without gaps",
            "Fill its gaps or choose another raster.",
        )


def _placed_raster(
    settings: FarTerrainSettings, terrain: Terrain, moon: CentralGravity | None,
    map_frame: MapFrame | None,
) -> Heightfield:  # fmt: skip
    """Return the raster of the first level at its place, with the height of the map.

    Heights fade to 0 towards the edges of the raster and of the level. Their mean over the map is
    that of the map: the files may have different height references, and both are loaded without
    their mean. A raster that covers nothing of the map has the mean 0.
    """
    field = _load_raster(settings, map_frame)
    east, north = (0.0, 0.0) if settings.centre is None else settings.centre
    g = field.grid
    grid = Grid(g.x0 + east, g.y0 + north, g.posting, g.rows, g.cols)
    half = 0.5 * settings.sizes[0]
    col, row = (np.flatnonzero(np.abs(v) <= half) for v in (grid.x, grid.y))
    if min(len(col), len(row)) < 2:
        raise InputError(
            "far_terrain.centre_m", [east, north],
            f"must place the raster in the square of {settings.sizes[0]:g} m around the map",
            "Change it, or the first of far_terrain.sizes_m.",
        )  # fmt: skip
    z = field.z[row[0] : row[-1] + 1, col[0] : col[-1] + 1].astype(np.float64)
    grid = Grid(grid.x[col[0]], grid.y[row[0]], g.posting, *z.shape)
    known = np.isfinite(z)
    # A raster that is not north up has unknown corners, which are no gaps.
    _check_gaps(settings, known | ~ndimage.binary_fill_holes(known))
    z -= _height_above_map(Heightfield(grid, z.astype(np.float32)), terrain, moon)
    width = settings.margin * 0.5 * min(settings.sizes[0], *(g.posting * n for n in z.shape))
    distance = ndimage.distance_transform_edt(np.pad(known, 1))[1:-1, 1:-1] - 1.0
    share = _smoothstep(1.0 - distance * g.posting / width)
    return Heightfield(grid, np.where(known, share * z, 0.0).astype(np.float32))


def _height_above_map(field: Heightfield, terrain: Terrain, moon: CentralGravity | None) -> float:
    """Return the mean height, m, of a raster above the map, or its mean height.

    The latter is for a raster that covers nothing of the map.
    """
    step = max(1, -(-max(terrain.relief.z.shape) // _MAX_COMPARED))
    g = terrain.relief.grid
    x, y = np.meshgrid(g.x[::step], g.y[::step])
    height = terrain.relief.z[::step, ::step].astype(np.float64)
    if moon is not None:  # the map is flat: the sphere curves down below it
        height = height + (x**2 + y**2) / (2.0 * moon.radius)
    at = (y - field.grid.y0) / field.grid.posting, (x - field.grid.x0) / field.grid.posting
    above = ndimage.map_coordinates(
        field.z.astype(np.float64), at, order=1, mode="constant", cval=np.nan
    )
    above = above - height
    compared = above if np.isfinite(above).any() else field.z
    return float(np.nanmean(compared))


def _smoothstep(x: Array) -> Array:
    """Return 1 - 3 x^2 + 2 x^3, which falls smoothly from 1 at x <= 0 to 0 at x >= 1."""
    s = np.clip(x, 0.0, 1.0)
    return np.asarray(1.0 - s * s * (3.0 - 2.0 * s))


@dataclass(frozen=True)
class FarTerrain:
    """Terrain of a map and of its surroundings on a flat or spherical Moon.

    The surroundings are nested square heightfields ("levels"), built by `FarTerrainSettings`.

    Attributes
    ----------
    terrain
        Terrain of the map.
    moon
        Sphere and central gravity; None: flat.
    settings
        Sizes and blending margins.
    level
        Function that returns a level by its number and builds it on first use.
    is_placed
        Whether the first level is a raster that fades out at its edges, wherever they are.
    shadows
        Kept shadows on the map, by direction and size of the Sun (`FarShadow.of`).
    """

    terrain: Terrain
    moon: CentralGravity | None
    settings: FarTerrainSettings
    level: Callable[[int], Heightfield] = field(repr=False, compare=False)
    is_placed: bool = False
    shadows: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def surface_arc(self, position: ArrayLike) -> Array:
        """Return surface coordinates (..., 2) of the points below positions (..., 3).

        Positions are ENU, m. The coordinates are the arc lengths east and north from the map's
        origin along the sphere, m.
        """
        if self.moon is None:
            return np.asarray(position, dtype=np.float64)[..., :2]
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
        near = share > 0.0
        height = self.terrain.elevation(edge[near])
        if self.moon is not None:  # the map is flat: the sphere curves down below it
            height = height + (edge[near] ** 2).sum(axis=1) / (2.0 * self.moon.radius)
        # Around missing heights at the edge of the map, the levels continue up to the edge.
        missing = np.isnan(height) & (beyond[near] > 0.0)
        share[near] = np.where(missing, 0.0, share[near])
        z = np.zeros(len(flat_arc))
        outside = beyond > 0.0
        if outside.any():
            z[outside] = (1.0 - share[outside]) * self._sum_levels(flat_arc[outside])
        z[near] += share[near] * np.where(missing, 0.0, height)
        return z.reshape(xy.shape[:-1])

    def _sum_levels(self, arc: Array) -> Array:
        """Return the summed heights (n,), m, of all levels at arc lengths `arc` (n, 2)."""
        z = np.zeros(len(arc))
        for n, size in enumerate(self.settings.sizes):
            max_offset = np.abs(arc).max(axis=1)
            if not (max_offset < 0.5 * size).any():
                continue
            one = self.level(n)
            share = _smoothstep(
                (max_offset / self._half_side(n) - 1.0) / self.settings.margin + 1.0
            )
            g = one.grid
            at = (arc[:, 1] - g.y0) / g.posting, (arc[:, 0] - g.x0) / g.posting
            z += share * ndimage.map_coordinates(one.z, at, order=1, mode="nearest")
        return z

    def _half_side(self, n: int) -> float:
        """Return the distance from the origin, m, at which level `n` has faded out.

        The distance is infinite if the heights themselves fade to 0.
        """
        if n == 0 and self.is_placed:
            return float("inf")
        g = self.level(n).grid
        return min(0.5 * self.settings.sizes[n], -g.x0, -g.y0)

    def clearance(self, position: ArrayLike) -> Array:
        """Return the heights (...,), m, of positions (..., 3), ENU, above the terrain."""
        at = np.asarray(position, dtype=np.float64)
        height = at[..., 2] if self.moon is None else self.moon.height(at)
        return np.asarray(height - self.elevation(self.surface_arc(at)))

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Intersect rays with the relief of the map and the terrain beyond it.

        Parameters
        ----------
        origin
            Start of the rays, (3,) for all or (n, 3), ENU, m.
        direction
            Unit vectors (n, 3), ENU.
        max_range
            Maximum range, m; more distant hits are misses.

        Returns
        -------
        RayHits
            Range, surface normal and rock index (-1 terrain, -2 miss) of each ray.
        """
        start = np.ascontiguousarray(np.atleast_2d(np.asarray(origin, dtype=np.float64)))
        rays = np.ascontiguousarray(np.atleast_2d(np.asarray(direction, dtype=np.float64)))
        found, normal = np.empty(len(rays)), np.empty((len(rays), 3))
        kernels.cast.run_loop(
            len(rays), _RAY_TIME_US, start, rays, float(max_range), self.surface, found, normal
        )
        rock = np.where(np.isfinite(found), -1, -2).astype(np.int32)
        return RayHits(found, normal, rock)

    @cached_property
    def surface(self) -> kernels.Surface:
        """Arrays of the map and of all levels, for compiled functions; builds the levels."""
        relief, margin = self.terrain.relief, self.settings.margin
        made = [self.level(n) for n in range(len(self.settings.sizes))]
        start = np.concatenate(([0], np.cumsum([one.z.size for one in made])))
        table = np.array(
            [
                (g.x0, g.y0, g.posting, g.rows, g.cols, first, self._half_side(n))
                for n, (g, first) in enumerate(
                    zip((one.grid for one in made), start[:-1], strict=True)
                )
            ]
        )
        west, east, south, north = self.terrain.bounds
        top = relief.z_range[1]
        radius = 0.0 if self.moon is None else self.moon.radius
        if self.moon is not None:
            top += max(west**2, east**2) / (2.0 * radius) + max(south**2, north**2) / (2.0 * radius)
        strip = margin * 0.5 * min(east - west, north - south)
        return kernels.Surface(
            relief.z, np.array([west, south, relief.grid.posting]),
            np.concatenate([one.z.ravel() for one in made]), table, margin, strip, radius,
            max(top, sum(max(float(one.z.max()), 0.0) for one in made)),
            max(*map(abs, self.terrain.bounds)) + strip + 0.5 * max(self.settings.sizes),
            float(table[:, 2].min()),
        )  # fmt: skip

    @property
    def nbytes(self) -> int:
        """Memory of the map and of all levels, bytes; builds the levels."""
        made = (self.level(n) for n in range(len(self.settings.sizes)))
        return self.terrain.nbytes + sum(one.z.nbytes for one in made)
