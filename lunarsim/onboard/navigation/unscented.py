"""Unscented Kalman filter, as an alternative for comparison.

The filter is the `UnscentedKalmanFilter` of filterpy (Wan and van der Merwe 2000) with ten states:
position, velocity, accelerometer bias and mass. The attitude is not a state: each star-tracker
reading replaces it, and the gyroscopes propagate it in between. Errors of the attitude and of the
terrain height are treated as measurement noise. Since these errors persist over many measurements,
their variance is increased accordingly. LiDAR scans and the ranges of velocimeters are not used.
The main filter is the error-state filter (`navigator.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from filterpy.kalman import (
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
    unscented_transform,
)
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.frames import (
    SiteToLocal,
    is_rotation,
    normalised,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    quat_to_rotation_vector,
)
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
)
from lunarsim.models.instruments import (
    AltimeterInstrument,
    StarTrackerInstrument,
    VelocimeterInstrument,
)
from lunarsim.onboard.navigation.aiding_measurements import (
    MONITOR_SETTINGS,
    check_scalar_reading,
    innovation_gate,
)
from lunarsim.onboard.navigation.error_state import UpdateOutcome, gate_innovation
from lunarsim.onboard.navigation.estimate import Estimate, Navigation, NavigationEvent
from lunarsim.onboard.navigation.inertial import (
    ACCELEROMETER,
    ATTITUDE,
    INERTIAL,
    StartSigmas,
    StrapdownState,
    checked_increments,
)
from lunarsim.onboard.navigation.innovation_monitor import InnovationMonitor, MonitorResult
from lunarsim.onboard.navigation.measurement_models import (
    MAX_SIGMA_M,
    MIN_DOWN_COSINE,
    is_symmetric,
    speed_bias_model,
)
from lunarsim.onboard.navigation.measurement_sequencer import MeasurementSequencer
from lunarsim.onboard.navigation.schmidt_kalman_covariance import inflate
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.value_checks import check_shape

STATES = 10
_LINEAR, _MASS = slice(0, 9), 9
_ROTATION = slice(9, 15)
_VELOCITY = np.r_[3:6]
# Minimum variance of a direction relative to the largest one, to repair rounding errors.
_REGULARISATION = 1e-9
# Time over which persistent errors are correlated, s. As white noise, their variance is multiplied
# by the number of measurements in this time.
_CORRELATION_TIME_S = 10.0
# Limits of the factor of a covariance inflation. The maximum standard deviations after it are given
# below: height in m, bias in m/s^2, velocity in m/s.
_GROWTH = (4.0, 1e4)
# Number of drifts within the window of a monitor that a bias may explain.
_MAX_DRIFTS = 3
# Attitude readings with a larger standard deviation are ignored, rad.
_MAX_READING_SIGMA_RAD = 1.0
_MAX_HEIGHT_SIGMA_M, _MAX_BIAS_SIGMA_M_S2, _MAX_SPEED_SIGMA_M_S = 300.0, 0.1, 30.0


@dataclass(frozen=True)
class UnscentedNavigation:
    """Settings of the unscented filter: position, velocity, accelerometer bias, mass."""

    terrain_slope: float = quantity(
        5.0,
        "deg",
        ge=0,
        le=45,
        help="typical slope of the terrain below the flight path, from which the filter computes "
        "the uncertainty of terrain height",
    )
    mass_sigma: float = quantity(
        1.0, "kg", gt=0, help="uncertainty of the lander's mass at the start, 1 sigma"
    )
    thrust_sigma: float = quantity(
        0.01,
        gt=0,
        le=1,
        help="deviation of the thrust from its command, as a fraction of the command, 1 sigma",
    )

    needs: ClassVar[tuple[type, ...]] = (InertialSamples,)
    accepts: ClassVar[tuple[type, ...]] = (AltimeterReading, DopplerReading, AttitudeReading)
    needs_prior_map: ClassVar[bool] = False
    uses_prior_map: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_bounds(self, "navigation")

    def build(self, briefing: Briefing) -> UnscentedFilter:
        """Return the navigation filter of one flight, built from its briefing."""
        state, sigmas = StrapdownState.of(briefing)
        return UnscentedFilter(
            state, sigmas, self,
            terrain_prior=TerrainPrior.of(briefing, float(np.tan(self.terrain_slope))),
            mass=briefing.lander.wet_mass,
            exhaust_velocity=briefing.lander.exhaust_velocity, lag=briefing.lander.thrust_lag,
            instruments=briefing.instruments,
        )  # fmt: skip


class UnscentedFilter(Navigation):
    """Unscented Kalman filter with ten states; the attitude is propagated separately.

    The states are position, velocity, accelerometer bias and mass.

    Parameters
    ----------
    inertial
        Initial state of the lander.
    start_sigmas
        Standard deviations of the initial state.
    settings
        Standard deviations of the other errors.
    terrain_prior
        Prior knowledge of the terrain height.
    mass
        Initial mass, kg.
    exhaust_velocity
        Exhaust velocity of the engine, m/s.
    lag
        Time constant of the thrust response, s.
    instruments
        Calibrations of altimeters, velocimeters and star trackers, by name.
    """

    def __init__(
        self,
        inertial: StrapdownState,
        start_sigmas: StartSigmas | None = None,
        settings: UnscentedNavigation | None = None,
        *,
        terrain_prior: TerrainPrior | None = None,
        mass: float = 1000.0,
        exhaust_velocity: float = 3000.0,
        lag: float = 0.0,
        instruments: Mapping[str, Any] | None = None,
    ) -> None:
        for name, value in (("mass", mass), ("exhaust_velocity", exhaust_velocity)):
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"navigation.{name}", value, "must be positive and finite")
        self.inertial = inertial
        self.settings = settings or UnscentedNavigation()
        self.events: list[NavigationEvent] = []
        self._monitors: dict[tuple[str, str], InnovationMonitor] = {}
        self._ground = terrain_prior or TerrainPrior()
        self._exhaust, self._lag = exhaust_velocity, lag
        calibrations = instruments or {}
        self._beams = {
            n: i.boresight for n, i in calibrations.items() if isinstance(i, AltimeterInstrument)
        }
        velocimeters = {
            n: i for n, i in calibrations.items() if isinstance(i, VelocimeterInstrument)
        }
        self._beam_sets = {n: np.array(i.directions) for n, i in velocimeters.items()}
        biases = {n: speed_bias_model(i) for n, i in velocimeters.items()}
        # Variance of the speed biases of the beams, m^2/s^2.
        self._bias_variance = {n: b**2 + _CORRELATION_TIME_S * w**2 for n, (b, w) in biases.items()}
        self._mounts = {
            n: i.misalignment
            for n, i in calibrations.items()
            if isinstance(i, StarTrackerInstrument)
        }
        start = inertial.covariance(start_sigmas or StartSigmas())
        # Covariance of the attitude error (small rotation in body axes) and the gyroscope bias.
        self._attitude_covariance = start[_ROTATION, _ROTATION].copy()
        self._gyroscope_covariance = start[12:, 12:].copy()
        points = MerweScaledSigmaPoints(STATES, alpha=1.0, beta=2.0, kappa=0.0)
        self.kalman = UnscentedKalmanFilter(STATES, 1, inertial.step, None, None, points)
        self.kalman.x = np.concatenate(
            (inertial.position, inertial.velocity, inertial.biases[0], [mass])
        )
        self.kalman.P = np.zeros((STATES, STATES))
        self.kalman.P[_LINEAR, _LINEAR] = start[_LINEAR, _LINEAR]
        self.kalman.P[_MASS, _MASS] = self.settings.mass_sigma**2
        self._thrust: float | None = None
        self._mean_thrust = 0.0
        self._range_counts: dict[str, int] = {}
        self._offset = np.zeros(3)
        self._arrivals = MeasurementSequencer(inertial.step, self._add_event)

    # --- state ----------------------------------------------------------------------------

    @property
    def covariance(self) -> Array:
        """Covariance (15, 15) in the order of `StrapdownState`, as a block diagonal.

        Attitude and gyroscope bias are not correlated with the filter states.
        """
        out = np.zeros((INERTIAL, INERTIAL))
        out[_LINEAR, _LINEAR] = self.kalman.P[_LINEAR, _LINEAR]
        out[_ROTATION, _ROTATION] = self._attitude_covariance
        return out

    @property
    def mass(self) -> tuple[float, float]:
        """Estimated mass and its standard deviation, kg."""
        return float(self.kalman.x[_MASS]), float(np.sqrt(self.kalman.P[_MASS, _MASS]))

    @property
    def monitors(self) -> dict[str, InnovationMonitor]:
        """Innovation monitors by "SENSOR KIND", for example "altimeter range"."""
        return {f"{sensor} {kind}": monitor for (sensor, kind), monitor in self._monitors.items()}

    @property
    def site_to_local(self) -> SiteToLocal:
        """Transformation from the site frame to the local frame."""
        return SiteToLocal(self._offset.copy())

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the lander's state at `time` (s) in the local frame.

        After a thrust command, the mass is that of the filter; before, it is the argument `mass`,
        kg.
        """
        own = mass if self._thrust is None else self.mass[0]
        site_state = self.inertial.estimate(self.covariance, time, own)
        lost = any(monitor.lost for monitor in self._monitors.values())
        return Estimate(
            time, self.site_to_local.to_local(site_state.position), site_state.velocity,
            site_state.attitude, site_state.rate, own, site_state.covariance, lost,
        )  # fmt: skip

    # --- time -----------------------------------------------------------------------------

    def record_thrust(self, thrust: float, seconds: float) -> None:
        """Record the thrust (N) that was commanded over the last `seconds`.

        Raises
        ------
        InputError
            If an argument is negative or not finite.
        """
        for name, value in (("thrust", thrust), ("seconds", seconds)):
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"navigation.{name}", value, "must be 0 or more, and finite")
        before = thrust if self._thrust is None else self._thrust
        left = float(np.exp(-seconds / self._lag)) if self._lag > 0.0 else 0.0
        share = self._lag / seconds * (1.0 - left) if seconds > 0.0 else 0.0
        # Mean thrust over the cycle, and the thrust at its end.
        self._mean_thrust = thrust + (before - thrust) * share
        self._thrust = thrust + (before - thrust) * left

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Propagate the filter with inertial samples; NaN marks missing samples.

        `angle` (n, 3), rad, and `velocity` (n, 3), m/s, are the increments of gyroscopes and
        accelerometers.

        Raises
        ------
        InputError
            If the arrays are not (n, 3) or differ in length.
        """
        samples = checked_increments(angle, velocity)
        if len(samples[0]) == 0:
            return
        seconds = len(samples[0]) * self.inertial.step
        lasting = max(_CORRELATION_TIME_S / seconds, 1.0)
        before = self.kalman.x.copy()
        transition, noise = self.inertial.propagate(*samples)
        by_turn = transition[_LINEAR, ATTITUDE]
        burnt = self._mean_thrust * seconds / self._exhaust
        q = np.zeros((STATES, STATES))
        q[_LINEAR, _LINEAR] = noise[_LINEAR, _LINEAR]
        q[_LINEAR, _LINEAR] += lasting * by_turn @ self._attitude_covariance[:3, :3] @ by_turn.T
        q[_MASS, _MASS] = lasting * (self.settings.thrust_sigma * burnt) ** 2 + 1e-12
        # For a given attitude, deviations from the propagated state evolve linearly.
        predicted = np.concatenate(
            (self.inertial.position, self.inertial.velocity, self.inertial.biases[0],
             [before[_MASS] - burnt])
        )  # fmt: skip
        full_transition = np.eye(STATES)
        full_transition[_LINEAR, _LINEAR] = transition[_LINEAR, _LINEAR]
        self.kalman.Q = q
        self._repair_covariance()
        self.kalman.predict(dt=seconds, fx=lambda x, dt: predicted + full_transition @ (x - before))
        turn = transition[_ROTATION, _ROTATION]
        self._attitude_covariance = (
            turn @ self._attitude_covariance @ turn.T + noise[_ROTATION, _ROTATION]
        )
        self._copy_to_inertial()
        self._update_with_thrust(samples[1])

    def _update_with_thrust(self, velocity: Array) -> None:
        """Update with the axial acceleration, predicted as thrust over mass plus bias.

        `velocity` (n, 3), m/s, are the velocity increments of the accelerometers in the last
        cycle. Nothing is done without commanded thrust or without valid samples.
        """
        push = velocity[np.isfinite(velocity).all(axis=1), 2] / self.inertial.step
        if self._thrust is None or self._mean_thrust <= 0.0 or len(push) == 0:
            return
        asked, sigma = self._mean_thrust, self.settings.thrust_sigma
        expected = asked / self.kalman.x[_MASS]
        noise = _CORRELATION_TIME_S / (len(velocity) * self.inertial.step) * (sigma * expected) ** 2
        self._update(
            np.array([push.mean()]), lambda x: np.array([asked / x[_MASS] + x[8]]),
            np.array([[noise]]), innovation_gate(1),
        )  # fmt: skip

    # --- measurements ---------------------------------------------------------------------

    def _add_event(self, time: float, name: str, details: dict[str, Any]) -> None:
        self.events.append(NavigationEvent(time, name, details))

    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Update the filter with one measurement of a named sensor.

        A measurement that is unusable or out of order is ignored.

        Raises
        ------
        InputError
            If `time` (s) runs backwards, or a reading does not have the shape of its sensor.
        """
        given = self._arrivals.admit_and_propagate(sensor, measurement, time, self.propagate)
        for name, details in self.inertial.pop_events():
            self.events.append(NavigationEvent(time, name, details))
        before = self.inertial.position.copy()
        if isinstance(given, AltimeterReading):
            self._monitor_outcome(sensor, "range", self._range(sensor, given), time)
        elif isinstance(given, DopplerReading) and sensor in self._beam_sets:
            self._monitor_outcome(sensor, "speed", self._speeds(sensor, given), time)
        elif isinstance(given, AttitudeReading):
            self._monitor_outcome(sensor, "attitude", self._attitude(sensor, given), time)
        self._offset -= self.inertial.position - before

    def _range(self, sensor: str, reading: AltimeterReading) -> UpdateOutcome:
        check_scalar_reading(sensor, reading)
        beam = np.asarray(self._beams.get(sensor, (0.0, 0.0, -1.0)))
        down = float(quat_to_matrix(self.inertial.attitude)[2] @ beam)
        r, sigma = reading.range, reading.sigma
        good = 0.0 < r < np.inf and 0.0 < sigma < MAX_SIGMA_M
        if not good or down > -MIN_DOWN_COSINE:
            return UpdateOutcome(np.nan, 1, False)
        # The terrain-height error is common to all readings: together they must count only once.
        uses = self._range_counts.get(sensor, 0)
        level = ((self._ground.sigma or 0.0) / down) ** 2 * (uses + 1) * (uses + 2)
        outcome = self._update(
            np.array([r]), lambda x: np.array([(self._ground.elevation - x[2]) / down]),
            np.array([[sigma**2 + level]]), innovation_gate(1),
        )  # fmt: skip
        self._range_counts[sensor] = uses + outcome.is_accepted
        return outcome

    def _speeds(self, sensor: str, reading: DopplerReading) -> UpdateOutcome:
        beams = self._beam_sets[sensor]
        for name in ("speed", "speed_sigma"):
            n = len(beams)
            check_shape(f"{sensor}.{name}", getattr(reading, name), (n,), f"for {n} beams")
        speed, sigma = np.asarray(reading.speed), np.asarray(reading.speed_sigma)
        has_return = np.isfinite(speed) & np.isfinite(sigma) & (sigma > 0.0)
        if not has_return.any():
            return UpdateOutcome(np.nan, 0, False)
        rays = beams[has_return] @ quat_to_matrix(self.inertial.attitude).T
        own = quat_to_matrix(self.inertial.attitude).T @ self.inertial.velocity
        by_turn = np.cross(beams[has_return], own)
        uses = _CORRELATION_TIME_S / 0.1
        noise = np.diag(sigma[has_return] ** 2 + uses * self._bias_variance[sensor])
        outcome = self._update(
            speed[has_return], lambda x: rays @ x[3:6],
            noise + by_turn @ (uses * self._attitude_covariance[:3, :3]) @ by_turn.T,
            innovation_gate(int(has_return.sum())),
        )  # fmt: skip
        white = np.full(len(beams), np.nan)
        if outcome.is_accepted:
            white[has_return] = outcome.whitened
        return UpdateOutcome(outcome.nis, outcome.dof, outcome.is_accepted, white)

    def _attitude(self, sensor: str, reading: AttitudeReading) -> UpdateOutcome:
        q, r = np.asarray(reading.attitude, float), np.asarray(reading.covariance, float)
        check_shape(f"{sensor}.attitude", q, (4,))
        check_shape(f"{sensor}.covariance", r, (3, 3))
        mount = self._mounts.get(sensor, 0.0)
        own = r + mount**2 * np.eye(3)
        if not is_rotation(q) or not is_symmetric(own):
            return UpdateOutcome(np.nan, 3, False)
        spread = np.linalg.eigvalsh(own)
        if spread.min() <= 0.0 or spread.max() > _MAX_READING_SIGMA_RAD**2:
            return UpdateOutcome(np.nan, 3, False)
        between = quat_multiply(quat_conjugate(self.inertial.attitude), normalised(q))
        turn = quat_to_rotation_vector(between)
        outcome, _ = gate_innovation(
            turn, self._attitude_covariance[:3, :3] + own, innovation_gate(3)
        )
        if outcome.is_accepted:
            error = np.zeros(INERTIAL)
            error[ATTITUDE] = turn
            self.inertial.correct(error)
            self._attitude_covariance = np.zeros((6, 6))
            self._attitude_covariance[:3, :3], self._attitude_covariance[3:, 3:] = (
                own,
                self._gyroscope_covariance,
            )
        return outcome

    # --- correction -----------------------------------------------------------------------

    def _update(
        self, measurement: Array, predict: Callable[[Array], Array], noise: Array, gate: float
    ) -> UpdateOutcome:
        """Update with a measurement (n,), unless its innovation exceeds the gate.

        `predict` is the function that predicts the measurement from a state (10,), `noise` (n, n)
        the covariance of the measurement, and `gate` the maximum normalised innovation squared.
        The result is the outcome; a rejected measurement changes nothing.
        """
        k = self.kalman
        # filterpy draws sigma points only in `predict`; each further update needs new ones.
        self._repair_covariance()
        k.sigmas_f = k.points_fn.sigma_points(k.x, k.P)
        through = np.array([predict(x) for x in k.sigmas_f])
        mean, spread = unscented_transform(through, k.Wm, k.Wc, noise)
        outcome, _ = gate_innovation(measurement - mean, spread, gate)
        if outcome.is_accepted:
            k.update(measurement, R=noise, hx=predict)
            k.P = 0.5 * (k.P + k.P.T)
            self._copy_to_inertial()
        return outcome

    def _repair_covariance(self) -> None:
        """Make the covariance positive definite again after rounding errors.

        Directions without variance get a small variance, which no reading can reduce to zero. If
        the estimate is wrong in such a direction, the innovations show the error.
        """
        try:
            np.linalg.cholesky(self.kalman.P)
        except np.linalg.LinAlgError:
            values, axes = np.linalg.eigh(0.5 * (self.kalman.P + self.kalman.P.T))
            least = max(_REGULARISATION * float(values.max()), 1e-12)
            self.kalman.P = (axes * np.maximum(values, least)) @ axes.T

    def _copy_to_inertial(self) -> None:
        """Set the propagated lander state to the filter's estimate after an update."""
        s = self.inertial
        error = np.zeros(INERTIAL)
        error[_LINEAR] = self.kalman.x[_LINEAR] - np.concatenate(
            (s.position, s.velocity, s.biases[0])
        )
        s.correct(error)

    def _monitor_outcome(self, sensor: str, kind: str, outcome: UpdateOutcome, time: float) -> None:
        """Monitor the outcome of a measurement, and inflate the covariance after an alarm.

        `kind` is "range", "speed" or "attitude"; `time` is in s.
        """
        settings = replace(MONITOR_SETTINGS[kind], max_drifts=_MAX_DRIFTS)
        monitor = self._monitors.setdefault((sensor, kind), InnovationMonitor(settings))
        before = monitor.lost
        result = monitor.record(time, outcome)
        growth = float(np.clip(monitor.nis_ratio, *_GROWTH))
        name = {
            MonitorResult.INFLATE: "covariance-inflated",
            MonitorResult.LOST: "lost",
            MonitorResult.DRIFT: "drift",
        }.get(result)
        if kind == "attitude" and result is not MonitorResult.CONSISTENT:
            # The attitude is no filter state; its inflated variance lets the next reading pass.
            self._attitude_covariance *= growth
        elif result is MonitorResult.DRIFT:
            inflate(self.kalman.P, np.arange(9)[ACCELEROMETER], _GROWTH[1], _MAX_BIAS_SIGMA_M_S2)
        elif result is not MonitorResult.CONSISTENT and kind == "range":
            inflate(self.kalman.P, [2], growth, _MAX_HEIGHT_SIGMA_M)
        elif result is not MonitorResult.CONSISTENT:
            inflate(self.kalman.P, _VELOCITY, growth, _MAX_SPEED_SIGMA_M_S)
        elif before and not monitor.lost:
            name = "recovered"
        if result is MonitorResult.DRIFT and monitor.lost and not before:
            name = "lost"
        if name is not None and not (name == "lost" and before):
            self.events.append(NavigationEvent(time, name, {"sensor": sensor, "measurement": kind}))
