"""What a landing site must be like, and how sites are scored (Table 1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.array_files import read_arrays
from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SiteSettings:
    """Tolerances, weights and the sizes of cells; defaults are those of Table 1.

    The paper gives no sizes of cells, no number of sites and no separation; those here are ours.

    Attributes
    ----------
    slope_limit
        lambda_theta, rad.
    roughness_limit
        lambda_d: farthest that a point may lie from its plane without being an exception, m.
    density
        lambda_rho: least number of points on a square metre.
    exception_limit
        lambda_e: greatest share of exceptions among a cell's points.
    zone
        lambda_z: half side of the landing zone, m.
    weight_interest, weight_slope, weight_roughness
        alpha of Eq. 9, for (1 - interest), (1 - cosine of the slope) and the roughness in m.
    margin
        How much farther a hazard may reach than where it was seen, m: scans are not placed better.
    mesh_band, hazard_band, site_band
        Smallest and largest cells, m, that become nodes of the mesh, are searched for exceptions,
        and are sites.
    count
        Sites on the scoreboard.
    separation
        Least distance between them, m.
    roughness
        ``"rms"``: root mean square distance to the plane. ``"printed"``: Eq. 8 as printed,
        sum |d| / sqrt(N), which grows with the square root of the number of points, so that ground
        seen more often scores worse.
    """

    slope_limit: float = quantity(5.0, "deg", gt=0, lt=45, help="lambda_theta")
    roughness_limit: float = quantity(0.3, "m", gt=0, help="lambda_d: farther is an exception")
    density: float = quantity(5.0, "1/m^2", ge=0, help="least number of points")
    exception_limit: float = quantity(0.015, ge=0, lt=1, help="lambda_e: share of exceptions")
    zone: float = quantity(2.5, "m", gt=0, help="half side of the landing zone")
    weight_interest: float = quantity(1.0, ge=0, help="alpha of Eq. 9 for 1 - interest")
    weight_slope: float = quantity(1000.0, ge=0, help="alpha of Eq. 9 for 1 - cos slope")
    weight_roughness: float = quantity(100.0, ge=0, help="alpha of Eq. 9 for the roughness in m")
    mesh_band: tuple[float, float] = quantity((6.4, 12.8), "m", gt=0, help="cells of the mesh")
    margin: float = quantity(0.3, "m", ge=0, help="farther than seen hazards may reach")
    hazard_band: tuple[float, float] = quantity(
        (1.6, 1.6), "m", gt=0, help="cells searched for exceptions"
    )
    site_band: tuple[float, float] = quantity((0.8, 1.6), "m", gt=0, help="cells of sites")
    count: int = quantity(5, ge=1, help="sites on the scoreboard")
    separation: float = quantity(5.0, "m", ge=0, help="least distance between sites")
    roughness: Literal["rms", "printed"] = quantity("rms", help="Eq. 8")

    def __post_init__(self) -> None:
        check_bounds(self, "sites")
        for name in ("mesh_band", "hazard_band", "site_band"):
            low, high = getattr(self, name)
            if low > high:
                raise InputError(f"sites.{name}", (low, high), "two rising sizes in metres")
        if self.roughness not in {"rms", "printed"}:
            raise InputError("sites.roughness", self.roughness, "rms or printed")


@dataclass(frozen=True)
class InterestMap:
    """How much the mission wants to land where.

    Attributes
    ----------
    grid
        Places the cells, ENU.
    value
        Interest (rows, cols) in [0, 1]; 0: not to be landed on, as is everything off the map.
    """

    grid: Grid
    value: Array

    def __post_init__(self) -> None:
        if isinstance(self.value, np.ma.MaskedArray):
            raise InputError("interest", type(self.value), "a plain array, 0 where not to land")
        value = np.array(self.value, dtype=np.float64)  # a copy that nobody else can write to
        value.flags.writeable = False
        object.__setattr__(self, "value", value)
        if value.shape != self.grid.shape:
            raise InputError("interest", value.shape, f"an array of the grid's {self.grid.shape}")
        wrong = ~((value >= 0.0) & (value <= 1.0))
        if wrong.any():
            raise InputError("interest", float(value[wrong][0]), "numbers from 0 to 1")

    @classmethod
    def load(cls, path: Path) -> InterestMap:
        """Read a NumPy archive that holds `value` (rows, cols), `x0`, `y0` and `posting`.

        Raises
        ------
        InputError
            If the file is missing or holds something else.
        """
        try:
            file = read_arrays(path)
            value = np.asarray(file["value"], dtype=np.float64)
            x0, y0, posting = (float(file[name]) for name in ("x0", "y0", "posting"))
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(
                "sites.interest_path",
                str(path),
                f"a NumPy archive with value, x0, y0 and posting ({error})",
            ) from None
        if value.ndim != 2:
            raise InputError("interest", value.shape, "an array of rows and columns")
        return cls(Grid(x0, y0, posting, *value.shape), value)

    def at(self, xy: Array) -> Array:
        """Return the interest (n,) of points (n, 2)."""
        row, col = self.grid.cell(xy)
        inside = self.grid.contains(xy)
        g = self.grid
        value = self.value[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)]
        return np.where(inside, value, 0.0)
