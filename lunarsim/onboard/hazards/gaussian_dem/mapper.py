"""Mapper that converts LiDAR scans to a Gaussian DEM and a `HazardMap`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim.onboard.calibration.scenario_calibration import ScenarioCalibration
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import DemSnapshot
from lunarsim.onboard.hazards.gaussian_dem.pooled import PooledDem, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.samples import SamplePool
from lunarsim.onboard.hazards.gaussian_dem.scan_noise import with_estimated_noise
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface
from lunarsim.onboard.hazards.isolated_returns import without_isolated_returns
from lunarsim.onboard.hazards.map_evidence import TerrainEvidence
from lunarsim.onboard.hazards.map_tilt_correction import UnleveledScans
from lunarsim.onboard.hazards.map_update_timer import MapUpdateTimer
from lunarsim.onboard.hazards.mapper import (
    HazardMapper,
    calibration_path_error,
    is_off_centre,
    map_grid,
)
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import footprint_of, plane_stochastic_safety, stochastic_safety
from lunarsim.typing import Array

SafetyTest = Literal["calibrated", "level", "planes"]

# Spread of the height differences between a scan and the map from which on the scan is rejected,
# over the roughness limit: as the largest noise of the calibrated domain. In flights over the
# scenarios golombek, hirise, instruments and hard, it is at most 0.32; in dense dust it exceeds 1.
_MAX_SPREAD_RATIO = 0.5


@dataclass(frozen=True)
class GaussianDemMapperSettings:
    """Settings of a hazard mapper that builds a Gaussian DEM from LiDAR scans.

    Attributes
    ----------
    sensor
        Name of the LiDAR.
    posting, size
        Sides of a cell and of the map, m.
    safety
        Test of landing safety: ``"calibrated"``, ``"level"`` or ``"planes"``, as explained for
        `GaussianDemMapper`.
    interval
        Minimum time between two updates of the map, s.
    calibration_path
        File for `ScenarioCalibration.load`; None: the calibration supplied with lunarsim.

    Raises
    ------
    InputError
        If the calibration file is missing or invalid, or if it is given and `safety` is not
        ``"calibrated"``.
    """

    sensor: str = quantity("flash", help="name of the LiDAR whose scans are mapped")
    posting: float = quantity(0.2, "m", gt=0, help="side of a map cell")
    size: float = quantity(100.0, "m", gt=0, help="side of the square map centred on the target")
    safety: SafetyTest = quantity(
        "calibrated",
        help="safety test: calibrated (calibrated probability that slope, roughness and belly "
        "clearance are within the limits), level (uncalibrated, from the highest and "
        "lowest terrain below a horizontal lander) or planes (uncalibrated, from the "
        "planes on which the legs can rest)",
    )
    interval: float = quantity(
        1.0, "s", ge=0, le=10, help="minimum time between two updates of the map"
    )
    calibration_path: Path | None = quantity(
        None,
        help="calibration file written by `lunarsim calibrate`, relative to the scenario file; "
        "omitted: calibration supplied with lunarsim",
    )

    accepts: ClassVar[type] = LidarScan
    publishes: ClassVar[type] = TerrainEvidence

    def __post_init__(self) -> None:
        check_bounds(self, "mappers")
        if self.calibration_path is not None and self.safety != "calibrated":
            raise InputError(
                "calibration_path", str(self.calibration_path),
                f"must be omitted if safety is {self.safety!r}", "Use safety = 'calibrated'.",
            )  # fmt: skip
        self.calibration()

    def calibration(self) -> ScenarioCalibration | None:
        """Read the calibration in `calibration_path`; None if the path is omitted.

        Raises
        ------
        InputError
            If the file is missing, invalid, or fitted to another regression.
        """
        if self.calibration_path is None:
            return None
        try:
            found = ScenarioCalibration.load(self.calibration_path)
            found.check_regression(GAUSSIAN_DEM.packaged)
        except InputError as error:
            raise calibration_path_error(self.calibration_path, error) from None
        return found

    def build(self, briefing: Briefing, navigation: Navigation) -> GaussianDemMapper:
        """Build the mapper of one flight from the data known before it."""
        return GaussianDemMapper(
            map_grid(briefing.target, self.size, self.posting, briefing.lander),
            briefing.lander,
            safety=self.safety,
            refit=self.calibration(),
            interval=self.interval,
            rocks=briefing.rocks,
            beam_ratio=getattr(briefing.instruments.get(self.sensor), "beam_ratio", 0.0),
        )


class GaussianDemMapper(HazardMapper):
    """Hazard mapper that builds a Gaussian DEM from scans and evaluates its safety.

    Parameters
    ----------
    grid
        Cells of the map, estimated ENU frame.
    lander
        Geometry and limits of the lander.
    safety
        ``"calibrated"``: calibrated probability; outside its domain a heuristic value (see
        `lunarsim.onboard.calibration`). ``"level"``: conservative test of Eqs. 15 to 17 of the
        Gaussian DEM paper, which compares highest and lowest terrain. ``"planes"``: the same test
        with the actual support planes of the legs, which keeps safe sites on sloping terrain.
    rocks
        Rock population expected by the mission; default: the defaults of `RockExpectation`.
    refit
        Last stage of the safety calibration, fitted to the scenario; default: the calibration
        supplied with lunarsim.
    interval
        Minimum time between two updates of the map, s. Until `refresh` has set a time, each new
        scan causes an update.
    beam_ratio
        Standard deviation of the beam's intensity over the spacing of the samples, from
        `LidarInstrument`; 0: a line.

    Raises
    ------
    InputError
        If `safety` is unknown, `refit` does not fit `safety` or the lander, the lander has no
        footprint on these cells, or `rocks` is invalid.
    """

    def __init__(
        self,
        grid: Grid,
        lander: Lander,
        *,
        safety: SafetyTest = "calibrated",
        rocks: RockExpectation | None = None,
        refit: ScenarioCalibration | None = None,
        interval: float = 0.0,
        beam_ratio: float = 0.0,
    ) -> None:
        footprint_of(lander, grid.posting)
        if not isinstance(safety, str) or safety not in ("calibrated", "level", "planes"):
            raise InputError("safety", safety, "must be 'calibrated', 'level' or 'planes'")
        if refit is not None:
            if safety != "calibrated":
                raise InputError("safety", safety, "must be 'calibrated' if refit is given")
            refit.check(lander, GAUSSIAN_DEM.packaged)
        self.grid = grid
        self.lander = lander
        self.refit = refit
        self.safety = safety
        self.rocks = RockExpectation.or_default(rocks)
        self.beam_ratio = beam_ratio
        self._samples, self._provisional = SamplePool(grid), SamplePool(grid)
        self._unleveled = UnleveledScans()
        self._displacement = np.zeros(3)
        self._is_consistent, self._max_tilt_sigma = True, 0.0
        self._map: HazardMap | DemSnapshot = HazardMap.unobserved(grid)
        self._timer, self._is_outdated = MapUpdateTimer(interval), False

    def update(self, measurement: LidarScan, estimate: Estimate) -> None:
        """Add a scan taken at the estimated pose; ignore isolated returns and empty scans.

        If the noise of the scan is clearly larger than stated, the estimated noise is used. If a
        scan is tilted relative to earlier ones by more than the stated attitude errors explain, the
        map leaves its calibrated domain: it is not known which scan is wrong.

        Raises
        ------
        InputError
            If the scan or the pose is invalid, as in `LidarScan.check`.
        """
        measurement.check(estimate.position, estimate.attitude)
        scan = with_estimated_noise(without_isolated_returns(measurement, estimate.attitude))
        points = scan.points(estimate.position, estimate.attitude)
        early = self._unleveled.includes(estimate.tilt_sigma)
        self._max_tilt_sigma = float(np.maximum(self._max_tilt_sigma, estimate.tilt_sigma))
        if not self._align_to(points):
            return
        taken = (self._provisional if early else self._samples).add(
            points,
            scan.height_sigma(estimate.attitude),
            scan.spacing(estimate.attitude),
        )
        self._is_outdated |= taken > 0

    def _align_to(self, points: Array) -> bool:
        """Shift the map and all stored samples to the position of a new scan.

        `points` (n, 3) are the new scan, local frame, m. Only significant offsets are corrected.
        The result is False for a scan that contradicts the samples, for instance because it sees
        dust: its heights differ from theirs by more than half of the roughness limit, 1 sigma. It
        changes no sample, and the map leaves its calibrated domain.
        Samples at two heights would look like steps all over the map, and rocks at two places like
        wider and lower rocks. The newest scan defines the position, because guidance uses it.
        """
        found = self.pool.offset(points)
        if found is None:
            return True
        is_rejected = found.spread > _MAX_SPREAD_RATIO * self.lander.roughness_limit
        if is_rejected or found.is_tilted(self._max_tilt_sigma):
            self._is_consistent, self._is_outdated = False, True
        if is_rejected or not found.shift.any():
            return not is_rejected
        self._samples, self._provisional = (
            one.shifted(found.shift) for one in (self._samples, self._provisional)
        )
        self.grid = self._samples.grid
        self._displacement = self._displacement + found.shift
        self._timer.force_update()
        return True

    @property
    def displacement(self) -> Array:
        """Sum of all shifts (3,) of the samples to the positions of newer scans, m."""
        return self._displacement

    @property
    def pool(self) -> SamplePool:
        """All samples: the final ones, and those that tilt corrections may still rotate."""
        return self._samples.union(self._provisional)

    def correct_tilt(self, turn: Array, pivot: Array, tilt_sigma: float) -> None:
        """Rotate the samples that were measured before the tilt of the lander was known.

        Parameters
        ----------
        turn, pivot
            Rotation matrix (3, 3) and the point (3,) about which the samples are rotated, local
            frame, m.
        tilt_sigma
            Current standard deviation of the tilt, rad.
        """
        if self._provisional.base is None:
            return
        self._provisional = self._provisional.rotated(turn, pivot)
        self._is_outdated = True
        if self._unleveled.is_tilt_known(tilt_sigma):
            self._samples, self._provisional = self.pool, SamplePool(self.grid)

    def dem(self) -> PooledDem:
        """Compute mean and variance of the elevation from all samples."""
        return pooled_dem(self.pool)

    def terrain_surface(self) -> TerrainSurface:
        """Update the elevations if an update is due, and return them."""
        return self._updated()

    def _updated(self) -> HazardMap | DemSnapshot:
        """Recompute the map if an update is due, and return the current map."""
        if self._is_outdated and self._timer.is_due:
            self._map, self._is_outdated = self._compute(self.dem()), False
            self._timer.mark_updated()
        return self._map

    def hazard_map(self) -> HazardMap:
        """Update the hazard map if an update is due, and return it."""
        snapshot = self._updated()
        return snapshot.hazard_map if isinstance(snapshot, DemSnapshot) else snapshot

    def evidence(self) -> TerrainEvidence | None:
        """Return the elevations and the inputs of their safety calibration, for fusion.

        None before the first return. With an uncalibrated safety test, the result contains the
        hazard map only.
        """
        snapshot = self._updated()
        if self.is_empty:
            return None
        if isinstance(snapshot, HazardMap):
            return TerrainEvidence(snapshot)
        return TerrainEvidence(
            snapshot,
            snapshot.site_evidence,
            self.refit,
            snapshot.residual_heights,
            compute_map=lambda: snapshot.hazard_map,
        )

    def refresh(self, time: float) -> None:
        """Set the current time (s), on which the update interval depends."""
        self._timer.set_time(time)

    def _compute(self, dem: PooledDem) -> HazardMap | DemSnapshot:
        """Evaluate the landing safety of elevations; return an empty map without samples."""
        if not len(dem.sampling.residual_heights):
            return HazardMap.unobserved(self.grid)
        if self.safety == "calibrated":
            return DemSnapshot(
                dem, self.lander, self.rocks, self.refit, self.beam_ratio, self._is_consistent
            )
        observed_mean = np.where(dem.observed, dem.mean, np.float32(np.nan))
        test = plane_stochastic_safety if self.safety == "planes" else stochastic_safety
        safety = test(observed_mean, dem.variance, self.grid, self.lander)
        return HazardMap(self.grid, safety.p_safe, safety.observed, dem.mean, dem.variance)

    @property
    def is_empty(self) -> bool:
        """Whether no LiDAR return has fallen on the map yet."""
        return self._samples.base is None and self._provisional.base is None

    def recentre(self, centre: Array) -> None:
        """Move the map to another centre (3,), local frame, m, if it is too far from it.

        An empty map is always moved. Samples that leave the map are dropped.
        """
        if not (self.is_empty or is_off_centre(self.grid, centre)):
            return
        self._samples, self._provisional = self._pools_about(centre)
        self.grid = self._samples.grid
        self._is_consistent |= self.is_empty
        self._map, self._is_outdated = HazardMap.unobserved(self.grid), not self.is_empty
        self._timer.force_update()

    def _pools_about(self, centre: Array) -> tuple[SamplePool, SamplePool]:
        """Return the final and the provisional samples on one grid about a point (3,), m.

        Provisional samples were measured before the tilt of the lander was known.
        """
        both = self.pool.about(centre)
        if both.base is None:
            return both, SamplePool(both.grid)
        # Grids with samples move by integer numbers of cells, so that both pools stay aligned.
        return tuple(  # type: ignore[return-value]
            SamplePool(both.grid) if one.base is None else one.on_shifted_grid(both.grid)
            for one in (self._samples, self._provisional)
        )
