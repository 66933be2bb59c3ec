"""Navigation filter: one error state and the processors of its measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lunarsim._blas import one_blas_thread
from lunarsim.frames import SiteToLocal, quat_from_rotation_vector, quat_to_matrix
from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.aiding_measurements import AidingMeasurements, aiding_blocks
from lunarsim.onboard.navigation.error_state import REFERENCE_POSE, ErrorState
from lunarsim.onboard.navigation.estimate import (
    Estimate,
    MapRotation,
    Navigation,
    NavigationEvent,
)
from lunarsim.onboard.navigation.inertial import (
    ATTITUDE,
    INERTIAL,
    StartSigmas,
    StrapdownState,
)
from lunarsim.onboard.navigation.innovation_monitor import InnovationMonitor
from lunarsim.onboard.navigation.local_frame import LocalFrame, empty_map_block
from lunarsim.onboard.navigation.map_matcher import MapMatcher
from lunarsim.onboard.navigation.measurement_processor import (
    FilterContext,
    MeasurementProcessor,
    maximum_sigmas,
    scanner_blocks,
)
from lunarsim.onboard.navigation.measurement_sequencer import MeasurementSequencer
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.scan_health import is_noisy, range_noise, remove_spikes
from lunarsim.onboard.navigation.scan_odometry import (
    ScanOdometry,
    reference_pose_block,
    remove_implausible_ranges,
    scan_width,
)
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from lunarsim.typing import Array


class Navigator(Navigation):
    """Error-state Kalman filter that fuses all sensors, with LiDAR map matching.

    Inertial samples propagate the filter. The pose is kept in the local frame. This frame starts at
    the initial position estimate and is then anchored to the terrain of the first scan; its offset
    from the site frame is part of the state (`LocalFrame`). Each measurement is offered to a list
    of processors in order, and is used once only. A scan is registered on the map; if that fails,
    it is registered on an earlier scan. Rocks detected by their shadows are states at the end of
    the error state; the hazard mapper that tracks the rocks provides the observations.

    Parameters
    ----------
    inertial
        Initial state estimate, site frame.
    start_sigmas
        Standard deviations of the initial state.
    prior
        Prior map; if None, scans are only registered on each other.
    instruments
        Calibrations of the sensors, by name.
    terrain_prior
        Prior knowledge of the terrain height.
    rocks
        Whether rocks are tracked.

    Attributes
    ----------
    state, frame
        The error state, and the transformation between site frame and local frame.
    events
        Events reported so far.
    processors
        Measurement processors, in the order in which they are offered measurements.
    matcher
        Processor that registers scans on the prior map; None without a map.
    rocks
        Filter of the rock positions; None if no rocks are tracked.
    """

    has_local_azimuth: ClassVar[bool] = True

    def __init__(
        self,
        inertial: StrapdownState,
        start_sigmas: StartSigmas,
        prior: PriorMap | None = None,
        *,
        instruments: Mapping[str, Any] | None = None,
        terrain_prior: TerrainPrior | None = None,
        rocks: bool = False,
    ) -> None:
        terrain, calibrations = terrain_prior or TerrainPrior(), instruments or {}
        blocks = (
            reference_pose_block()
            | aiding_blocks(calibrations, terrain)
            | empty_map_block()
            | scanner_blocks(calibrations)
        )
        self.state = ErrorState(inertial, start_sigmas, blocks=blocks)
        self.frame = LocalFrame(self.state)
        self.events: list[NavigationEvent] = []
        self._aiding = AidingMeasurements(self.state, calibrations, terrain, self.events)
        self._arrivals = MeasurementSequencer(inertial.step, self._add_event)
        shared = FilterContext(self.state, self._aiding, self.events, maximum_sigmas(self.state))
        self.matcher = None if prior is None else MapMatcher(shared, self.frame, prior)
        self.processors: list[MeasurementProcessor] = [] if self.matcher is None else [self.matcher]
        self.processors += [ScanOdometry(shared), self._aiding]
        self.rocks = RockFilter(self.state, self._aiding) if rocks else None
        self._context = shared
        self._is_anchored = False
        self._noisy: set[str] = set()
        self._map_rotation: MapRotation | None = None
        self.state.listeners.append(self._rotate_map)

    # --- state ----------------------------------------------------------------------------

    @property
    def inertial(self) -> StrapdownState:
        """Estimated state of the lander (pose, velocity, biases), local frame."""
        return self.state.inertial

    @property
    def covariance(self) -> Array:
        """Covariance of the error state: lander (15, local frame), blocks, rocks (3 n).

        The blocks are named groups of errors, such as sensor biases and the map offset.
        """
        return self.state.covariance

    @property
    def monitors(self) -> dict[str, InnovationMonitor]:
        """Innovation monitors by name: "SENSOR KIND", for images "rocks' KIND".

        KIND is the kind of measurement, for example "range".
        """
        corrected = {} if self.rocks is None else self.rocks.image_monitor.monitors
        return {**self._aiding.monitors, **{f"rocks' {kind}": w for kind, w in corrected.items()}}

    @property
    def lost(self) -> bool:
        """Whether measurements or rock observations contradict the estimate."""
        return self._aiding.lost or (self.rocks is not None and self.rocks.lost)

    @property
    def locked(self) -> bool:
        """Whether the scans currently agree with the prior map."""
        return self.matcher is not None and self.matcher.locked

    @property
    def has_located(self) -> bool:
        """Whether a scan was located on the prior map at least once."""
        return self.matcher is not None and self.matcher.has_located

    @property
    def is_drifting(self) -> bool:
        """Whether neither the prior map nor tracked rocks bound the position error."""
        return not self.locked and (self.rocks is None or self.rocks.count == 0)

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the lander's state at `time` (s) in the local frame, with mass (kg).

        The covariance is that of the state in the site frame. The state is not propagated to
        `time`.
        """
        local = self.inertial.estimate(self.state.covariance_of(np.arange(INERTIAL)), time, mass)
        # The error state has attitude errors in body axes, `Estimate` has them in ENU.
        turn = np.eye(9)
        turn[6:, 6:] = self.frame.rotation @ quat_to_matrix(self.inertial.attitude)
        covariance = turn @ self.frame.covariance_in_site() @ turn.T
        return replace(local, covariance=covariance, lost=self.lost)

    @property
    def site_to_local(self) -> SiteToLocal:
        """Estimated transformation from the site frame to the local frame."""
        return self.frame.site_to_local

    def _add_event(self, time: float, name: str, details: dict[str, Any]) -> None:
        self.events.append(NavigationEvent(time, name, details))

    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Update the filter with one measurement of a named sensor.

        A measurement that is unusable or out of order is ignored.

        Raises
        ------
        InputError
            If `time` (s) is before the time of an earlier call.
        """
        measurement = self._arrivals.admit_and_propagate(sensor, measurement, time, self.propagate)
        for name, details in self.inertial.pop_events():
            self.events.append(NavigationEvent(time, name, details))
        if measurement is None:
            return
        scan = isinstance(measurement, LidarScan)
        if scan:
            measurement = remove_spikes(remove_implausible_ranges(measurement))
            if not np.isfinite(scan_width(measurement)) or self._check_noise(
                sensor, measurement, time
            ):
                return
            self._anchor_frame(sensor, measurement)
        with one_blas_thread():
            self._offer_to_processors(sensor, measurement, time)

    def _check_noise(self, sensor: str, scan: LidarScan, time: float) -> bool:
        """Return whether a scan is too noisy; record an event when this begins or ends.

        The events are "scans-rejected" and "scans-accepted", per `sensor`.
        """
        noisy = is_noisy(scan)
        if noisy != (sensor in self._noisy):
            (self._noisy.add if noisy else self._noisy.discard)(sensor)
            name = "scans-rejected" if noisy else "scans-accepted"
            self._add_event(time, name, {"sensor": sensor, "noise": range_noise(scan)})
        return noisy

    def _offer_to_processors(self, sensor: str, measurement: Any, time: float) -> None:
        """Pass a measurement to all processors in order; later ones learn if it was used."""
        used = False
        for part in self.processors:
            used = part.take(sensor, measurement, time, used=used) or used

    def correct_measurement(
        self, sensor: str, measurement: Any, now: Estimate
    ) -> tuple[Any, Estimate]:
        """Return a scan and its pose (`now`), corrected for estimated scanner errors.

        Measurements of other types are returned unchanged.
        """
        if not isinstance(measurement, LidarScan):
            return measurement, now
        corrected = self._context.correct_scan(sensor, measurement)
        return corrected.scan, replace(
            now, position=corrected.position, attitude=corrected.attitude
        )

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Propagate the filter with inertial samples; NaN marks missing samples.

        `angle` (n, 3), rad, and `velocity` (n, 3), m/s, are the increments of gyroscopes and
        accelerometers.
        """
        self.state.propagate(angle, velocity)
        self._aiding.add_terrain_noise()
        self._aiding.check_sensor_biases()

    @property
    def map_rotation(self) -> MapRotation | None:
        """Rotation of the mapped terrain by tilt corrections; None before the first scan."""
        return self._map_rotation

    def _rotate_map(self, error: Array) -> None:
        """Add the tilt part of a correction (size,) to the rotation of the mapped terrain.

        Nothing is done before the first scan.
        """
        if self._map_rotation is None:
            return
        tilt = quat_to_matrix(self.inertial.attitude) @ error[ATTITUDE] * [1.0, 1.0, 0.0]
        turn = quat_to_matrix(quat_from_rotation_vector(tilt))
        self._map_rotation = replace(
            self._map_rotation, rotation=turn @ self._map_rotation.rotation
        )

    def _anchor_frame(self, sensor: str, scan: LidarScan) -> None:
        """Anchor the local frame to the terrain of the first scan; ignore later scans."""
        if self._is_anchored:
            return
        self._is_anchored = True
        corrected = self._context.correct_scan(sensor, scan)
        columns, jacobian = self._context.local_jacobian(sensor)
        middle = np.nanmean(corrected.points(), axis=0)
        self._map_rotation = MapRotation(np.eye(3), middle)
        places = [self.state.block(REFERENCE_POSE).start]
        if self.rocks is not None:
            places += self.rocks.state_indices()[:, 0].tolist()
        self.frame.anchor(
            corrected.point_jacobian(middle) @ jacobian, columns, [slice(k, k + 3) for k in places]
        )
