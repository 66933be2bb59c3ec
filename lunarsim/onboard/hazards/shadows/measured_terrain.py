"""Plane and heights of the terrain measured by another mapper."""

from __future__ import annotations

import cv2
import numpy as np

from lunarsim.onboard.hazards.hazard_map import TerrainSurface
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.hazards.shadows.terrain_plane import fit_terrain_plane
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.typing import Array

# Half width of the square over which heights are averaged, m, so that the rock itself and errors of
# single returns have little effect.
_HALF_WIDTH_M = 1.0


class MeasuredTerrain:
    """Plane and smoothed heights of the terrain that an elevation mapper has measured.

    Parameters
    ----------
    mapper
        Elevation mapper; None: no measured terrain.
    """

    def __init__(self, mapper: HazardMapper | None) -> None:
        self._mapper = mapper
        self._last_surface: TerrainSurface | None = None
        self._plane: GroundPlane | None = None
        self._heights: Array | None = None
        self._changed = False

    def has_changed(self) -> bool:
        """Return whether the measured terrain has changed since the last call."""
        self._current_surface()
        has_changed, self._changed = self._changed, False
        return has_changed

    def plane(self) -> GroundPlane | None:
        """Return the plane fitted to the terrain; None if it cannot be determined."""
        self._current_surface()
        return self._plane

    def heights(self, xy: Array) -> Array:
        """Return terrain heights (n,) at points (n, 2), local frame, m; NaN if unmeasured.

        Each is the mean of the known heights in a square of 2 m around the cell of the point.
        """
        out = np.full(len(xy), np.nan)
        surface = self._current_surface()
        if surface is None or self._heights is None:
            return out
        at = np.flatnonzero(np.isfinite(xy).all(1))
        at = at[surface.grid.contains(xy[at])]
        out[at] = self._heights[surface.grid.cell(xy[at])]
        return out

    def _current_surface(self) -> TerrainSurface | None:
        """Return the elevations of the mapper; update plane and heights if they are new."""
        if self._mapper is None:
            return None
        surface = self._mapper.terrain_surface()
        if surface is not self._last_surface:
            self._last_surface, self._plane, self._heights = (
                surface,
                fit_terrain_plane(surface),
                _smoothed_elevation(surface),
            )
            self._changed = True
        return surface


def _smoothed_elevation(surface: TerrainSurface) -> Array | None:
    """Return the mean of the known elevations around each known cell (rows, cols), m.

    NaN in unknown cells; None if no elevation is known.
    """
    if surface.elevation is None:
        return None
    known = np.isfinite(surface.elevation)
    if not known.any():
        return None
    side = 2 * max(1, round(_HALF_WIDTH_M / surface.grid.posting)) + 1
    total, share = (
        cv2.blur(of, (side, side), borderType=cv2.BORDER_CONSTANT)
        for of in (np.where(known, surface.elevation, 0.0).astype(np.float64), known.astype(float))
    )
    return np.where(known, total / np.where(known, share, 1.0), np.nan)
