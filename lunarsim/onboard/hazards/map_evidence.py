"""Evidence that mappers provide in addition to their maps, for fusion.

Probabilities of two maps cannot be multiplied: a rock that both sensors detect would count twice,
and a rock that neither detects would count once per sensor. The evidence behind the maps can be
combined: terrain elevations, the expected number of undetected rocks, and the tracked rocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface
from lunarsim.safety.calibration import MapEvidence
from lunarsim.safety.scenario_calibration import ScenarioCalibration

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RockTracks:
    """Individually tracked rocks.

    Attributes
    ----------
    xy
        Centres (n, 2), local frame, m.
    sigma
        Uncertainty of the centres relative to the lander (n,), m, 1 sigma per axis.
    radius, radius_variance
        Radius (n,), m, and its variance (n,), m^2.
    existence
        Probability that each track is a rock (n,).

    Raises
    ------
    InputError
        If the arrays differ in length or contain values that are not finite.
    """

    xy: Array
    sigma: Array
    radius: Array
    radius_variance: Array
    existence: Array

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            wanted = (len(self.radius), 2) if f.name == "xy" else (len(self.radius),)
            if np.shape(value) != wanted:
                raise InputError(f"rocks.{f.name}", np.shape(value), f"must have shape {wanted}")
            if not np.isfinite(value).all():
                raise InputError(f"rocks.{f.name}", value[~np.isfinite(value)][0], "must be finite")


@dataclass(frozen=True)
class TerrainEvidence:
    """Evidence of a mapper of elevations.

    Attributes
    ----------
    surface
        Elevations: the map of the mapper, or the snapshot that it is computed from.
    site_evidence
        Evidence for the probability at each site; None if not available.
    refit
        Last stage of the calibration; None: that of the package.
    residual_heights
        Heights of the samples above the local terrain plane, per cell (rows, cols), m; NaN without
        a sample. None if not available.
    compute_map
        Function that returns the map of the mapper; None if `surface` is that map.

    Raises
    ------
    InputError
        If `residual_heights` does not have the shape of the map, or if neither `surface` nor
        `compute_map` provides a map.
    """

    surface: TerrainSurface
    site_evidence: MapEvidence | None = None
    refit: ScenarioCalibration | None = None
    residual_heights: NDArray[np.float32] | None = None
    compute_map: Callable[[], HazardMap] | None = None

    def __post_init__(self) -> None:
        if self.compute_map is None and not isinstance(self.surface, HazardMap):
            raise InputError(
                "evidence.surface",
                type(self.surface),
                "must be a HazardMap",
                "Otherwise give draw.",
            )
        wanted = self.surface.grid.shape
        if self.residual_heights is not None and self.residual_heights.shape != wanted:
            raise InputError(
                "evidence.rises", self.residual_heights.shape, f"must have shape {wanted}"
            )

    @cached_property
    def hazard_map(self) -> HazardMap:
        """The map of the mapper."""
        if self.compute_map is not None:
            return self.compute_map()
        assert isinstance(self.surface, HazardMap)
        return self.surface


@dataclass(frozen=True)
class RockEvidence:
    """Evidence of a mapper of rocks.

    Attributes
    ----------
    hazard_map
        Map of the mapper.
    diameter
        Lower edges of the size classes (sizes,), ascending, m.
    ratio
        Undetected rocks of each class, divided by the number expected before any observation
        (sizes, rows, cols); 1 where nothing was observed.
    tracks
        Tracked rocks and candidates.
    clear
        Function that returns the probability that none of the given rocks reaches into the
        footprint (rows, cols).
    unseen
        Probability that an undetected rock reaches into the footprint (rows, cols); None if not
        available.
    expected
        Expected number of detected rocks that are hazardous.

    Raises
    ------
    InputError
        If `ratio` or `unseen` has the wrong shape, or if `unseen` is not a probability.
    """

    hazard_map: HazardMap
    diameter: Array
    ratio: NDArray[np.float32]
    tracks: RockTracks
    clear: Callable[[RockTracks], Array]
    unseen: NDArray[np.float32] | None = None
    expected: float = 0.0

    def __post_init__(self) -> None:
        if self.unseen is not None and self.unseen.shape != self.hazard_map.grid.shape:
            wanted_here = f"must have shape {self.hazard_map.grid.shape}"
            raise InputError("evidence.unseen", self.unseen.shape, wanted_here)
        if self.unseen is not None:
            invalid = self.unseen[~((self.unseen >= 0.0) & (self.unseen <= 1.0))]
            if invalid.size:
                raise InputError("evidence.unseen", float(invalid[0]), "must be between 0 and 1")
        wanted = (len(self.diameter), *self.hazard_map.grid.shape)
        if self.ratio.shape != wanted:
            raise InputError("evidence.ratio", self.ratio.shape, f"must have shape {wanted}")


FusionEvidence = TerrainEvidence | RockEvidence
