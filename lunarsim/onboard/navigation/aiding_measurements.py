"""Update the filter with ranges, speeds and attitudes; monitor all innovations."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import chdtri

from lunarsim.errors import InputError
from lunarsim.frames import quat_rotate
from lunarsim.messages.measurements import AltimeterReading, AttitudeReading, DopplerReading
from lunarsim.models.instruments import (
    AltimeterInstrument,
    LidarInstrument,
    StarTrackerInstrument,
    VelocimeterInstrument,
)
from lunarsim.onboard.navigation.corrected_scan import scanner_block, scanner_covariance
from lunarsim.onboard.navigation.error_state import MAP, ErrorState, UpdateOutcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.inertial import (
    ACCELEROMETER,
    ATTITUDE,
    GYROSCOPE,
    POSITION,
    VELOCITY,
)
from lunarsim.onboard.navigation.innovation_monitor import (
    InnovationMonitor,
    InnovationMonitorSettings,
    MonitorResult,
)
from lunarsim.onboard.navigation.measurement_models import (
    MIN_DOWN_COSINE,
    speed_bias_model,
    update_with_attitude,
    update_with_range,
    update_with_speeds,
)
from lunarsim.onboard.navigation.terrain_heights import TERRAIN, TerrainPrior
from lunarsim.typing import Array, IntArray
from lunarsim.value_checks import check_shape, check_time

# Mean number of valid measurements per false rejection.
_SAMPLES_PER_FALSE_REJECTION = 20_000.0
# Maximum standard deviations after covariance inflation: m/s, rad, m.
_MAX_SPEED_SIGMA_M_S, _MAX_ATTITUDE_SIGMA_RAD, _MAX_HEIGHT_SIGMA_M = 30.0, 0.2, 300.0
# Limits of the factor by which an inflation multiplies variances.
_MIN_GROWTH, _MAX_GROWTH = 4.0, 1e4
# Velocity and attitude cannot jump, but the terrain height under the lander can.
MONITOR_SETTINGS = {
    "range": InnovationMonitorSettings(),
    # A drift between a velocimeter and the inertial unit cannot be attributed to one of them.
    "speed": InnovationMonitorSettings(max_inflations=None, drift_time_scale_s=8.0, max_drifts=0),
    "attitude": InnovationMonitorSettings(
        max_inflations=None, drift_time_scale_s=8.0, max_drifts=0
    ),
    # An outdated part of a map is rejected for as long as it is in view.
    "map": InnovationMonitorSettings(min_count=10, max_rejected_share=0.8, drift_time_scale_s=8.0),
    # Good fits at another place: a scanner error explains only the first alarm.
    "fits": InnovationMonitorSettings(min_count=10, max_rejected_share=0.8, max_inflations=1),
    # The noise of the reference scan is common to all comparisons with it, so they are correlated.
    "scans": InnovationMonitorSettings(),
}
# Bias that explains a drift of a sensor, and its standard deviation after a drift: m/s^2, rad/s.
_BIASES = {"speed": (ACCELEROMETER, 0.1), "attitude": (GYROSCOPE, 2e-3)}
# Maximum ratio of an estimated bias to its standard deviation; more contradicts the specification.
_MAX_BIAS_RATIO = 6.0
# Minimum number of beams to identify a faulty one, and the velocity error (m/s) that a faulty beam
# can cause before it is detected.
_MIN_BEAMS, _FAULT_VELOCITY_M_S = 3, 0.1
# Minimum number of accepted speeds of each beam before a faulty beam can be identified. Without
# such a history it is unknown which of two contradicting beams is faulty.
_MIN_BEAM_HISTORY = 30


@lru_cache
def innovation_gate(degrees: int) -> float:
    """Return the maximum accepted normalised innovation squared for a chi-square test.

    `degrees` is the number of degrees of freedom. One in 20,000 valid measurements is rejected.
    """
    return float(chdtri(degrees, 1.0 / _SAMPLES_PER_FALSE_REJECTION))


def aiding_blocks(instruments: Mapping[str, Any], terrain_prior: TerrainPrior) -> dict[str, Array]:
    """Return initial covariances of the errors that aiding sensors add to the state.

    The result maps the name of each block (group of errors) to its covariance (k, k): terrain
    height, terrain heights at the beam footprints, speed biases, star-tracker misalignments. The
    blocks of terrain heights are omitted if the prior terrain height is exact.

    Parameters
    ----------
    instruments
        Calibrations of the sensors, by name.
    terrain_prior
        Prior knowledge of the terrain height.
    """
    out = {} if terrain_prior.sigma is None else {TERRAIN: np.array([[terrain_prior.sigma**2]])}
    for name, instrument in instruments.items():
        beams = {
            AltimeterInstrument: 1,
            VelocimeterInstrument: len(getattr(instrument, "directions", ())),
        }
        if terrain_prior.sigma is not None and type(instrument) in beams:
            out[_footprint_block(name)] = terrain_prior.sigma**2 * np.eye(beams[type(instrument)])
        if isinstance(instrument, VelocimeterInstrument):
            out[_speed_block(name)] = speed_bias_model(instrument)[0] ** 2 * np.eye(
                len(instrument.directions)
            )
        if isinstance(instrument, StarTrackerInstrument):
            out[_mount_block(name)] = instrument.misalignment**2 * np.eye(3)
    return out


def _mount_block(sensor: str) -> str:
    """Return the name of the error block with a star tracker's misalignment."""
    return f"mount of {sensor}"


def _footprint_block(sensor: str) -> str:
    """Return the name of the error block with terrain heights at beam footprints."""
    return f"ground under {sensor}"


def _speed_block(sensor: str) -> str:
    """Return the name of the error block with a velocimeter's speed biases."""
    return f"speeds of {sensor}"


def check_scalar_reading(sensor: str, reading: AltimeterReading) -> None:
    """Raise an `InputError` unless an altimeter reading has one range and one sigma."""
    for name in ("range", "sigma"):
        shape = np.shape(getattr(reading, name))
        if shape:
            raise InputError(
                f"{sensor}.{name}", shape, f"must be one number, not an array of shape {shape}",
                show_value=False,
            )  # fmt: skip


class AidingMeasurements:
    """Updates the filter with ranges, speeds and attitudes; monitors all innovations.

    Parameters
    ----------
    state
        Error state with the blocks of `aiding_blocks`.
    instruments
        Calibrations of the sensors, by name.
    terrain_prior
        Prior knowledge of the terrain height.
    events
        List that receives the events "covariance-inflated", "drift", "beam-excluded", "lost" and
        "recovered".
    """

    def __init__(
        self,
        state: ErrorState,
        instruments: Mapping[str, Any],
        terrain_prior: TerrainPrior,
        events: list[NavigationEvent],
    ) -> None:
        self.state = state
        self.terrain_prior = terrain_prior
        self._events = events
        self._beams = {n: i for n, i in instruments.items() if isinstance(i, AltimeterInstrument)}
        self._beam_sets = {
            n: np.array(i.directions)
            for n, i in instruments.items() if isinstance(i, VelocimeterInstrument)
        }  # fmt: skip
        # Initial speed bias of a beam (m/s), and its random walk in 1 s.
        self._speed_errors = {
            n: speed_bias_model(i)
            for n, i in instruments.items()
            if isinstance(i, VelocimeterInstrument)
        }
        # Specified standard deviations of sensor biases: sensor, name, deviations, by block.
        self._specified: dict[str, tuple[str, str, Any]] = {
            _speed_block(n): (n, "speeds", stated) for n, (stated, _) in self._speed_errors.items()
        }
        for name, instrument in instruments.items():
            if isinstance(instrument, LidarInstrument):
                deviations = np.sqrt(scanner_covariance(instrument).diagonal())
                self._specified[scanner_block(name)] = (name, "scanner", deviations)
        self._star_trackers = {
            n for n, i in instruments.items() if isinstance(i, StarTrackerInstrument)
        }
        self._monitors: dict[tuple[str, str], InnovationMonitor] = {}
        self._last_position = state.inertial.position[:2].copy()
        self._footprints: dict[tuple[str, int], Array] = {}
        self._last_reading: dict[str, float] = {}
        self._time = -np.inf
        # Beams excluded after a fault; whether a bias contradicts a sensor's specification.
        self._excluded: set[tuple[str, int]] = set()
        self._has_contradiction = False

    @property
    def events(self) -> list[NavigationEvent]:
        """Events reported so far."""
        return self._events

    @property
    def lost(self) -> bool:
        """Whether the measurements contradict the estimate."""
        return self._has_contradiction or any(monitor.lost for monitor in self._monitors.values())

    @property
    def monitors(self) -> dict[str, InnovationMonitor]:
        """Innovation monitors by "SENSOR KIND", for example "altimeter range"."""
        return {f"{sensor} {kind}": monitor for (sensor, kind), monitor in self._monitors.items()}

    def add_terrain_noise(self) -> None:
        """Add process noise to the terrain height for the distance since the last call.

        The distance is the horizontal movement of the lander. If the state has no error of the
        terrain height, nothing changes.
        """
        if not self.state.has(TERRAIN):
            return
        here = self.state.inertial.position[:2]
        moved = float(np.linalg.norm(here - self._last_position))
        self._last_position = here.copy()
        if np.isfinite(moved):
            at = [self.state.block(TERRAIN).start]
            self.state.add_process_noise(at, self.terrain_prior.growth * moved)

    def check_sensor_biases(self) -> None:
        """Declare navigation lost if an estimated bias contradicts its specification.

        Either the sensor does not meet its specification, or another measurement that affects the
        bias estimate drifts. The first case does not affect velocity and attitude, but in the
        second case they drift too. The two cases cannot be distinguished. Likewise, an undetected
        rotation of the lander cannot be distinguished from a boresight error of the scanner.
        """
        if self._has_contradiction:
            return
        own = self.state.inertial
        biases = [
            ("inertial unit", name, place, value, stated)
            for name, place, value, stated in zip(
                ("accelerometers", "gyroscopes"), (ACCELEROMETER, GYROSCOPE), own.biases,
                own.bias_sigma, strict=True,
            )
        ]  # fmt: skip
        for block, (sensor, name, deviation) in self._specified.items():
            if self.state.has(block):
                place, value = self.state.block(block), self.state.value(block)
                biases.append((sensor, name, place, value, deviation))
        for sensor, name, place, value, stated in biases:
            variance = (
                self.state.covariance_of(np.arange(self.state.head)[place]).diagonal() + stated**2
            )
            if (value**2 > _MAX_BIAS_RATIO**2 * variance).any():
                self._has_contradiction = True
                self._add_event(self._time, "lost", sensor, name)
                return

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool = False) -> bool:
        """Process a range, speed or attitude measurement; return whether it was used.

        A measurement that an earlier processor has `used` is skipped. `time` is in s. The result is
        False for other measurement types.

        Raises
        ------
        InputError
            If time runs backwards, or the arrays of a reading have wrong shapes.
        """
        check_time("time", time, self._time)
        self._time = time
        if used:
            return False
        if isinstance(measurement, AltimeterReading):
            check_scalar_reading(sensor, measurement)
            beam = self._beams[sensor].boresight if sensor in self._beams else (0.0, 0.0, -1.0)
            self._range(sensor, measurement.range, measurement.sigma, beam, time)
        elif isinstance(measurement, DopplerReading):
            self._doppler(sensor, measurement, time)
        elif isinstance(measurement, AttitudeReading):
            block = _mount_block(sensor) if sensor in self._star_trackers else None
            outcome = update_with_attitude(
                self.state, measurement.attitude, measurement.covariance, block=block,
                gate=innovation_gate(3),
            )  # fmt: skip
            columns = np.arange(ATTITUDE.start, ATTITUDE.stop)
            if block is not None:
                own = self.state.block(block)
                columns = np.concatenate((columns, np.arange(own.start, own.stop)))
            self.record_outcome(sensor, "attitude", outcome, columns, _MAX_ATTITUDE_SIGMA_RAD, time)
        else:
            return False
        return True

    def _doppler(self, sensor: str, reading: DopplerReading, time: float) -> None:
        beams = self._beam_sets.get(sensor)
        if beams is None:
            return
        for name in ("speed", "speed_sigma", "range", "range_sigma"):
            n = len(beams)
            check_shape(f"{sensor}.{name}", getattr(reading, name), (n,), f"for {n} beams")
        self._add_bias_noise(sensor, time)
        outcomes = {
            k: self._speed(sensor, k, reading, beams)
            for k in range(len(beams)) if (sensor, k) not in self._excluded
        }  # fmt: skip
        self._monitor_beams(sensor, outcomes, time)
        for k, beam in enumerate(beams):
            distance, deviation = float(reading.range[k]), float(reading.range_sigma[k])
            self._range(sensor, distance, deviation, beam, time, k)

    def _add_bias_noise(self, sensor: str, time: float) -> None:
        """Add the random walk of a velocimeter's beam biases since its last reading.

        `time` is the time of the reading, s. If the state has no such biases, only the time is
        stored.
        """
        block, last = _speed_block(sensor), self._last_reading.get(sensor, time)
        self._last_reading[sensor] = time
        if self.state.has(block):
            own = np.arange(self.state.block(block).start, self.state.block(block).stop)
            random_walk = self._speed_errors[sensor][1]
            self.state.add_process_noise(own, random_walk**2 * (time - last) * np.eye(len(own)))

    def _speed(self, sensor: str, k: int, reading: DopplerReading, beams: Array) -> UpdateOutcome:
        one, block = slice(k, k + 1), _speed_block(sensor)
        own: dict[str, Any] = {}
        if self.state.has(block):
            place, value = self.state.block(block).start + k, self.state.value(block)[one]
            own = {"bias_indices": [place], "bias_estimates": value}
        return update_with_speeds(
            self.state,
            reading.speed[one],
            reading.speed_sigma[one],
            beams[one],
            innovation_gate(1),
            **own,
        )

    def _range(
        self, sensor: str, distance: float, sigma: float, beam: Any, time: float, number: int = 0
    ) -> None:
        columns = np.array([POSITION.start + 2])
        block, terrain_variance = None, 0.0
        if self.state.has(TERRAIN):
            columns = np.append(columns, self.state.block(TERRAIN).start)
            block = _footprint_block(sensor)
            if np.isfinite(distance) and self.state.has(block):
                columns = np.append(columns, self._move_footprint(sensor, beam, number))
            elif not self.state.has(block):
                block, number = TERRAIN, 0
                terrain_variance = self.terrain_prior.growth * float(
                    np.hypot(*self._footprint_offset(beam))
                )
        footprint = self.state.inertial.position[:2] + self._footprint_offset(beam)
        outcome = update_with_range(
            self.state, distance, sigma, beam, self.terrain_prior.elevation_at(footprint),
            block=block, index=number, terrain_variance=terrain_variance, gate=innovation_gate(1),
        )  # fmt: skip
        self.record_outcome(sensor, "range", outcome, columns, _MAX_HEIGHT_SIGMA_M, time)

    def _footprint_offset(self, beam: Any) -> Array:
        """Return the horizontal offset of a beam's footprint from the lander (2,), m.

        `beam` is the direction of the beam in body axes (3,).
        """
        inertial = self.state.inertial
        level = self.terrain_prior.elevation_at(inertial.position[:2])
        level += float(self.state.value(TERRAIN)[0]) if self.state.has(TERRAIN) else 0.0
        level += float(self.state.value(MAP)[2]) if self.state.has(MAP) else 0.0
        direction = quat_rotate(inertial.attitude, beam)
        height = max(float(inertial.position[2]) - level, 0.0)
        return np.asarray(height * direction[:2] / max(-float(direction[2]), MIN_DOWN_COSINE))

    def _move_footprint(self, sensor: str, beam: Any, number: int) -> int:
        """Move a beam's terrain-height state to its footprint; return its state index.

        `number` is the index of the beam among the beams of the sensor; `beam` (3,) is its
        direction in body axes. The new height is a weighted mean of the height at the last
        footprint and the height below the lander; the weight of the last one decays with the
        distance between the footprints, relative to their distance from the lander. Without such a
        state, the height difference between a slanted beam's footprint and the terrain below the
        lander would be averaged away like white noise, and terrain slopes would be taken for a
        tilt of the lander.
        """
        state, offset = self.state, self._footprint_offset(beam)
        footprint, distance = state.inertial.position[:2] + offset, float(np.hypot(*offset))
        last = self._footprints.get((sensor, number))
        weight = 0.0
        if last is not None and distance > 0.0:
            weight = float(np.exp(-np.hypot(*(footprint - last)) / distance))
        self._footprints[sensor, number] = footprint
        block = _footprint_block(sensor)
        at, below = int(state.block(block).start) + number, int(state.block(TERRAIN).start)
        value = state.value(block)
        value[number] = weight * value[number] + (1.0 - weight) * float(state.value(TERRAIN)[0])
        weights = np.array([weight, 1.0 - weight])
        state.replace_by_sum(
            at,
            np.array([at, below]),
            weights,
            self.terrain_prior.growth * distance * (1.0 - weight),
        )
        return at

    def _monitor_beams(self, sensor: str, outcomes: dict[int, UpdateOutcome], time: float) -> None:
        """Monitor the speeds of each velocimeter beam, and exclude a single faulty beam.

        `outcomes` contains the update outcome of each beam by number. A velocity error of the
        lander would affect all beams. If only one beam raises an alarm and all others agree with
        the estimate, that beam is excluded, and the variances of velocity and accelerometer bias
        are increased by the effect that its fault may have had. Other alarms inflate the
        covariance.
        """
        monitors = {k: self._monitor(sensor, _beam_kind(k)) for k in outcomes}
        before = {k: monitor.lost for k, monitor in monitors.items()}
        results = {k: monitor.record(time, outcomes[k]) for k, monitor in monitors.items()}
        alarms = [k for k, result in results.items() if result is not MonitorResult.CONSISTENT]
        calm_count = sum(
            monitor.is_calm(time) for k, monitor in monitors.items() if k not in alarms
        )
        is_single = (
            len(alarms) == 1 and calm_count == len(outcomes) - 1 and not any(before.values())
        )
        has_history = all(monitor.dof >= _MIN_BEAM_HISTORY for monitor in monitors.values())
        if is_single and has_history and len(outcomes) >= _MIN_BEAMS:
            self._excluded.add((sensor, alarms[0]))
            monitors[alarms[0]].lost = False
            self.state.add_process_noise(
                np.arange(VELOCITY.start, VELOCITY.stop), _FAULT_VELOCITY_M_S**2 * np.eye(3)
            )
            bias = np.arange(ACCELEROMETER.start, ACCELEROMETER.stop)
            self.state.raise_variances(bias, self.state.inertial.bias_sigma[0])
            self._add_event(time, "beam-excluded", sensor, _beam_kind(alarms[0]))
            return
        columns = np.r_[VELOCITY.start : VELOCITY.stop, ATTITUDE.start : ATTITUDE.stop]
        max_sigma = np.repeat([_MAX_SPEED_SIGMA_M_S, _MAX_ATTITUDE_SIGMA_RAD], 3)
        for k in alarms:
            self._respond(
                sensor, _beam_kind(k), results[k], columns, max_sigma, time, was_lost=before[k]
            )

    def _monitor(self, sensor: str, kind: str) -> InnovationMonitor:
        return self._monitors.setdefault(
            (sensor, kind), InnovationMonitor(MONITOR_SETTINGS[kind.split(maxsplit=1)[0]])
        )

    def record_outcome(
        self,
        sensor: str,
        kind: str,
        outcome: UpdateOutcome,
        columns: IntArray,
        max_sigma: Any,
        time: float,
        *,
        drift_cause: tuple[IntArray, Any] | None = None,
    ) -> MonitorResult:
        """Monitor the outcome of a measurement, and inflate the covariance after an alarm.

        Parameters
        ----------
        sensor, kind, outcome, time
            Sensor, kind of measurement, outcome of the update, and time in s.
        columns, max_sigma
            Indices (k,) of the errors that the measurement depends on, and their maximum standard
            deviations after an inflation.
        drift_cause
            Errors (j,) that can explain a drift, and the standard deviations (j,) that they are
            raised to; default: the accelerometer bias for speeds, the gyroscope bias for attitudes,
            and no errors for other kinds.

        Returns
        -------
        result
            Result of the monitor; the method has already responded to it.
        """
        monitor = self._monitor(sensor, kind)
        was_lost = monitor.lost
        result = monitor.record(time, outcome)
        self._respond(
            sensor,
            kind,
            result,
            columns,
            max_sigma,
            time,
            was_lost=was_lost,
            drift_cause=drift_cause,
        )
        return result

    def _respond(
        self,
        sensor: str,
        kind: str,
        result: MonitorResult,
        columns: IntArray,
        max_sigma: Any,
        time: float,
        *,
        was_lost: bool,
        drift_cause: tuple[IntArray, Any] | None = None,
    ) -> None:
        """Inflate the covariance and record events according to the result of a monitor.

        A drift raises the variances of the errors that can explain it; another alarm inflates
        those of `columns`; a consistent result changes nothing. `was_lost` states whether the
        monitor was `lost` before the measurement. The other parameters are those of
        `record_outcome`.
        """
        monitor = self._monitor(sensor, kind)
        if result is MonitorResult.DRIFT:
            # The bias itself has changed, so only its own variance grows: its new estimate must not
            # correct the other errors by their old correlations.
            place, sigma = _BIASES.get(kind.split(maxsplit=1)[0], (slice(0), 0.0))
            own = np.arange(place.start or 0, place.stop), sigma
            self.state.raise_variances(*(own if drift_cause is None else drift_cause))
            self._add_event(time, "drift", sensor, kind)
            if monitor.lost and not was_lost:
                self._add_event(time, "lost", sensor, kind)
        elif result is not MonitorResult.CONSISTENT:
            growth = float(np.clip(monitor.nis_ratio, _MIN_GROWTH, _MAX_GROWTH))
            self.state.inflate(columns, growth, max_sigma)
            if result is MonitorResult.INFLATE or not was_lost:
                name = "covariance-inflated" if result is MonitorResult.INFLATE else "lost"
                self._add_event(time, name, sensor, kind)
        elif was_lost and not monitor.lost:
            self._add_event(time, "recovered", sensor, kind)

    def _add_event(self, time: float, name: str, sensor: str, kind: str) -> None:
        self._events.append(NavigationEvent(time, name, {"sensor": sensor, "measurement": kind}))


def _beam_kind(number: int) -> str:
    """Return the name of a velocimeter beam's speed as a kind of measurement.

    Beams are counted from 0 in `number`, from 1 in the name.
    """
    return f"speed of beam {number + 1}"
