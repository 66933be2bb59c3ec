"""Relief as a triangulated grid of elevations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.world.terrain.spline import GappySpline


@dataclass(frozen=True)
class Heightfield:
    """Terrain surface as a grid of elevations, with two triangles per grid square.

    The diagonal of the square between four grid points runs from south-west to north-east. Ray
    casting, rendering and point queries use this same surface and therefore agree exactly.

    Attributes
    ----------
    grid
        Grid whose cell centres are the points with elevations.
    z
        Elevation (rows, cols), float32, m; NaN for no data.

    Examples
    --------
    >>> grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
    >>> relief = Heightfield(grid, np.tile(0.1 * grid.x, (4, 1)).astype(np.float32))
    >>> relief.bounds, relief.refined(0.5).grid.shape
    ((-1.5, 1.5, -1.5, 1.5), (7, 7))
    """

    grid: Grid
    z: NDArray[np.float32]

    def __post_init__(self) -> None:
        # The kernels are compiled for a contiguous float32 array.
        object.__setattr__(self, "z", np.ascontiguousarray(self.z, dtype=np.float32))
        if self.z.shape != self.grid.shape:
            raise InputError(
                "heightfield.z", self.z.shape, f"must have the grid's shape {self.grid.shape}"
            )
        if min(self.z.shape) < 2:
            raise InputError("heightfield.z", self.z.shape, "must have at least 2 x 2 points")
        if np.any(np.isinf(self.z)):
            raise InputError("heightfield.z", np.inf, "must be finite, or NaN where it is unknown")
        if not np.any(np.isfinite(self.z)):
            raise InputError(
                "heightfield.z", np.nan, "must have at least one elevation, but all values are NaN",
                show_value=False,
            )  # fmt: skip

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, east, south and north edges (the outermost grid points), m."""
        g = self.grid
        return (
            g.x0,
            g.x0 + (g.cols - 1) * g.posting,
            g.y0,
            g.y0 + (g.rows - 1) * g.posting,
        )

    @property
    def z_range(self) -> tuple[float, float]:
        """Minimum and maximum elevation, m."""
        return float(np.nanmin(self.z)), float(np.nanmax(self.z))

    def scaled(self, factor: float) -> Heightfield:
        """Return the relief with all elevations multiplied by `factor`.

        The factor is c in Eq. 20 of the Gaussian DEM paper.
        """
        return Heightfield(self.grid, (self.z * np.float32(factor)).astype(np.float32))

    def mirrored(self, side: float) -> Heightfield:
        """Extend the relief by mirroring at its edges to a square of at least `side` m.

        The extension is symmetric about the middle and continuous in elevation. A direction that
        is already wide enough is not extended.
        """
        wanted = int(np.ceil(side / self.grid.posting - 1e-9)) + 1
        rows, cols = (max(-(-(wanted - n) // 2), 0) for n in self.grid.shape)
        grid, z = self.grid, np.pad(self.z, ((rows, rows), (cols, cols)), mode="reflect")
        west, south = grid.x0 - cols * grid.posting, grid.y0 - rows * grid.posting
        return Heightfield(Grid(west, south, grid.posting, *z.shape), z)

    def dequantised(self, step: float) -> Heightfield:
        """Return a smooth relief that is consistent with quantized elevations.

        The relief is smoothed repeatedly and kept within half a step of the measured values, which
        removes the slopes of the quantization steps.

        Parameters
        ----------
        step
            Quantization step of the elevations, m.
        """
        if not (np.isfinite(step) and step > 0.0):
            raise InputError("terrain.height_step_m", step, "must be positive and finite")
        measured = self.z.astype(np.float64)
        known = np.isfinite(measured)
        z = np.where(known, measured, 0.0)
        weight = np.maximum(ndimage.gaussian_filter(known.astype(np.float64), 1.0), 1e-12)
        for _ in range(60):
            z = ndimage.gaussian_filter(np.where(known, z, 0.0), 1.0) / weight
            z = np.clip(z, measured - 0.5 * step, measured + 0.5 * step)
        return Heightfield(self.grid, np.where(known, z, np.nan).astype(np.float32))

    def refined(self, posting: float) -> Heightfield:
        """Interpolate the relief to a grid spacing of at most `posting` (m) by spline.

        The new spacing divides the old one, so that the old grid points keep their elevations. A
        new point next to no-data is no-data. A relief that is already fine enough is returned
        unchanged.
        """
        factor = max(1, int(np.ceil(self.grid.posting / posting - 1e-9)))
        if factor == 1:
            return self
        rows, cols = self.grid.shape
        fine = Grid(
            self.grid.x0,
            self.grid.y0,
            self.grid.posting / factor,
            (rows - 1) * factor + 1,
            (cols - 1) * factor + 1,
        )
        spline = GappySpline(self.z)
        rows_at, cols_at = np.meshgrid(
            np.arange(fine.rows) / factor, np.arange(fine.cols) / factor, indexing="ij"
        )
        z = spline(rows_at, cols_at)
        z[::factor, ::factor] = spline.filled  # exact here: removes the spline's rounding error
        z[spline.is_gap(rows_at, cols_at)] = np.nan
        return Heightfield(fine, z.astype(np.float32))
