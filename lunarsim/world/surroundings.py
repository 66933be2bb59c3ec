"""Ground beyond the map: coarser levels about it, and a sphere beyond those.

A place is named by its way over the sphere, east and north of the map's origin. Each level fades
out towards its edge, and the map's edge is carried on into the level about it, so that height over
the sphere has no step anywhere. Levels are built when something first looks at them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_side
from lunarsim.models.gravity import CentralGravity
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.rng import Streams
from lunarsim.world.terrain import Heightfield, RayHits, Terrain, fractal_relief

Array = NDArray[np.float64]

_MOST_POSTS = 4_000
# One number or several.
Numbers = float | tuple[float, ...]
# Points of a ray that are looked at before the first crossing is halved.
_SAMPLES, _HALVINGS = 400, 40


@dataclass(frozen=True)
class Surroundings:
    """What lies about the map, finest level first; heights add up.

    Attributes
    ----------
    sizes, postings
        Side of each level's square and distance of its posts, m.
    rms_slopes
        Of each level over its posting, rad.
    hurst
        Of all levels.
    margin
        Share of a level's half side, and of the map's, over which it passes into the next.
    path
        Raster that is the first level, its middle at the map's origin; left out: it is drawn.
    dtm_posting, dtm_unit, dtm_nodata
        How the raster is read; see the keys of the same names of `[terrain]`.
    """

    sizes: tuple[float, ...] = quantity((40_960.0, 1_024_000.0), "m", gt=0, help="of each square")
    postings: tuple[float, ...] = quantity((40.0, 1_000.0), "m", gt=0, help="of each level's posts")
    rms_slopes: tuple[float, ...] = quantity(
        (3.0, 1.0), "deg", ge=0, lt=45, help="of each level over its posting"
    )
    hurst: float = quantity(0.8, gt=0, lt=1, help="Hurst exponent of the levels")
    margin: float = quantity(0.3, gt=0, le=1, help="share of half a side that passes over")
    path: Path | None = quantity(None, help="raster that is the first level, as it is")
    dtm_posting: float | None = quantity(
        None, "m", gt=0, help="distance between posts, for a raster without a frame"
    )
    dtm_unit: str | None = quantity(
        None, help="unit of the heights, overrides the file's: m, km, ft, us-ft"
    )
    dtm_nodata: Numbers | None = quantity(
        None, help="numbers that mark posts without a height; [] for none"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "surroundings")
        for name in ("postings", "rms_slopes"):
            if len(getattr(self, name)) != len(self.sizes):
                raise InputError(
                    f"surroundings.{name}", getattr(self, name), f"{len(self.sizes)}, as sizes"
                )
        for size, posting in zip(self.sizes, self.postings, strict=True):
            check_side("surroundings.sizes", size, posting, _MOST_POSTS, "posts")

    def posts_read(self) -> int:
        """Return the number of posts of the raster, from the file's header; 0 without a raster.

        Raises
        ------
        InputError
            If the file cannot be opened.
        """
        from lunarsim.world.terrain.dtm import read_size  # noqa: PLC0415  (rasterio loads slowly)

        return read_size(self.path, posting=self.dtm_posting).posts if self.path else 0

    def build(self, terrain: Terrain, moon: CentralGravity, streams: Streams) -> Surrounded:
        """Return the ground of one flight; what is drawn comes from its streams."""

        @cache
        def level(n: int) -> Heightfield:
            if n == 0 and self.path is not None:
                return _measured(self)
            grid = Grid.centred((0.0, 0.0), self.sizes[n], self.postings[n])
            drawn = fractal_relief(
                grid, streams.get(f"surroundings.{n}"), hurst=self.hurst,
                rms_slope=self.rms_slopes[n], baseline=self.postings[n],
            )  # fmt: skip
            return Heightfield(grid, drawn.z - drawn.z[grid.rows // 2, grid.cols // 2])

        return Surrounded(terrain, moon, self, level)


def _measured(settings: Surroundings) -> Heightfield:
    """Return the raster of the first level; height 0 is at its centre, which is the origin."""
    from lunarsim.world.terrain.dtm import load_dtm  # noqa: PLC0415  (rasterio loads slowly)

    assert settings.path is not None
    try:
        z = load_dtm(
            settings.path, posting=settings.dtm_posting, unit=settings.dtm_unit,
            nodata=settings.dtm_nodata,
        )  # fmt: skip
    except InputError as error:  # the keys have the same names in [terrain]
        field, problem, remedy = (
            text.replace("terrain.", "surroundings.")
            for text in (error.field, error.problem, error.remedy)
        )
        raise InputError(field, error.value, problem, remedy) from None
    if not np.isfinite(z.z).all():
        raise InputError("surroundings.path", str(settings.path), "a raster without gaps")
    g = z.grid
    x0, y0 = (-0.5 * (n - 1) * g.posting for n in (g.cols, g.rows))
    middle = z.z[g.rows // 2, g.cols // 2]
    return Heightfield(Grid(x0, y0, g.posting, g.rows, g.cols), z.z - middle)


def _smooth(share: Array) -> Array:
    """Return 1 at shares of nought and less, 0 at 1 and more, without a kink."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(1.0 - s * s * (3.0 - 2.0 * s))


@dataclass(frozen=True)
class Surrounded:
    """A map, levels about it, and the sphere; see `Surroundings`.

    Attributes
    ----------
    terrain
        The map.
    moon
        The sphere.
    settings
        Sizes and margins.
    level
        Returns a level by its number, built when it is first asked for.
    """

    terrain: Terrain
    moon: CentralGravity
    settings: Surroundings
    level: Callable[[int], Heightfield] = field(repr=False, compare=False)

    def way(self, position: ArrayLike) -> Array:
        """Return the way over the sphere (..., 2), m, east and north, to below positions."""
        r = self.moon.from_centre(position)
        aside = np.hypot(r[..., 0], r[..., 1])
        arc = self.moon.radius * np.arctan2(aside, r[..., 2])
        unit = r[..., :2] / np.maximum(aside, 1e-12)[..., None]
        return np.asarray(unit * arc[..., None])

    def elevation(self, way: ArrayLike) -> Array:
        """Return the height of the ground over the sphere (...,), m, at ways (..., 2)."""
        xy = np.asarray(way, dtype=np.float64)
        flat = xy.reshape(-1, 2)
        west, east, south, north = self.terrain.bounds
        edge = np.clip(flat, (west, south), (east, north))
        beyond = np.hypot(*(flat - edge).T)
        over = self.settings.margin * 0.5 * min(east - west, north - south)
        share = _smooth(beyond / over)
        z = np.zeros(len(flat))
        outside = beyond > 0.0
        if outside.any():
            z[outside] = (1.0 - share[outside]) * self._levels(flat[outside])
        near = share > 0.0
        if near.any():
            # The map is level, the sphere falls away from it.
            drop = (edge[near] ** 2).sum(axis=1) / (2.0 * self.moon.radius)
            z[near] += share[near] * (self.terrain.elevation(edge[near]) + drop)
        return z.reshape(xy.shape[:-1])

    def _levels(self, flat: Array) -> Array:
        """Return the sum of the levels at ways (n, 2), m."""
        z = np.zeros(len(flat))
        for n, size in enumerate(self.settings.sizes):
            most = np.abs(flat).max(axis=1)
            half = 0.5 * size
            inside = most < half
            if not inside.any():
                continue
            one = self.level(n)
            half = min(half, -one.grid.x0, -one.grid.y0)
            share = _smooth((most / half - 1.0) / self.settings.margin + 1.0)
            g = one.grid
            at = (flat[:, 1] - g.y0) / g.posting, (flat[:, 0] - g.x0) / g.posting
            z += share * ndimage.map_coordinates(one.z, at, order=1, mode="nearest")
        return z

    def clearance(self, position: ArrayLike) -> Array:
        """Return heights above the ground below (...,), m, of positions (..., 3)."""
        return np.asarray(self.moon.height(position) - self.elevation(self.way(position)))

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Cast rays (n, 3) from a point (3,) onto the ground; see `Terrain.cast`."""
        origin = np.asarray(origin, dtype=np.float64)
        rays = np.atleast_2d(np.asarray(direction, dtype=np.float64))
        found = np.array([self._first(origin, ray, max_range) for ray in rays])
        points = origin + np.where(np.isfinite(found), found, 0.0)[:, None] * rays
        normal = np.where(np.isfinite(found)[:, None], self._normal(points), np.nan)
        rock = np.where(np.isfinite(found), -1, -2).astype(np.int32)
        return RayHits(found, normal, rock)

    def _first(self, origin: Array, ray: Array, max_range: float) -> float:
        """Return the range at which a ray first meets the ground, m; NaN if it does not."""
        r = self.moon.from_centre(origin)
        along, height = float(r @ ray), float(self.moon.height(origin))
        # Nowhere is the ground higher than the lander and a sphere 20 km down at once.
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
        for _ in range(_HALVINGS):
            middle = 0.5 * (a + b)
            above = self.clearance(origin + middle * ray) > 0.0
            a, b = (middle, b) if above else (a, middle)
        return float(0.5 * (a + b))

    def _normal(self, points: Array) -> Array:
        """Return the normal of the ground below points (n, 3), ENU, over a metre."""

        def rise(step: Array) -> Array:
            ahead, behind = self.way(points + step), self.way(points - step)
            return self.elevation(ahead) - self.elevation(behind)

        slope = np.stack([rise(0.5 * e) for e in np.eye(3)], axis=-1)
        out = self.moon.up(points) - slope
        return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))

    @property
    def nbytes(self) -> int:
        """Memory of the map and of all levels, bytes; builds them."""
        made = (self.level(n) for n in range(len(self.settings.sizes)))
        return self.terrain.nbytes + sum(one.z.nbytes for one in made)
