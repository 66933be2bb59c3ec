"""Terrain constraint of optimal paths: convex majorant, then linearisation.

The space above terrain is not convex. A cone of half-spaces over the end, one per azimuth sector,
is convex. Each sector's slope is the minimum with which its plane is above all terrain of the
sector. If this cone costs propellant, the terrain is linearised about the last path: the path over
each interval must be above a plane over all nearby posts. This is repeated until path and planes
agree. The final path is checked against the terrain itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.optimal.errors import InfeasibleError, SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.path import OptimalPath
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Cone, Descent
from lunarsim.optimal.transcription import HalfSpaces
from lunarsim.optimal.validation import check_count, check_numbers, is_number
from lunarsim.typing import Array

_ACTIVE_MULTIPLIER = 1e-4  # relative multiplier of a half-space below which it costs no propellant
_CONVERGED_CHANGE = 1e-4  # relative change of delta-v below which the iteration has converged
_SAMPLES_PER_INTERVAL = 16  # terrain samples per interval


@dataclass(frozen=True)
class TerrainRaster:
    """Terrain as elevations of grid points, interpolated bilinearly.

    Attributes
    ----------
    grid
        Grid of the elevations.
    elevation
        Elevation of each grid point (rows, cols), m.

    Raises
    ------
    InputError
        If elevations are missing or have the wrong shape.
    """

    grid: Grid
    elevation: Array

    def __post_init__(self) -> None:
        if not isinstance(self.grid, Grid):
            raise InputError("optimal.grid", type(self.grid), "must be a Grid")
        if np.shape(self.elevation) != self.grid.shape:
            raise InputError(
                "optimal.elevation",
                np.shape(self.elevation),
                f"must have one value per grid point, shape {self.grid.shape}",
            )
        kind = np.asarray(self.elevation).dtype
        if kind.kind not in "fiu":
            problem = f"must be an array of real numbers, not of type {kind.name}"
            raise InputError("optimal.elevation", kind, problem, show_value=False)
        missing = int((~np.isfinite(self.elevation)).sum())
        if missing:
            raise InputError(
                "optimal.elevation",
                missing,
                f"must be finite, but the number of its NaN or infinite values is {missing}",
                "Replace these values.",
                show_value=False,
            )

    @property
    def posts(self) -> Array:
        """Positions of all grid points with their elevations (n, 3), ENU, m."""
        east = np.tile(self.grid.x, self.grid.rows)
        north = np.repeat(self.grid.y, self.grid.cols)
        return np.column_stack((east, north, np.asarray(self.elevation, dtype=np.float64).ravel()))

    def height(self, points: ArrayLike) -> Array:
        """Return the terrain elevation (n,), m, at points (n, 2) or (n, 3), ENU, m.

        It is NaN outside the grid.
        """
        xy = np.asarray(points, dtype=np.float64)[:, :2]
        g = self.grid
        u, v = (xy[:, 0] - g.x0) / g.posting, (xy[:, 1] - g.y0) / g.posting
        inside = (u >= 0.0) & (v >= 0.0) & (u <= g.cols - 1) & (v <= g.rows - 1)
        col = np.clip(np.floor(np.where(inside, u, 0.0)).astype(int), 0, max(g.cols - 2, 0))
        row = np.clip(np.floor(np.where(inside, v, 0.0)).astype(int), 0, max(g.rows - 2, 0))
        s, t = u - col, v - row
        z = np.asarray(self.elevation, dtype=np.float64)
        right, up = np.minimum(col + 1, g.cols - 1), np.minimum(row + 1, g.rows - 1)
        low = (1.0 - s) * z[row, col] + s * z[row, right]
        high = (1.0 - s) * z[up, col] + s * z[up, right]
        return np.where(inside, (1.0 - t) * low + t * high, np.nan)

    def majorant(self, end: ArrayLike, sectors: int = 12, clearance: float = 0.0) -> Cone:
        """Return a convex cone above all terrain, with its apex at the end of a path.

        `end` (3,) is the end of the path, ENU, m; the cone has one half-space per azimuth sector.
        `clearance`, m, is added to the terrain.

        No half-space slopes downward: terrain below the end is not followed.

        Raises
        ------
        InputError
            If the end is not a position, there are fewer than 3 sectors (each must be narrower than
            180 deg), or the clearance is invalid.
        """
        sectors = check_count("sectors", sectors, 3)
        end = check_numbers("end_position", end, (3,), "must be three finite numbers")
        _check_clearance(clearance)
        offsets = self.posts - end
        distance = np.hypot(offsets[:, 0], offsets[:, 1])
        is_beside = distance > 1e-9
        azimuth = np.arctan2(offsets[is_beside, 1], offsets[is_beside, 0])
        width = 2.0 * np.pi / sectors
        sector = np.round(azimuth / width).astype(int) % sectors
        cosine = np.cos(azimuth - sector * width)
        slopes_needed = (offsets[is_beside, 2] + clearance) / (distance[is_beside] * cosine)
        slopes = np.zeros(sectors)
        np.maximum.at(slopes, sector, slopes_needed)
        angles = width * np.arange(sectors)
        return Cone(
            np.column_stack((-slopes * np.cos(angles), -slopes * np.sin(angles), np.ones(sectors)))
        )

    def above(self, path: OptimalPath) -> float:
        """Return the minimum height of a path above the terrain, m.

        Raises
        ------
        InputError
            If the path leaves the grid.
        """
        times = np.linspace(0.0, path.duration, _SAMPLES_PER_INTERVAL * path.intervals + 1)
        points = path.at(times)[0]
        height = self.height(points)
        if np.isnan(height).any():
            at = points[np.isnan(height)][0]
            raise InputError(
                "optimal.terrain",
                self.grid.extent,
                f"must cover the path, but the path leaves it at ({at[0]:.1f}, {at[1]:.1f}) m",
                "Use a larger terrain.",
                show_value=False,
            )
        return float((points[:, 2] - height).min())

    def half_spaces(self, path: OptimalPath, clearance: float) -> HalfSpaces:
        """Return half-spaces above the terrain near each interval of a path.

        There are three per interval: the planes of the interval and of its two neighbours,
        `clearance` (m) above the terrain.

        The path over an interval lies in the convex hull of three control points: the interval's
        own and those of its neighbours. All three must be above the plane of the interval.
        """
        control = path.position[:-1] + 0.5 * path.step * path.velocity[:-1]
        spans = np.linalg.norm(np.diff(path.position[:, :2], axis=0), axis=1)
        posts = self.posts
        planes = np.array(
            [
                self._plane(posts, c, s + 2.0 * self.grid.posting)
                for c, s in zip(control, spans, strict=True)
            ]
        )
        n = len(control)
        near = np.clip(np.arange(n)[:, None] + [-1, 0, 1], 0, n - 1)
        normals = np.concatenate((-planes[near][..., :2], np.ones((n, 3, 1))), axis=2)
        level = planes[near][..., 2] + clearance
        return HalfSpaces(normals, level - normals @ path.descent.end_position, moves=False)

    @staticmethod
    def _plane(posts: Array, centre: Array, reach: float) -> Array:
        """Return slopes and height at the origin (3,) of a plane above nearby terrain.

        `posts` (n, 3) are terrain points; those within `reach` (m, horizontal) of the point
        `centre` are used. Raise InputError if there are fewer than three.
        """
        near = posts[np.hypot(*(posts[:, :2] - centre[:2]).T) <= reach]
        if len(near) < 3:
            raise InputError(
                "optimal.terrain",
                centre[:2].tolist(),
                "must have at least three elevations near the path at the point "
                f"({centre[0]:.1f}, {centre[1]:.1f}) m",
                show_value=False,
            )
        rows = np.column_stack((near[:, :2] - centre[:2], np.ones(len(near))))
        slope = np.linalg.lstsq(rows, near[:, 2], rcond=None)[0][:2]
        return np.array([*slope, (near[:, 2] - near[:, :2] @ slope).max()])


def minimize_propellant_over_terrain(
    planner: Planner,
    descent: Descent,
    terrain: TerrainRaster,
    *,
    clearance: float = 0.0,
    sectors: int = 12,
    rounds: int = 10,
) -> OptimalPath:
    """Find the minimum-propellant path of a descent above the terrain.

    Parameters
    ----------
    planner, descent
        Planner for one final time, and landing problem without a cone.
    terrain
        Terrain; the end of the descent must be at least `clearance` above the terrain.
    clearance
        Minimum height of the path above the terrain, m.
    sectors, rounds
        Number of azimuth sectors of the majorant; maximum number of linearisations.

    Raises
    ------
    InputError
        If start or end is too low, the path leaves the grid, or an argument is invalid.
    InfeasibleError
        If no path exists even over flat terrain.
    SolverError
        If no path above the terrain is found.
    """
    if not isinstance(terrain, TerrainRaster):
        raise InputError("optimal.terrain", type(terrain), "must be a TerrainRaster")
    _check_clearance(clearance)
    rounds, sectors = check_count("rounds", rounds, 1), check_count("sectors", sectors, 3)
    _check_ends(descent, terrain, clearance)
    majorant_path, best = None, None
    try:
        cone = terrain.majorant(descent.end_position, sectors, clearance)
        majorant_path = minimize_propellant(planner, replace(descent, cone=cone))
    except (InfeasibleError, SolverError):
        pass  # a majorant may block every path, or be active for a time that makes relaxation lossy
    # The majorant considers posts only; between and outside them, check the terrain itself.
    if majorant_path is not None and terrain.above(majorant_path) > clearance - 1e-3:
        if (
            majorant_path.half_space_multipliers.max(initial=0.0)
            < _ACTIVE_MULTIPLIER * np.linalg.norm(majorant_path.primer_vector, axis=1).max()
        ):
            return majorant_path
        best = majorant_path
    starts = _initial_paths(planner, descent, majorant_path)
    for start in starts:
        is_last = best is None and start is starts[-1]
        found = _linearise_terrain(planner, descent, terrain, clearance, start, rounds, is_last)
        if best is None or (found is not None and found.delta_v < best.delta_v):
            best = found
    if best is None:
        raise SolverError(
            f"No path {clearance} m above the terrain was found in {rounds} linearisations."
        )
    return best


def _initial_paths(
    planner: Planner, descent: Descent, majorant_path: OptimalPath | None
) -> list[OptimalPath]:
    """Return initial paths for linearisation: over flat terrain and over the majorant.

    A majorant that is steep at a near rim leads to a vertical path. Linearisation about that path
    never finds the short path, but linearisation about the path over flat terrain does.
    """
    try:
        flat = minimize_propellant(planner, descent)
    except (InfeasibleError, SolverError):
        if majorant_path is None:
            raise
        return [majorant_path]
    return [flat] if majorant_path is None else [flat, majorant_path]


def _check_clearance(clearance: float) -> None:
    """Raise InputError if a clearance is negative or not finite."""
    if not (is_number(clearance) and clearance >= 0.0):
        raise InputError("optimal.clearance", clearance, "must be a finite number of 0 or more")


def _check_ends(descent: Descent, terrain: TerrainRaster, clearance: float) -> None:
    """Raise an error if a descent's start or end is off the grid or too low.

    Too low means less than `clearance` (m) above the terrain.
    """
    for name in ("end_position", "position"):
        at = getattr(descent, name)
        height = float(terrain.height(at[None])[0])
        if np.isnan(height):
            raise InputError(
                f"optimal.{name}",
                at.tolist(),
                "must lie within the terrain",
                "Use a larger terrain.",
            )
        if not at[2] >= height + clearance - 1e-9:
            raise InputError(
                f"optimal.{name}", at.tolist(),
                f"must be at least {clearance} m above the terrain, but its height above the "
                f"terrain is {at[2] - height:.2f} m",
                show_value=False,
            )  # fmt: skip


def _linearise_terrain(
    planner: Planner,
    descent: Descent,
    terrain: TerrainRaster,
    clearance: float,
    path: OptimalPath,
    rounds: int,
    is_last: bool,
) -> OptimalPath | None:
    """Plan repeatedly above the terrain, each time linearised about the last path.

    `path` is the first path, `rounds` the maximum number of linearisations; the search ends when
    the delta-v converges. The result is the best path that is at least `clearance`, m, above the
    terrain, or None if there is none. A path outside the grid raises an error if `is_last`: no
    other path or start is left.
    """
    best: OptimalPath | None = None
    for _ in range(rounds):
        try:
            half_spaces = terrain.half_spaces(path, clearance)
            found = minimize_propellant(planner, descent, last=path, half_spaces=half_spaces)
            above = terrain.above(found)
        except (InfeasibleError, SolverError):
            return best
        except InputError:
            if is_last and best is None:
                raise
            return best
        converged = abs(found.delta_v - path.delta_v) < _CONVERGED_CHANGE * path.delta_v
        is_above = above > clearance - 1e-3
        if is_above and (best is None or found.delta_v < best.delta_v):
            best = found
        if converged and is_above:
            return best
        path = found
    return best
