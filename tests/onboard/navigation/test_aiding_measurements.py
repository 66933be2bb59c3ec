"""Test ranges, speeds and attitudes: terrain height, beams and monitors."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.briefing import InitialStateEstimate
from lunarsim.messages.measurements import AltimeterReading, AttitudeReading, DopplerReading
from lunarsim.models.gravity import RoundMoon, UniformGravity
from lunarsim.models.instruments import (
    AltimeterInstrument,
    StarTrackerInstrument,
    VelocimeterInstrument,
)
from lunarsim.onboard.navigation.aiding_measurements import (
    AidingMeasurements,
    aiding_blocks,
    innovation_gate,
)
from lunarsim.onboard.navigation.error_state import MAP, ErrorState
from lunarsim.onboard.navigation.inertial import ACCELEROMETER, StartSigmas, StrapdownState
from lunarsim.onboard.navigation.local_frame import empty_map_block
from lunarsim.onboard.navigation.terrain_heights import TERRAIN, TerrainPrior

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
BEAMS = ((0.6, 0.0, -0.8), (-0.6, 0.0, -0.8), (0.0, 0.6, -0.8))
INSTRUMENTS = {
    "down": AltimeterInstrument((0.0, 0.0, -1.0)), "slanted": AltimeterInstrument((0.6, 0.0, -0.8)),
    "doppler": VelocimeterInstrument(BEAMS), "stars": StarTrackerInstrument(1e-4),
}  # fmt: skip


def made(relief=0.1, sigma=5.0, instruments=INSTRUMENTS):
    inertial = StrapdownState(np.array([0.0, 0.0, 100.0]), np.array([3.0, 0, -2]), UPRIGHT, 1.6)
    ground, events = TerrainPrior(0.0, sigma, relief), []
    state = ErrorState(
        inertial, StartSigmas(1.0, 0.1, 1e-3), blocks=aiding_blocks(instruments, ground)
    )
    return state, AidingMeasurements(state, instruments, ground, events), events


def test_terrain_height_noise_grows_with_distance_flown():
    state, aiding, _ = made(relief=0.2)
    before = state.covariance[state.block(TERRAIN), state.block(TERRAIN)][0, 0]
    state.inertial.correct(np.array([30.0, 40.0, 5.0, *np.zeros(12)]))
    aiding.add_terrain_noise()
    after = state.covariance[state.block(TERRAIN), state.block(TERRAIN)][0, 0]
    assert after - before == pytest.approx(0.2**2 * 10.0 * 50.0)
    aiding.add_terrain_noise()
    assert state.covariance[state.block(TERRAIN), state.block(TERRAIN)][0, 0] == after


def test_terrain_prior_uses_target_elevation_and_slope():
    start = InitialStateEstimate(
        np.array([-300.0, 450.0, 200.0]),
        np.zeros(3),
        UPRIGHT,
        5.0,
        0.1,
        0.01,
        target_elevation_sigma=4.0,
    )
    uniform = UniformGravity(1.622)
    given = SimpleNamespace(start=start, target=np.array([0.0, 50.0, 7.0]), gravity=uniform)
    # 500 m away; heights so far apart differ by the slope times 500^0.76 m.
    found = TerrainPrior.of(given, 0.05)
    assert found.elevation == 7.0
    assert found.sigma == pytest.approx(np.hypot(4.0, 0.05 * 112.517), rel=1e-4)
    assert found.elevation_at(np.array([6_000.0, 8_000.0])) == 7.0
    exact = replace(start, target_elevation_sigma=0.0)
    level = SimpleNamespace(start=exact, target=given.target, gravity=uniform)
    assert TerrainPrior.of(level, 0.0).sigma == 0.1
    moon = RoundMoon().gravity(1.622)
    around = SimpleNamespace(start=start, target=given.target, gravity=moon)
    curved = TerrainPrior.of(around, 0.05).elevation_at(np.array([6_000.0, 8_000.0]))
    # The sphere is 10 km from the tangent point lower by R - sqrt(R^2 - 10 km^2).
    assert curved == pytest.approx(7.0 - (moon.radius - np.sqrt(moon.radius**2 - 1e8)), abs=1e-3)


def test_a_range_is_along_its_own_beam():
    for sensor, distance in (("down", 100.0), ("slanted", 125.0)):
        state, aiding, _ = made()
        aiding.take(sensor, AltimeterReading(0.0, distance, 0.1), 0.0)
        watch = aiding.monitors[f"{sensor} range"]
        assert watch.rejected_count == 0
        assert watch.nis_sum == pytest.approx(0.0, abs=1e-12)
        assert state.inertial.position[2] == pytest.approx(100.0)


def test_slanted_beam_gives_less_information_on_rough_terrain():
    sigma = []
    for relief in (0.0, 0.3):
        state, aiding, _ = made(relief=relief)
        aiding.take("slanted", AltimeterReading(0.0, 125.0, 0.1), 0.0)
        at = np.array([2, state.block(TERRAIN).start])
        over = np.array([1.0, -1.0])
        sigma.append(np.sqrt(over @ state.covariance[np.ix_(at, at)] @ over))
    # 125 m away and 75 m aside: the ground there lies off by 0.3 sqrt(10 x 75).
    assert sigma[0] < 0.2
    assert sigma[1] > 3.0


def test_uncalibrated_beam_gives_less_information_when_tilted():
    sigma = []
    lean = quat_from_rotation_vector([0.0, 0.6, 0.0])
    for relief in (0.0, 0.3):
        inertial = StrapdownState(np.array([0.0, 0.0, 100.0]), np.zeros(3), lean, 1.6)
        ground = TerrainPrior(0.0, 5.0, relief)
        state = ErrorState(inertial, StartSigmas(1.0, 0.1, 1e-3), blocks=aiding_blocks({}, ground))
        aiding = AidingMeasurements(state, {}, ground, [])
        aiding.take("new", AltimeterReading(0.0, 100.0 / np.cos(0.6), 0.1), 0.0)
        assert aiding.monitors["new range"].dof == 1
        at = np.array([2, state.block(TERRAIN).start])
        over = np.array([1.0, -1.0])
        sigma.append(np.sqrt(over @ state.covariance[np.ix_(at, at)] @ over))
    # 68 m aside: the ground there lies off by 0.3 sqrt(10 x 68).
    assert sigma[0] < 0.2
    assert sigma[1] > 3.0


def test_rejections_inflate_height_and_terrain_until_accepted():
    state, aiding, events = made(sigma=1.0)
    before = np.diag(state.covariance).copy()
    for k in range(6):
        aiding.take("down", AltimeterReading(0.0, 160.0, 0.1), 0.1 * k)
    after = np.diag(state.covariance)
    place = state.block(TERRAIN).start
    assert [e.name for e in events] == ["covariance-inflated"]
    assert after[2] >= 4.0 * before[2]
    assert after[place] >= 4.0 * before[place]
    assert after[:2] == pytest.approx(before[:2])
    aiding.take("down", AltimeterReading(0.0, 160.0, 0.1), 0.7)
    assert aiding.monitors["down range"].dof == 1, "accepted in the end"


def test_recovery_is_reported():
    _, aiding, events = made(sigma=1.0)
    for k in range(60):
        aiding.take("down", AltimeterReading(0.0, 1e4, 0.1), 0.1 * k)
    assert aiding.lost
    for k in range(200):
        aiding.take("down", AltimeterReading(0.0, 100.0, 0.1), 6.0 + 0.1 * k)
    assert not aiding.lost
    assert [e.name for e in events][-1] == "recovered"


def test_estimate_below_terrain_is_corrected():
    state, aiding, _ = made(sigma=0.1)
    state.inertial.correct(np.array([0.0, 0.0, -103.0, *np.zeros(12)]))
    for k in range(100):
        aiding.take("down", AltimeterReading(0.0, 120.0, 0.1), 0.1 * k)
    assert aiding.monitors["down range"].rejected_count > 0
    assert aiding.lost or abs(state.inertial.position[2] - 120.0) < 10.0


@pytest.mark.parametrize("kind", ["speed", "attitude"])
def test_drift_inflates_the_related_bias(kind):
    state, aiding, events = made()
    own = slice(6, 9) if kind == "speed" else slice(12, 15)
    other = slice(12, 15) if kind == "speed" else slice(6, 9)
    before = np.diag(state.covariance).copy()
    for k in range(100):
        # Always slightly above the estimate, which follows it.
        if kind == "speed":
            seen = np.array(BEAMS) @ (state.inertial.velocity + [0.05, 0.0, 0.0])
            seen = seen + state.value("speeds of doppler")
            reading = DopplerReading(
                0.0, seen, np.full(3, np.nan), np.full(3, 0.03), np.full(3, np.nan)
            )
            aiding.take("doppler", reading, 0.1 * k)
        else:
            off = state.value("mount of stars") + [2e-4, 0.0, 0.0]
            seen = quat_multiply(state.inertial.attitude, quat_from_rotation_vector(off))
            aiding.take("stars", AttitudeReading(0.0, seen, 4e-8 * np.eye(3)), 0.1 * k)
    after = np.diag(state.covariance)
    assert {e.name for e in events} == {"drift", "lost"}
    assert [e.name for e in events][:2] == ["drift", "lost"]
    assert (after[own] > 50.0 * before[own]).all()
    assert (after[other] <= before[other] * (1.0 + 1e-9)).all()


def fly_beams(aiding, state, off, seconds=8.0, start=0.0, seed=3):
    """Feed readings at 10 Hz with given beam errors (3,), m/s; NaN for no reading."""
    rng = np.random.default_rng(seed)
    nothing = np.full(3, np.nan)
    for k in range(round(10.0 * seconds)):
        seen = np.array(BEAMS) @ np.array([3.0, 0.0, -2.0]) + 0.03 * rng.standard_normal(3) + off
        reading = DopplerReading(0.0, seen, nothing, np.full(3, 0.03), nothing)
        aiding.take("doppler", reading, start + 0.1 * k)


@pytest.mark.parametrize("beam", [0, 1, 2])
@pytest.mark.parametrize("off", [0.1, -0.1, 2.0])
def test_single_faulty_beam_is_excluded(beam, off):
    state, aiding, events = made()
    fly_beams(aiding, state, np.zeros(3))
    before = state.covariance[3:6, 3:6].copy()
    lie = np.zeros(3)
    lie[beam] = off
    fly_beams(aiding, state, lie, start=8.0, seed=4)
    assert [(e.name, e.details["measurement"]) for e in events] == [
        ("beam-excluded", f"speed of beam {beam + 1}")
    ]
    assert not aiding.lost
    after = state.covariance[3:6, 3:6]
    assert (np.diag(after) >= 0.99 * np.diag(before)).all()
    assert np.diag(after).max() > 2.0 * np.diag(before).max()
    error = state.inertial.velocity - [3.0, 0.0, -2.0]
    assert error @ np.linalg.solve(after, error) < 16.0
    # Later readings of this beam have no influence.
    told = state.inertial.velocity.copy()
    reading = np.full(3, np.nan)
    reading[beam] = 1.0
    nothing = np.full(3, np.nan)
    aiding.take("doppler", DopplerReading(0.0, reading, nothing, np.full(3, 0.03), nothing), 16.1)
    assert np.array_equal(state.inertial.velocity, told)


@pytest.mark.parametrize(
    "off", [(0.1, 0.1, 0.0), (0.1, 0.1, 0.1), (0.1, 0.0, np.nan), (2.0, 2.0, 2.0),
            (0.15, 0.08, 0.0)],
)  # fmt: skip
def test_faults_in_all_or_too_few_beams_lose_navigation(off):
    state, aiding, events = made()
    fly_beams(aiding, state, 0.0 * np.array(off))
    fly_beams(aiding, state, np.array(off), start=8.0, seed=4)
    assert aiding.lost
    assert "beam-excluded" not in {e.name for e in events}


def test_new_contradicting_beam_loses_navigation():
    """The faulty beam cannot be identified: the estimate comes from the others."""
    state, aiding, events = made()
    fly_beams(aiding, state, np.array([0.0, 0.0, np.nan]))
    fly_beams(aiding, state, np.array([0.0, 0.0, 2.0]), start=8.0, seed=4)
    assert aiding.lost
    assert "beam-excluded" not in {e.name for e in events}


def test_second_faulty_beam_loses_navigation():
    state, aiding, _ = made()
    fly_beams(aiding, state, np.zeros(3))
    fly_beams(aiding, state, np.array([0.1, 0.0, 0.0]), start=8.0, seed=4)
    assert not aiding.lost
    fly_beams(aiding, state, np.array([0.1, 1.0, 0.0]), start=16.0, seed=5)
    assert aiding.lost


@pytest.mark.parametrize("stated", [0.0, 0.1])
def test_common_beam_bias_does_not_bias_velocity(stated):
    """The biases are not specified; the filter assumes its minimum uncertainty."""
    instruments = INSTRUMENTS | {"doppler": VelocimeterInstrument(BEAMS, stated)}
    state, aiding, events = made(instruments=instruments)
    truth, rng = state.inertial.velocity.copy(), np.random.default_rng(6)
    for k in range(300):
        seen = np.array(BEAMS) @ truth + 0.03 + 0.03 * rng.normal(size=3)
        reading = DopplerReading(
            0.1 * k, seen, np.full(3, np.nan), np.full(3, 0.03), np.full(3, np.nan)
        )
        aiding.take("doppler", reading, 0.1 * k)
    sigma = np.sqrt(np.diag(state.covariance)[3:6])
    assert not events
    # All three beams measure body z: the initial 0.1 m/s is reduced to 0.02 / 0.8 / sqrt(3).
    assert sigma[2] > (0.012 if stated == 0.0 else 0.05)
    assert (np.abs(state.inertial.velocity - truth) < 3.0 * sigma).all()
    # The biases have changed since by at least the minimum random walk.
    own = state.block("speeds of doppler")
    wandered = np.diag(state.covariance)[own] - 0.005**2 * 30.0
    assert (wandered < max(stated, 0.02) ** 2).all()


@pytest.mark.parametrize(("beam", "far"), [(0, True), (2, True), (2, False)])
def test_impossible_beam_bias_loses_navigation(beam, far):
    state, aiding, events = made()
    place = state.block("speeds of doppler").start + beam
    state.p[place, place] = 0.0
    change = np.zeros(state.size)
    change[place] = 0.121 if far else 0.119
    state.correct(change)
    aiding.check_sensor_biases()
    assert aiding.lost == far
    lost = [("lost", "doppler", "speeds")] if far else []
    assert [(e.name, e.details["sensor"], e.details["measurement"]) for e in events] == lost


@pytest.mark.parametrize(("place", "name"), [(7, "accelerometers"), (14, "gyroscopes")])
def test_impossible_inertial_bias_loses_navigation(place, name):
    state, aiding, events = made()
    stated = state.inertial.bias_sigma[0 if place < 9 else 1]
    state.p[place, place] = 0.0
    change = np.zeros(15)
    change[place] = -5.9 * stated
    state.inertial.correct(change)
    aiding.check_sensor_biases()
    assert not aiding.lost
    change[place] = -0.2 * stated
    state.inertial.correct(change)
    # Not while the uncertainty of the bias is larger.
    state.p[place, place] = stated**2
    aiding.check_sensor_biases()
    assert not aiding.lost
    state.p[place, place] = 0.0
    for _ in range(3):
        aiding.check_sensor_biases()
    assert aiding.lost
    assert [(e.name, e.details["measurement"]) for e in events] == [("lost", name)]


def test_inflated_bias_does_not_correct_tilt():
    """The bias itself changed: its new estimate must not correct the tilt."""
    state, aiding, events = made()
    both = np.sqrt(state.covariance[6, 6] * state.covariance[10, 10])
    state.covariance[6, 10] = state.covariance[10, 6] = 0.95 * both
    for k in range(100):
        before = state.covariance.copy()
        seen = np.array(BEAMS) @ (state.inertial.velocity + [0.05, 0.0, 0.0])
        seen = seen + state.value("speeds of doppler")
        nothing = np.full(3, np.nan)
        reading = DopplerReading(0.0, seen, nothing, np.full(3, 0.03), nothing)
        aiding.take("doppler", reading, 0.1 * k)
        if events:
            break
    assert events[0].name == "drift"
    after = state.covariance
    assert after[6, 6] > 10.0 * before[6, 6]
    assert 0.5 < after[6, 10] / before[6, 10] < 1.001
    assert after[10, 10] == pytest.approx(before[10, 10], rel=1e-3)
    assert np.linalg.eigvalsh(after).min() > -1e-12


@pytest.mark.parametrize("kind", ["range", "speed", "attitude"])
def test_implausible_reading_is_rejected(kind):
    state, aiding, _ = made(relief=0.0)
    before, given = state.covariance.copy(), np.full(3, np.nan)
    if kind == "range":
        aiding.take("down", AltimeterReading(0.0, 140.0, 0.1), 0.0)
    elif kind == "speed":
        seen = np.array(BEAMS) @ (state.inertial.velocity + [0.5, 0.5, -2.0])
        aiding.take("doppler", DopplerReading(0.0, seen, given, np.full(3, 0.03), given), 0.0)
    else:
        seen = quat_from_rotation_vector([0.01, 0.0, 0.0])
        aiding.take("stars", AttitudeReading(0.0, seen, 4e-8 * np.eye(3)), 0.0)
    refused = [watch.rejected_count for watch in aiding.monitors.values() if watch.rejected_count]
    assert refused == [1] * (3 if kind == "speed" else 1)
    # The footprint of a beam has moved, independent of the measured range.
    keep = np.r_[0 : state.block("ground").stop]
    assert np.array_equal(state.covariance[np.ix_(keep, keep)], before[np.ix_(keep, keep)])


def test_gate_has_equal_probability_for_any_beam_count():
    rng = np.random.default_rng(0)
    for degrees in (1, 3, 8):
        refused = (rng.chisquare(degrees, 2_000_000) > innovation_gate(degrees)).mean()
        assert refused == pytest.approx(5e-5, rel=0.5)


@pytest.mark.parametrize(
    ("sensor", "measurement", "field"),
    [
        ("doppler", DopplerReading(0.0, np.zeros(2), np.ones(3), np.ones(3), np.ones(3)), "speed"),
        ("doppler", DopplerReading(0.0, np.zeros(3), np.ones(2), np.ones(3), np.ones(3)), "range"),
        ("stars", AttitudeReading(0.0, UPRIGHT, np.eye(2)), "covariance"),
    ],
)
def test_readings_with_wrong_shape_are_rejected_without_change(sensor, measurement, field):
    state, aiding, _ = made()
    p, x = state.covariance.copy(), state.inertial.velocity.copy()
    with pytest.raises(InputError, match=field):
        aiding.take(sensor, measurement, 0.0)
    assert np.array_equal(state.covariance, p)
    assert np.array_equal(state.inertial.velocity, x)


def test_time_reversal_and_invalid_terrain_are_rejected():
    _, aiding, _ = made()
    aiding.take("down", AltimeterReading(0.0, 100.0, 1.0), 5.0)
    for time in (4.0, np.nan):
        with pytest.raises(InputError, match="time"):
            aiding.take("down", AltimeterReading(0.0, 100.0, 1.0), time)
    for changes in ({"sigma": -1.0}, {"relief": np.nan}, {"elevation": np.inf}):
        with pytest.raises(InputError, match="terrain_prior"):
            TerrainPrior(**changes)


@pytest.mark.parametrize("relief", [0.05, 0.2])
def test_repeated_views_of_a_slope_do_not_bias_tilt(relief):
    """Slant ranges from one position: the terrain error is the same in each reading."""
    state, aiding, _ = made(relief=relief, sigma=0.5)
    state.covariance[9:12, 9:12] = 0.02**2 * np.eye(3)
    for k in range(300):
        noise = np.array([0.8, -0.6, 0.3]) * (-1.0) ** k
        given = np.full(3, np.nan)
        aiding.take("doppler", DopplerReading(
            0.1 * k, given, 125.0 + noise, given, np.full(3, 1.0)), 0.1 * k)  # fmt: skip
    # 75 m aside heights differ by so much, which turns the beams' triangle by as much as this.
    spread = relief * np.sqrt(10.0 * 75.0)
    by_ground = spread / (125.0 * 0.75)
    expected = 1.0 / np.sqrt(0.02**-2 + by_ground**-2)
    found = np.sqrt(np.diag(state.covariance)[9])
    assert 0.6 * expected < found < 1.4 * expected
    # With independent terrain errors, the slope would have been averaged away.
    assert found > 4.0 / np.sqrt(0.02**-2 + 300.0 * by_ground**-2)


def test_moved_footprint_is_new_terrain():
    state, aiding, _ = made(relief=0.2, sigma=0.5)
    place = state.block("ground under slanted").start

    def spread() -> float:
        over, at = np.array([1.0, -1.0]), np.array([place, state.block(TERRAIN).start])
        return float(over @ state.covariance[np.ix_(at, at)] @ over)

    full = 0.2**2 * 10.0 * 75.0
    for k in range(50):
        aiding.take("slanted", AltimeterReading(0.1 * k, 125.0, 0.1), 0.1 * k)
    known = spread()
    move = np.zeros(state.size)
    move[0] = 10.0
    state.inertial.correct(move[:15])
    aiding.take("slanted", AltimeterReading(5.0, 125.0, 1e3), 5.0)
    near = spread()
    move[0] = 700.0
    state.inertial.correct(move[:15])
    aiding.take("slanted", AltimeterReading(5.1, 125.0, 1e3), 5.1)
    far = spread()
    assert known < near < far
    assert far == pytest.approx(full, rel=0.1)


def slanted(aiding, time, sigma=1e3):
    aiding.take("slanted", AltimeterReading(time, 125.0, sigma), time)


def test_last_footprint_is_stored():
    state, aiding, _ = made(relief=0.2, sigma=0.5)
    place = np.array([state.block("ground under slanted").start, state.block(TERRAIN).start])

    def spread():
        p = state.covariance[np.ix_(place, place)]
        return p[0, 0] + p[1, 1] - 2.0 * p[0, 1]

    slanted(aiding, 0.0)
    state.inertial.correct(np.r_[700.0, np.zeros(14)])
    slanted(aiding, 0.1)
    fresh = spread()
    for k in range(50):
        slanted(aiding, 0.2 + 0.1 * k, 0.1)
    # The same terrain again gives no new information.
    slanted(aiding, 6.0, 1e6)
    assert spread() < 0.3 * fresh


def test_first_footprint_has_height_below_lander():
    state, aiding, _ = made(relief=0.2)
    error = np.zeros(state.size)
    error[state.block(TERRAIN)] = 4.0
    state.correct(error)
    slanted(aiding, 0.0, 1e6)
    assert state.value("ground under slanted")[0] == pytest.approx(4.0, abs=1e-3)


def test_footprint_offset_uses_site_height():
    """Terrain and site are 50 m higher than specified, the lander 50 m above them."""
    inertial = StrapdownState(np.array([0.0, 0.0, 100.0]), np.array([3.0, 0, -2]), UPRIGHT, 1.6)
    ground = TerrainPrior(0.0, 0.5, 0.2)
    blocks = aiding_blocks(INSTRUMENTS, ground) | empty_map_block()
    state = ErrorState(inertial, StartSigmas(1.0, 0.1, 1e-3), blocks=blocks)
    aiding = AidingMeasurements(state, INSTRUMENTS, ground, [])
    error = np.zeros(state.size)
    error[state.block(MAP).start + 2] = 50.0
    state.correct(error)
    slanted(aiding, 0.0, 1e6)
    at = np.array([state.block("ground under slanted").start, state.block(TERRAIN).start])
    p = state.covariance[np.ix_(at, at)]
    assert p[0, 0] + p[1, 1] - 2.0 * p[0, 1] == pytest.approx(0.2**2 * 10.0 * 37.5, rel=1e-3)


def test_beam_bias_is_a_random_walk():
    state, aiding, _ = made()
    nothing = np.full(3, np.nan)
    place, grown = state.block("speeds of doppler"), []
    for time in (0.0, 100.0):
        reading = DopplerReading(time, nothing, nothing, nothing, nothing)
        aiding.take("doppler", reading, time)
        grown.append(np.diag(state.covariance)[place].copy())
    assert grown[1] - grown[0] == pytest.approx(100.0 * 0.005**2)


def test_excluded_beam_inflates_accelerometer_bias():
    state, aiding, events = made()
    fly_beams(aiding, state, np.zeros(3))
    state.covariance[ACCELEROMETER, :] *= 1e-3
    state.covariance[:, ACCELEROMETER] *= 1e-3
    fly_beams(aiding, state, np.array([0.0, 2.0, 0.0]), start=8.0, seed=4)
    assert [e.name for e in events] == ["beam-excluded"]
    stated = state.inertial.bias_sigma[0]
    assert (np.sqrt(np.diag(state.covariance)[ACCELEROMETER]) > 0.9 * stated).all()
