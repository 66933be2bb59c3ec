"""Process ranges, speeds and attitudes, and monitor all innovations."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from lunarsim.errors import InputError
from lunarsim.frames import quat_rotate
from lunarsim.messages.measurements import AltimeterReading, AttitudeReading, DopplerReading
from lunarsim.models.instruments import FixedBeam, FixedBeams, LidarInstrument, StarInstrument
from lunarsim.onboard.navigation.error_state import MAP, ErrorState, Outcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.inertial import (
    ACCELEROMETER,
    ATTITUDE,
    GYROSCOPE,
    POSITION,
    VELOCITY,
)
from lunarsim.onboard.navigation.level_ground import GROUND, LevelGround
from lunarsim.onboard.navigation.measured import (
    LEAST_DOWN,
    speed_errors,
    take_attitude,
    take_range,
    take_speeds,
)
from lunarsim.onboard.navigation.seen_scan import scanner_block, scanner_covariance
from lunarsim.onboard.navigation.innovation_monitor import Verdict, Watch, WatchSettings

Array = NDArray[np.float64]

# Mean number of valid measurements per false rejection.
_REFUSED = 20_000.0
# Maximum standard deviations after covariance inflation: m/s, rad, m.
_MOST_SPEED, _MOST_TURN, _MOST_HEIGHT = 30.0, 0.2, 300.0
# Limits of the factor by which an inflation multiplies variances.
_LEAST_GROWTH, _MOST_GROWTH = 4.0, 1e4
# Velocity and attitude cannot jump, but the terrain height under the lander can.
WATCHED = {
    "range": WatchSettings(),
    # A drift between a velocimeter and the inertial unit cannot be attributed to one of them.
    "speed": WatchSettings(patience=None, drift_s=8.0, drift_patience=0),
    "attitude": WatchSettings(patience=None, drift_s=8.0, drift_patience=0),
    # An outdated part of a map is rejected for as long as it is in view.
    "map": WatchSettings(least=10, most_refused=0.8, drift_s=8.0),
    # Good fits at another place: a scanner error explains the first alarm, nothing the second.
    "fits": WatchSettings(least=10, most_refused=0.8, patience=1),
    # The noise of the reference scan is common to all comparisons with it, so they are correlated.
    "scans": WatchSettings(),
}
# Bias that explains a drift of a sensor, and its standard deviation after a drift: m/s^2, rad/s.
# What drifts where innovations lie to one side, and how far it may: m/s^2, rad/s.
_BIASES = {"speed": (ACCELEROMETER, 0.1), "attitude": (GYROSCOPE, 2e-3)}
# Maximum ratio of an estimated bias to its standard deviation; more contradicts the specification.
_MOST_BIAS = 6.0
# Minimum number of beams to identify a faulty one, and the velocity error (m/s) that a faulty beam
# can cause before it is detected.
_FEWEST_BEAMS, _LIED = 3, 0.1
# Minimum number of accepted speeds of each beam before a faulty beam can be identified. Without
# such a history it is unknown which of two contradicting beams is faulty.
_PROVEN = 30


@lru_cache
def gate_of(degrees: int) -> float:
    """Return the maximum accepted normalised innovation squared."""
    return float(chdtri(degrees, 1.0 / _REFUSED))


def blocks_of(instruments: Mapping[str, Any], ground: LevelGround) -> dict[str, Array]:
    """Return the error-state blocks that the measurements of these instruments need.

    Parameters
    ----------
    instruments
        Calibrations of the sensors, by name.
    ground
        Prior knowledge of the terrain height.
    """
    out = {} if ground.sigma is None else {GROUND: np.array([[ground.sigma**2]])}
    for name, instrument in instruments.items():
        beams = {FixedBeam: 1, FixedBeams: len(getattr(instrument, "directions", ()))}
        if ground.sigma is not None and type(instrument) in beams:
            out[_feet(name)] = ground.sigma**2 * np.eye(beams[type(instrument)])
        if isinstance(instrument, FixedBeams):
            out[_speeds(name)] = speed_errors(instrument)[0] ** 2 * np.eye(
                len(instrument.directions)
            )
        if isinstance(instrument, StarInstrument):
            out[_mount(name)] = instrument.misalignment**2 * np.eye(3)
    return out


def _mount(sensor: str) -> str:
    """Return the block name of a star tracker's misalignment."""
    return f"mount of {sensor}"


def _feet(sensor: str) -> str:
    """Return the block name of the terrain heights at a sensor's beam footprints."""
    return f"ground under {sensor}"


def _speeds(sensor: str) -> str:
    """Return the block name of the speed biases of a velocimeter's beams."""
    return f"speeds of {sensor}"


def one_each(sensor: str, reading: AltimeterReading) -> None:
    """Check that a reading is one range and one standard deviation.

    Raises
    ------
    InputError
        If either is an array.
    """
    for name in ("range", "sigma"):
        shape = np.shape(getattr(reading, name))
        if shape:
            raise InputError(f"{sensor}.{name}", shape, "must be one number")


class Aids:
    """Process ranges, speeds and attitudes, and monitor all innovations.

    Parameters
    ----------
    state
        Error state with the blocks of `blocks_of`.
    instruments
        Calibrations of the sensors, by name.
    ground
        Prior knowledge of the terrain height.
    events
        List that receives the events "doubted", "drift", "shut-off", "lost" and "believed".
    """

    def __init__(
        self,
        state: ErrorState,
        instruments: Mapping[str, Any],
        ground: LevelGround,
        events: list[NavigationEvent],
    ) -> None:
        self.state = state
        self.ground = ground
        self._events = events
        self._beams = {n: i for n, i in instruments.items() if isinstance(i, FixedBeam)}
        self._cones = {
            n: np.array(i.directions)
            for n, i in instruments.items() if isinstance(i, FixedBeams)
        }  # fmt: skip
        # Initial speed bias of a beam (m/s), and its random walk in 1 s.
        self._speed_errors = {
            n: speed_errors(i) for n, i in instruments.items() if isinstance(i, FixedBeams)
        }
        # Specified standard deviations of sensor biases: sensor, name, deviations, by block.
        self._stated: dict[str, tuple[str, str, Any]] = {
            _speeds(n): (n, "speeds", stated) for n, (stated, _) in self._speed_errors.items()
        }
        for name, instrument in instruments.items():
            if isinstance(instrument, LidarInstrument):
                deviations = np.sqrt(scanner_covariance(instrument).diagonal())
                self._stated[scanner_block(name)] = (name, "scanner", deviations)
        self._stars = {n for n, i in instruments.items() if isinstance(i, StarInstrument)}
        self._watches: dict[tuple[str, str], Watch] = {}
        self._place = state.inertial.position[:2].copy()
        self._foot: dict[tuple[str, int], Array] = {}
        self._spoke: dict[str, float] = {}
        self._time = -np.inf
        # Beams excluded after a fault; whether a bias contradicts a sensor's specification.
        self._shut: set[tuple[str, int]] = set()
        self._contradicted = False

    @property
    def events(self) -> list[NavigationEvent]:
        """Events reported so far."""
        return self._events

    @property
    def lost(self) -> bool:
        """Whether the measurements contradict the estimate."""
        return self._contradicted or any(watch.lost for watch in self._watches.values())

    @property
    def watches(self) -> dict[str, Watch]:
        """Innovation monitors by "sensor kind"."""
        return {f"{sensor} {kind}": watch for (sensor, kind), watch in self._watches.items()}

    def travel(self) -> None:
        """Add process noise to the terrain height for the distance moved."""
        if not self.state.has(GROUND):
            return
        here = self.state.inertial.position[:2]
        moved = float(np.linalg.norm(here - self._place))
        self._place = here.copy()
        if np.isfinite(moved):
            at = [self.state.block(GROUND).start]
            self.state.widen(at, self.ground.growth * moved)

    def doubt_units(self) -> None:
        """Declare navigation lost if an estimated bias contradicts its specification.

        Either the sensor does not meet its specification, or the measurement that the bias was
        estimated with drifts. The first case does not affect velocity and attitude, but in the
        second they drift too, and the two cases cannot be distinguished. Likewise, an undetected
        rotation of the lander looks like a boresight error of the scanner.
        """
        if self._contradicted:
            return
        own = self.state.inertial
        found = [
            ("inertial unit", name, place, value, stated)
            for name, place, value, stated in zip(
                ("accelerometers", "gyroscopes"), (ACCELEROMETER, GYROSCOPE), own.biases,
                own.bias_sigma, strict=True,
            )
        ]  # fmt: skip
        for block, (sensor, name, deviation) in self._stated.items():
            if self.state.has(block):
                place, value = self.state.block(block), self.state.value(block)
                found.append((sensor, name, place, value, deviation))
        for sensor, name, place, value, stated in found:
            variance = self.state.own(np.arange(self.state.head)[place]).diagonal() + stated**2
            if (value**2 > _MOST_BIAS**2 * variance).any():
                self._contradicted = True
                self._note(self._time, "lost", sensor, name)
                return

    def take(self, sensor: str, measurement: Any, time: float, *, used: bool = False) -> bool:
        """Process a measurement; return whether its type is supported.

        A measurement that an earlier processor has `used` is skipped.

        Raises
        ------
        InputError
            If time runs backwards, or the arrays of a reading have wrong shapes.
        """
        if not time >= self._time:
            raise InputError("time", time, f"must be finite and not before the last time ({self._time} s)")
        self._time = time
        if used:
            return False
        if isinstance(measurement, AltimeterReading):
            one_each(sensor, measurement)
            beam = self._beams[sensor].boresight if sensor in self._beams else (0.0, 0.0, -1.0)
            self._range(sensor, measurement.range, measurement.sigma, beam, time)
        elif isinstance(measurement, DopplerReading):
            self._doppler(sensor, measurement, time)
        elif isinstance(measurement, AttitudeReading):
            block = _mount(sensor) if sensor in self._stars else None
            found = take_attitude(
                self.state, measurement.attitude, measurement.covariance, block=block,
                gate=gate_of(3),
            )  # fmt: skip
            columns = np.arange(ATTITUDE.start, ATTITUDE.stop)
            if block is not None:
                own = self.state.block(block)
                columns = np.concatenate((columns, np.arange(own.start, own.stop)))
            self.judge(sensor, "attitude", found, columns, _MOST_TURN, time)
        else:
            return False
        return True

    def _doppler(self, sensor: str, reading: DopplerReading, time: float) -> None:
        beams = self._cones.get(sensor)
        if beams is None:
            return
        for name in ("speed", "speed_sigma", "range", "range_sigma"):
            shape = np.shape(getattr(reading, name))
            if shape != (len(beams),):
                raise InputError(
                    f"{sensor}.{name}", shape, f"must have shape ({len(beams)},), one per beam"
                )
        self._wander(sensor, time)
        found = {
            k: self._speed(sensor, k, reading, beams)
            for k in range(len(beams)) if (sensor, k) not in self._shut
        }  # fmt: skip
        self._judge_beams(sensor, found, time)
        for k, beam in enumerate(beams):
            distance, deviation = float(reading.range[k]), float(reading.range_sigma[k])
            self._range(sensor, distance, deviation, beam, time, k)

    def _wander(self, sensor: str, time: float) -> None:
        """Add the random walk of the beam biases since the last reading."""
        block, last = _speeds(sensor), self._spoke.get(sensor, time)
        self._spoke[sensor] = time
        if self.state.has(block):
            own = np.arange(self.state.block(block).start, self.state.block(block).stop)
            wander = self._speed_errors[sensor][1]
            self.state.widen(own, wander**2 * (time - last) * np.eye(len(own)))

    def _speed(self, sensor: str, k: int, reading: DopplerReading, beams: Array) -> Outcome:
        one, block = slice(k, k + 1), _speeds(sensor)
        own: dict[str, Any] = {}
        if self.state.has(block):
            place, value = self.state.block(block).start + k, self.state.value(block)[one]
            own = {"biases": [place], "known": value}
        return take_speeds(
            self.state, reading.speed[one], reading.speed_sigma[one], beams[one], gate_of(1), **own
        )

    def _range(
        self, sensor: str, distance: float, sigma: float, beam: Any, time: float, number: int = 0
    ) -> None:
        columns = np.array([POSITION.start + 2])
        block, rise = None, 0.0
        if self.state.has(GROUND):
            columns = np.append(columns, self.state.block(GROUND).start)
            block = _feet(sensor)
            if np.isfinite(distance) and self.state.has(block):
                columns = np.append(columns, self._follow_foot(sensor, beam, number))
            elif not self.state.has(block):
                block, number = GROUND, 0
                rise = self.ground.growth * float(np.hypot(*self._across(beam)))
        found = take_range(
            self.state, distance, sigma, beam, self.ground.elevation, block=block, part=number,
            rise=rise, gate=gate_of(1),
        )  # fmt: skip
        self.judge(sensor, "range", found, columns, _MOST_HEIGHT, time)

    def _across(self, beam: Any) -> Array:
        """Return the horizontal offset of a beam's footprint from the lander (2,), m."""
        inertial, level = self.state.inertial, self.ground.elevation
        level += float(self.state.value(GROUND)[0]) if self.state.has(GROUND) else 0.0
        level += float(self.state.value(MAP)[2]) if self.state.has(MAP) else 0.0
        along = quat_rotate(inertial.attitude, beam)
        height = max(float(inertial.position[2]) - level, 0.0)
        return np.asarray(height * along[:2] / max(-float(along[2]), LEAST_DOWN))

    def _follow_foot(self, sensor: str, beam: Any, number: int) -> int:
        """Move a beam's terrain-height state to its current footprint; return its index.

        A slanted beam meets the terrain beside the lander, at another height than below it, and
        almost at the same point in the next reading. If this difference were white noise, some
        hundred readings would average it away, and terrain slopes would be taken for a tilt of the
        lander. The new height is a weighted mean of the last footprint's height and the height
        below the lander. The weight of the former decays with the distance between the footprints,
        relative to the distance from the lander.
        """
        state, across = self.state, self._across(beam)
        foot, away = state.inertial.position[:2] + across, float(np.hypot(*across))
        last = self._foot.get((sensor, number))
        keep = 0.0
        if last is not None and away > 0.0:
            keep = float(np.exp(-np.hypot(*(foot - last)) / away))
        self._foot[sensor, number] = foot
        block = _feet(sensor)
        at, below = int(state.block(block).start) + number, int(state.block(GROUND).start)
        value = state.value(block)
        value[number] = keep * value[number] + (1.0 - keep) * float(state.value(GROUND)[0])
        shares = np.array([keep, 1.0 - keep])
        state.follow(at, np.array([at, below]), shares, self.ground.growth * away * (1.0 - keep))
        return at

    def _judge_beams(self, sensor: str, found: dict[int, Outcome], time: float) -> None:
        """Monitor the speeds of each beam, and exclude a single faulty beam.

        A velocity error of the lander would affect all beams. If one beam alone raises an alarm
        and the others agree with the estimate, that beam is excluded. The variances of velocity
        and accelerometer bias are increased by the effect that the fault may have had.
        """
        watches = {k: self._watch(sensor, _of_beam(k)) for k in found}
        before = {k: watch.lost for k, watch in watches.items()}
        verdicts = {k: watch.note(time, found[k]) for k, watch in watches.items()}
        doubted = [k for k, verdict in verdicts.items() if verdict is not Verdict.WELL]
        calm = sum(watch.calm(time) for k, watch in watches.items() if k not in doubted)
        alone = len(doubted) == 1 and calm == len(found) - 1 and not any(before.values())
        proven = all(watch.degrees >= _PROVEN for watch in watches.values())
        if alone and proven and len(found) >= _FEWEST_BEAMS:
            self._shut.add((sensor, doubted[0]))
            watches[doubted[0]].lost = False
            self.state.widen(np.arange(VELOCITY.start, VELOCITY.stop), _LIED**2 * np.eye(3))
            bias = np.arange(ACCELEROMETER.start, ACCELEROMETER.stop)
            self.state.let_go(bias, self.state.inertial.bias_sigma[0])
            self._note(time, "shut-off", sensor, _of_beam(doubted[0]))
            return
        columns = np.r_[VELOCITY.start : VELOCITY.stop, ATTITUDE.start : ATTITUDE.stop]
        most = np.repeat([_MOST_SPEED, _MOST_TURN], 3)
        for k in doubted:
            self._act(sensor, _of_beam(k), verdicts[k], columns, most, time, before=before[k])

    def _watch(self, sensor: str, kind: str) -> Watch:
        return self._watches.setdefault((sensor, kind), Watch(WATCHED[kind.split(maxsplit=1)[0]]))

    def judge(
        self,
        sensor: str,
        kind: str,
        found: Outcome,
        columns: NDArray[np.int64],
        most: Any,
        time: float,
        *,
        drifting: tuple[NDArray[np.int64], Any] | None = None,
    ) -> Verdict:
        """Monitor the outcome of a measurement, and inflate the covariance after an alarm.

        Parameters
        ----------
        sensor, kind, found, time
            Sensor, kind of measurement, outcome, and time in s.
        columns, most
            Errors (k,) that the measurement depends on, and their maximum standard deviations
            after an inflation.
        drifting
            Errors (j,) that can explain a drift, and the standard deviations (j,) that they are
            raised to; default: a bias of the inertial unit.

        Returns
        -------
        verdict
            Result of the monitor, already acted on.
        """
        watch = self._watch(sensor, kind)
        before = watch.lost
        verdict = watch.note(time, found)
        self._act(sensor, kind, verdict, columns, most, time, before=before, drifting=drifting)
        return verdict

    def _act(
        self, sensor: str, kind: str, verdict: Verdict, columns: NDArray[np.int64], most: Any,
        time: float, *, before: bool, drifting: tuple[NDArray[np.int64], Any] | None = None,
    ) -> None:  # fmt: skip
        """Act on the result of a monitor; `before` is its `lost` before the measurement."""
        watch = self._watch(sensor, kind)
        if verdict is Verdict.DRIFT:
            # The bias itself has changed, so only its own variance grows: its new estimate must not
            # correct the other errors by their old correlations.
            place, sigma = _BIASES.get(kind.split(maxsplit=1)[0], (slice(0), 0.0))
            own = np.arange(place.start or 0, place.stop), sigma
            self.state.let_go(*(own if drifting is None else drifting))
            self._note(time, "drift", sensor, kind)
            if watch.lost and not before:
                self._note(time, "lost", sensor, kind)
        elif verdict is not Verdict.WELL:
            growth = float(np.clip(watch.excess, _LEAST_GROWTH, _MOST_GROWTH))
            self.state.inflate(columns, growth, most)
            if verdict is Verdict.WIDEN or not before:
                name = "doubted" if verdict is Verdict.WIDEN else "lost"
                self._note(time, name, sensor, kind)
        elif before and not watch.lost:
            self._note(time, "believed", sensor, kind)

    def _note(self, time: float, name: str, sensor: str, kind: str) -> None:
        self._events.append(NavigationEvent(time, name, {"sensor": sensor, "measurement": kind}))


def _of_beam(number: int) -> str:
    """Return the name of the speed along a beam; beams are counted from 1."""
    return f"speed of beam {number + 1}"
