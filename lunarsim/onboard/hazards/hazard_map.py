"""The hazard map: the common product of all mappers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from lunarsim.core.candidates import average_cell
from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_elements, check_shape

FloatMap = NDArray[np.float32]
BoolMap = BoolArray


class TerrainSurface(Protocol):
    """Terrain elevations as last computed by a mapper; every `HazardMap` is one.

    Attributes
    ----------
    grid, observed, elevation, variance
        Cell positions, observed cells, mean elevation (m) and its variance (m^2); same meaning as
        in `HazardMap`.
    """

    @property
    def grid(self) -> Grid:
        """Positions of the cells, estimated ENU frame."""
        ...

    @property
    def observed(self) -> BoolMap:
        """True where the complete footprint of the lander has been observed (rows, cols)."""
        ...

    @property
    def elevation(self) -> FloatMap | None:
        """Mean elevation (rows, cols), m; NaN where unknown; None if not estimated."""
        ...

    @property
    def variance(self) -> FloatMap | None:
        """Variance of the elevation (rows, cols), m^2; None if not estimated."""
        ...


def lookup_elevation(surface: TerrainSurface, xy: ArrayLike) -> float:
    """Return the mean elevation (m) of the map cell that contains a point.

    `surface` holds the elevations and `xy` (2,) is the point, east and north in the frame of the
    map, m. The result is NaN off the map, where the elevation is unknown, and if the mapper does
    not estimate elevations.
    """
    if surface.elevation is None or not bool(surface.grid.contains(xy)):
        return float("nan")
    row, col = surface.grid.cell(xy)
    return float(surface.elevation[int(row), int(col)])


@dataclass(frozen=True)
class HazardMap:
    """Probability that the terrain of each cell is safe, from the measurements so far.

    Attributes
    ----------
    grid
        Positions of the cells, estimated ENU frame.
    p_safe
        Probability, given the measurements and the mission's expected rocks, that a touchdown
        centred on the cell violates none of the lander's limits of slope, roughness and belly
        clearance at any heading (rows, cols), in [0, 1]; 0 where not observed.
    observed
        True where the complete footprint of a lander centred on the cell has been observed (rows,
        cols).
    elevation
        Mean elevation (rows, cols), m; NaN where unknown; None if the mapper does not estimate it.
    variance
        Variance of the elevation (rows, cols), m^2; None if the mapper does not estimate it.
    eligible
        Where the mission permits a landing (rows, cols), independent of its safety. None:
        everywhere.
    value
        Value to the mission of a landing in the cell, relative to the best cell (rows, cols), in
        [0, 1]. None: 1 everywhere.
    in_domain
        True where `p_safe` is a calibrated frequency, because the terrain resembles that of the
        calibration (rows, cols). Elsewhere `p_safe` is heuristic and only ranks sites. None: the
        mapper does not state it.

    Raises
    ------
    InputError
        If a layer is masked or has the wrong shape or type, or if an entry of `p_safe` or `value`
        is NaN or outside [0, 1].

    Examples
    --------
    >>> hazard_map = HazardMap.unobserved(Grid.centred((0.0, 0.0), 4.0, 1.0))
    >>> hazard_map.p_safe[2:], hazard_map.observed[2:] = 0.9, True  # the northern half
    >>> hazard_map.p_safe_at([[0.5, 1.5], [0.5, -1.5], [9.0, 0.0]]).round(2).tolist()
    [0.9, 0.0, 0.0]
    """

    grid: Grid
    p_safe: FloatMap
    observed: BoolMap
    elevation: FloatMap | None = None
    variance: FloatMap | None = None
    eligible: BoolMap | None = None
    value: FloatMap | None = None
    in_domain: BoolMap | None = None

    def __post_init__(self) -> None:
        kinds = {"eligible": np.bool_, "value": np.floating, "in_domain": np.bool_}
        for name in ("p_safe", "observed", "elevation", "variance", *kinds):
            layer = getattr(self, name)
            if layer is None:
                continue
            check_shape(f"map.{name}", layer, self.grid.shape, "like the grid")
            if isinstance(layer, np.ma.MaskedArray):
                raise InputError(
                    f"map.{name}", type(layer), "must not be a masked array", show_value=False
                )
            kind = kinds.get(name)
            if kind and not np.issubdtype(layer.dtype, kind):
                wanted = "booleans" if kind is np.bool_ else "floating-point numbers"
                raise InputError(f"map.{name}", layer.dtype.name, f"must be an array of {wanted}")
            if name in ("p_safe", "value"):
                is_valid = (layer >= 0.0) & (layer <= 1.0)
                check_elements(f"map.{name}", layer, is_valid, "must be between 0 and 1")

    @classmethod
    def unobserved(cls, grid: Grid) -> HazardMap:
        """Return a hazard map on `grid` without any observation (p_safe is 0 everywhere)."""
        return cls(
            grid,
            np.zeros(grid.shape, np.float32),
            np.zeros(grid.shape, np.bool_),
            np.full(grid.shape, np.nan, np.float32),
            None,
        )

    def eligible_at(self, xy: ArrayLike) -> BoolMap:
        """Return whether the mission permits a landing at points (..., 2).

        `xy` is in the estimated ENU frame, m. The result (...,) is False off the map.
        """
        inside = np.asarray(self.grid.contains(xy), dtype=np.bool_)
        return inside if self.eligible is None else inside & self._layer_at(self.eligible, xy)

    def value_at(self, xy: ArrayLike) -> Array:
        """Return the mission value, in [0, 1], of the cells at points (..., 2).

        `xy` is in the estimated ENU frame, m. The result (...,) is 0 off the map.
        """
        inside = self.grid.contains(xy)
        value = 1.0 if self.value is None else self._layer_at(self.value, xy).astype(np.float64)
        return np.where(inside, value, 0.0)

    def _layer_at(self, layer: NDArray[Any], xy: ArrayLike) -> NDArray[Any]:
        """Return the entries of a map layer (rows, cols) in the cells at points (..., 2).

        Points `xy` off the map get the entry of the nearest cell.
        """
        row, col = self.grid.cell(xy)
        g = self.grid
        return np.asarray(layer[np.clip(row, 0, g.rows - 1), np.clip(col, 0, g.cols - 1)])

    def p_safe_at(self, xy: ArrayLike) -> Array:
        """Return the probability of safe terrain in the cells at points (..., 2).

        `xy` is in the estimated ENU frame, m. The result (...,) is 0 off the map.
        """
        inside = self.grid.contains(xy)
        p = self._layer_at(self.p_safe, xy).astype(np.float64)
        return np.where(inside, p, 0.0)

    def elevation_at(self, xy: ArrayLike) -> float:
        """Return the mean elevation (m) of the cell that contains a point (2,).

        The result is NaN off the map and where the elevation is unknown.
        """
        return lookup_elevation(self, xy)

    def dispersed_p_safe(self, sigma: float) -> FloatMap:
        """Return the probability of safe terrain when aiming at each cell (rows, cols).

        The touchdown point is Gaussian about the aim point. The result is p_safe averaged over the
        touchdown point, as in the ALHAT programme. Unobserved terrain counts as unsafe, and the
        result is 0 in unobserved cells.

        Parameters
        ----------
        sigma
            Touchdown error, m, 1 sigma per axis.

        Raises
        ------
        InputError
            If `sigma` is negative or not finite.
        """
        if not (np.isfinite(sigma) and sigma >= 0.0):
            raise InputError("sigma", sigma, "must be 0 or more, and finite")
        p = np.where(self.observed, self.p_safe, np.float32(0.0))
        if sigma == 0.0:
            return p
        smooth = ndimage.gaussian_filter(
            p, sigma / self.grid.posting, mode="constant", cval=0.0, truncate=3.0
        )
        return np.where(self.observed, smooth, np.float32(0.0)).astype(np.float32)

    def dispersed_p_safe_at(self, xy: Array, sigma: Array) -> Array:
        """Return the probability of safe terrain when aiming at points (n, 2).

        The touchdown point is Gaussian about the aim point. The result (n,) is p_safe averaged over
        the touchdown point; it is 0 off the map. Unlike `dispersed_p_safe`, the method evaluates
        only the given points.

        Parameters
        ----------
        xy
            Points (n, 2), estimated ENU frame, m.
        sigma
            Touchdown error of each point (n,), m, 1 sigma per axis.

        Raises
        ------
        InputError
            If an error is negative or not finite.
        """
        sigma = np.asarray(sigma, np.float64)
        is_valid = np.isfinite(sigma) & (sigma >= 0.0)
        check_elements("sigma", sigma, is_valid, "must be 0 or more, and finite")
        out = np.zeros(len(xy))
        rows, cols = self.grid.cell(xy)
        for n in np.flatnonzero(self.grid.contains(xy)):
            spread = float(sigma[n] / self.grid.posting)
            out[n] = average_cell(self.p_safe, self.observed, rows[n], cols[n], spread)
        return out
