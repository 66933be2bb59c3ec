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
from lunarsim.onboard.calibration.gaussian_dem import MapEvidence
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface
from lunarsim.typing import Array
from lunarsim.value_checks import check_elements, check_finite, check_shape


@dataclass(frozen=True)
class RockTracks:
    """Estimated positions and sizes of individually tracked rocks.

    Attributes
    ----------
    xy
        Centres (n, 2), local frame, m.
    sigma
        Standard deviation of the centre relative to the lander (n,), m, per axis.
    radius, radius_variance
        Estimated radius (n,), m, and its variance (n,), m^2.
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
            n = len(self.radius)
            wanted = (n, 2) if f.name == "xy" else (n,)
            check_shape(f"rocks.{f.name}", value, wanted, f"for {n} rocks")
            check_finite(f"rocks.{f.name}", value)


@dataclass(frozen=True)
class TerrainEvidence:
    """Measured elevations of one mapper and the data behind its safety estimate.

    The fusion of several mappers uses them instead of the finished hazard map.

    Attributes
    ----------
    surface
        Elevations: the hazard map of the mapper, or the elevation map from which it is computed.
    site_evidence
        Inputs of the safety calibration for each site, such as slope and roughness relative to the
        limits of the lander; None if not available.
    scenario_calibration
        Last stage of the safety calibration, fitted to the scenario; None: the calibration supplied
        with lunarsim.
    residual_heights
        Height of the elevation sample in each cell above a plane fitted to the terrain around it
        (rows, cols), m; NaN without a sample. None if not available.
    compute_map
        Function that computes the hazard map of the mapper; None if `surface` is that map.

    Raises
    ------
    InputError
        If `residual_heights` does not have the shape of the map, or if neither `surface` nor
        `compute_map` provides a map.
    """

    surface: TerrainSurface
    site_evidence: MapEvidence | None = None
    scenario_calibration: ScenarioCalibration | None = None
    residual_heights: NDArray[np.float32] | None = None
    compute_map: Callable[[], HazardMap] | None = None

    def __post_init__(self) -> None:
        if self.compute_map is None and not isinstance(self.surface, HazardMap):
            raise InputError(
                "evidence.surface",
                type(self.surface),
                "must be a HazardMap if compute_map is omitted",
            )
        if self.residual_heights is not None:
            check_shape(
                "evidence.residual_heights", self.residual_heights, self.surface.grid.shape,
                "like the grid of surface",
            )  # fmt: skip

    @cached_property
    def hazard_map(self) -> HazardMap:
        """Hazard map of the mapper."""
        if self.compute_map is not None:
            return self.compute_map()
        assert isinstance(self.surface, HazardMap)
        return self.surface


@dataclass(frozen=True)
class RockEvidence:
    """Detected and expected undetected rocks of one rock mapper, for fusion.

    Attributes
    ----------
    hazard_map
        Hazard map of the mapper.
    diameter
        Lower edges of the size classes (sizes,), ascending, m.
    undetected_ratio
        Expected number of undetected rocks of each class, divided by the number expected before any
        observation (sizes, rows, cols); 1 where nothing was observed.
    tracks
        Tracked rocks, including detections that are not yet confirmed.
    clear_probability
        Function that takes tracked rocks and returns the probability that none of them reaches
        under a lander centred on each cell (rows, cols).
    undetected_probability
        Probability that an undetected rock reaches under a lander centred on each cell (rows,
        cols); None if not available.
    expected_detections
        Number of hazardous rocks that the mapper should have detected so far according to the
        expected rock population.

    Raises
    ------
    InputError
        If `undetected_ratio` or `undetected_probability` has the wrong shape, or if
        `undetected_probability` is not a probability.
    """

    hazard_map: HazardMap
    diameter: Array
    undetected_ratio: NDArray[np.float32]
    tracks: RockTracks
    clear_probability: Callable[[RockTracks], Array]
    undetected_probability: NDArray[np.float32] | None = None
    expected_detections: float = 0.0

    def __post_init__(self) -> None:
        field, p = "evidence.undetected_probability", self.undetected_probability
        if p is not None:
            check_shape(field, p, self.hazard_map.grid.shape, "like the grid of hazard_map")
            check_elements(field, p, (p >= 0.0) & (p <= 1.0), "must be between 0 and 1")
        check_shape(
            "evidence.undetected_ratio", self.undetected_ratio,
            (len(self.diameter), *self.hazard_map.grid.shape),
            f"for {len(self.diameter)} diameters",
        )  # fmt: skip


FusionEvidence = TerrainEvidence | RockEvidence
