"""Criteria for landing sites and weights of their score (Table 1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.untrusted_files import read_arrays
from lunarsim.value_checks import check_elements, check_shape


@dataclass(frozen=True)
class SiteSettings:
    """Limits, score weights and cell sizes of the site selection on a quadtree.

    The defaults are those of Table 1 of the quadtree paper. The paper states no cell sizes, number
    of sites or separation; these are choices of lunarsim. An exception is a point that is too far
    from the terrain plane.

    Attributes
    ----------
    slope_limit
        lambda_theta: maximum slope, rad.
    roughness_limit
        lambda_d: distance from the terrain plane above which a point is an exception (hazard), m.
    min_density
        lambda_rho: minimum number of points per square metre.
    exception_limit
        lambda_e: maximum fraction of exceptions among the points of a cell.
    zone_half_side
        lambda_z: half side of the landing zone, m.
    interest_weight, slope_weight, roughness_weight
        Weights alpha of Eq. 9 for (1 - value to the mission), (1 - cosine of the slope) and the
        roughness in m.
    margin
        Margin around observed hazards, m, for the position error of scans.
    mesh_band, hazard_band, site_band
        Sides of the smallest and largest cells, m, that become vertices of the terrain mesh, that
        are searched for exceptions, and that become sites.
    count
        Number of ranked sites.
    separation
        Minimum distance between ranked sites, m.
    roughness
        Measure of roughness. ``"rms"``: root mean square distance to the plane. ``"printed"``: Eq.
        8 as printed, sum |d| / sqrt(N), which grows with the square root of the number of points
        and thus penalizes well observed terrain.
    """

    slope_limit: float = quantity(
        5.0,
        "deg",
        gt=0,
        lt=45,
        help="maximum slope of a landing site (lambda_theta of the quadtree paper)",
    )
    roughness_limit: float = quantity(
        0.3,
        "m",
        gt=0,
        help="distance from the terrain plane above which a LiDAR point counts as a hazard "
        "(lambda_d of the quadtree paper)",
    )
    min_density: float = quantity(
        5.0,
        "1/m^2",
        ge=0,
        help="minimum density of LiDAR points in a cell that is used (lambda_rho of the quadtree "
        "paper)",
    )
    exception_limit: float = quantity(
        0.015,
        ge=0,
        lt=1,
        help="maximum fraction of hazard points among the LiDAR points of a cell (lambda_e of the "
        "quadtree paper)",
    )
    zone_half_side: float = quantity(
        2.5,
        "m",
        gt=0,
        help="half the side of the square landing zone (lambda_z of the quadtree paper)",
    )
    interest_weight: float = quantity(
        1.0,
        ge=0,
        help="weight of the term (1 - mission value) in the site score; the site with the lowest "
        "score is the best (Eq. 9 of the quadtree paper)",
    )
    slope_weight: float = quantity(
        1000.0,
        ge=0,
        help="weight of the term (1 - cosine of the slope) in the site score; the site with the "
        "lowest score is the best (Eq. 9 of the quadtree paper)",
    )
    roughness_weight: float = quantity(
        100.0,
        ge=0,
        help="weight of the roughness (m) in the site score; the site with the lowest score is the "
        "best (Eq. 9 of the quadtree paper)",
    )
    mesh_band: tuple[float, float] = quantity(
        (6.4, 12.8),
        "m",
        gt=0,
        help="sides of the smallest and largest quadtree cells that form the terrain mesh",
    )
    margin: float = quantity(
        0.3, "m", ge=0, help="minimum distance between the landing zone and observed hazards"
    )
    hazard_band: tuple[float, float] = quantity(
        (1.6, 1.6),
        "m",
        gt=0,
        help="sides of the smallest and largest quadtree cells that are searched for hazards",
    )
    site_band: tuple[float, float] = quantity(
        (0.8, 1.6),
        "m",
        gt=0,
        help="sides of the smallest and largest quadtree cells that can become landing sites",
    )
    count: int = quantity(5, ge=1, help="maximum number of landing sites in the ranking")
    separation: float = quantity(
        5.0, "m", ge=0, help="minimum distance between two landing sites in the ranking"
    )
    roughness: Literal["rms", "printed"] = quantity(
        "rms",
        help="roughness measure: rms (root mean square distance of points from the plane) or "
        "printed (sum of the distances divided by the square root of their number, Eq. 8 of the "
        "quadtree paper)",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "sites")
        for name in ("mesh_band", "hazard_band", "site_band"):
            low, high = getattr(self, name)
            if low > high:
                raise InputError(
                    f"sites.{name}_m", (low, high), "must be two sizes, the smaller size first"
                )
        if self.roughness not in {"rms", "printed"}:
            raise InputError("sites.roughness", self.roughness, "must be 'rms' or 'printed'")


@dataclass(frozen=True)
class InterestMap:
    """Value of a landing at each place to the mission (interest).

    Attributes
    ----------
    grid
        Positions of the cells, ENU.
    value
        Value (rows, cols) in [0, 1]; 0 excludes a landing, as does any place off the map.
    """

    grid: Grid
    value: Array

    def __post_init__(self) -> None:
        if isinstance(self.value, np.ma.MaskedArray):
            raise InputError(
                "interest", type(self.value), "must not be a masked array",
                "Use 0 to exclude a place.", show_value=False,
            )  # fmt: skip
        value = np.array(self.value, dtype=np.float64)  # a private copy
        value.flags.writeable = False
        object.__setattr__(self, "value", value)
        check_shape("interest", value, self.grid.shape, "like the grid")
        is_valid = (value >= 0.0) & (value <= 1.0)
        check_elements("interest", value, is_valid, "must be between 0 and 1")

    @classmethod
    def load(cls, path: Path) -> InterestMap:
        """Read a NumPy archive with `value` (rows, cols), `x0`, `y0` and `posting`.

        Raises
        ------
        InputError
            If the file is missing or has other contents.
        """
        try:
            file = read_arrays(path)
            value = np.asarray(file["value"], dtype=np.float64)
            x0, y0, posting = (float(file[name]) for name in ("x0", "y0", "posting"))
        except (KeyError, ValueError, TypeError) as error:
            reason = f"the array {error} is missing" if isinstance(error, KeyError) else error
            raise InputError(
                "sites.interest_path", str(path), f"cannot be read, because {reason}",
                "Give an .npz file with the arrays value, x0, y0 and posting.",
            ) from None  # fmt: skip
        if value.ndim != 2:
            raise InputError("interest", value.shape, "must have shape (rows, columns)")
        return cls(Grid(x0, y0, posting, *value.shape), value)

    def at(self, xy: Array) -> Array:
        """Return the value to the mission (n,) of points (n, 2), ENU, m; 0 off the map."""
        row, col = self.grid.cell(xy)
        inside = self.grid.contains(xy)
        g = self.grid
        value = self.value[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)]
        return np.where(inside, value, 0.0)
