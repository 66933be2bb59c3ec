"""Sensor faults in flight: each kind against the same flight without the fault.

Until a fault starts, both flights are the same, bit by bit. At the first faulty measurement the
true states are therefore equal, and the difference of the measurements is the fault.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import lunarsim
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.scenario.changes import with_values
from lunarsim.simulation.checkpoint import Checkpoint
from lunarsim.simulation.recorder import MessageRecorder
from tests.chance import ratio_bounds

START = 1.05
CYCLE = 0.1
SCENARIO = lunarsim.Scenario.from_dict({
    "terrain": {"size_m": 1000.0, "posting_m": 2.0},
    "simulation": {"cycle_s": CYCLE},
    "start": {"position_m": [-150.0, 0.0, 300.0], "velocity_m_s": [10.0, 0.0, -12.0]},
    "initial_uncertainty": {},
    "sensors": {
        "imu": {"kind": "imu"},
        "altimeter": {"kind": "radar-altimeter"},
        "velocimeter": {"kind": "velocimeter"},
        "stars": {"kind": "star-tracker"},
        "flash": {"kind": "flash-lidar", "rows": 32, "cols": 32},
    },
    "tasking": {"flash": {"kind": "periodic", "rate_hz": 10.0, "first_altitude_m": 1000.0}},
    "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 40.0}},
})  # fmt: skip


def flown(seconds=1.5, **faults):
    """Messages by sensor and time, and the record, of a flight of some seconds."""
    tables = {name: {"start_s": START} | table for name, table in faults.items()}
    scenario = SCENARIO.changed(sensor_faults=tables) if tables else SCENARIO
    tap = MessageRecorder()
    simulation = lunarsim.Simulation(scenario, 3, None, tap=tap)
    while simulation.time < seconds - 1e-9:
        simulation.move()
    found = {}
    for measurements, _, _ in tap.exchanges:
        for sensor, measurement in measurements.items:
            found[sensor, round(measurements.time, 6)] = measurement
    return found, simulation.flight()


@cache
def nominal():
    return flown()[0]


def pair(sensor, time=1.1, **fault):
    """The measurement at the first faulty cycle, with and without a fault."""
    with_fault = flown(fault={"sensor": sensor, **fault})[0]
    before = round(time - CYCLE, 6)
    fields = vars(with_fault[sensor, before])
    for name, value in vars(nominal()[sensor, before]).items():
        np.testing.assert_array_equal(fields[name], value)
    return with_fault.get((sensor, time)), nominal()[sensor, time]


def test_bias_of_a_range():
    faulty, usual = pair("altimeter", kind="bias", size=-30.0)
    assert faulty.range == pytest.approx(usual.range - 30.0)
    assert (faulty.time, faulty.sigma) == (usual.time, usual.sigma)


def test_bias_of_speeds_and_of_ranges():
    faulty, usual = pair("velocimeter", kind="bias", size=0.5)
    np.testing.assert_allclose(faulty.speed - usual.speed, 0.5)
    np.testing.assert_array_equal(faulty.range, usual.range)
    faulty, usual = pair("velocimeter", kind="bias", size=7.0, channel="range")
    np.testing.assert_allclose(faulty.range - usual.range, 7.0)


def test_a_bias_below_the_terrain_is_no_return():
    faulty, _ = pair("altimeter", kind="bias", size=-1000.0)
    assert np.isnan(faulty.range)


def test_noise_below_the_sensor_is_no_return():
    faulty, usual = pair("flash", kind="noise", sigma=1000.0)
    lost = np.isnan(faulty.range) & np.isfinite(usual.range)
    assert 0.1 < lost.mean() < 0.5
    assert (faulty.range[~np.isnan(faulty.range)] > 0.0).all()


def test_bias_of_an_attitude_turns_about_a_body_axis():
    faulty, usual = pair("stars", kind="bias", size=0.02, direction=[0.0, 1.0, 0.0])
    turn = quat_multiply(quat_conjugate(usual.attitude), faulty.attitude)
    np.testing.assert_allclose(quat_to_rotation_vector(turn), [0.0, 0.02, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("channel", "field", "atol"), [("", "angle", 2e-6), ("acceleration", "velocity", 2e-4)]
)
def test_bias_of_an_inertial_unit(channel, field, atol):
    """The samples of 0.01 s from 1.05 s on have the error, within two quantization steps."""
    faulty, usual = pair("imu", kind="bias", size=0.01, channel=channel, direction=[1.0, 0.0, 0.0])
    error = getattr(faulty, field) - getattr(usual, field)
    expected = np.zeros((5, 3))
    expected[4, 0] = 1e-4  # later samples differ also because the control reacts
    np.testing.assert_allclose(error[:5], expected, atol=atol)


def test_drift_grows_from_the_start():
    faulty, usual = pair("altimeter", kind="drift", rate=20.0)
    assert faulty.range - usual.range == pytest.approx(20.0 * (1.1 - START))


def test_noise_has_its_sigma_in_every_pixel():
    faulty, usual = pair("flash", kind="noise", sigma=2.0)
    error = (faulty.range - usual.range)[np.isfinite(usual.range)] / 2.0
    assert len(error) > 500
    low, high = ratio_bounds(len(error))
    assert low < np.mean(error**2) < high


def test_dropout_is_silent_until_its_end():
    found, _ = flown(fault={"sensor": "stars", "kind": "dropout", "end_s": 1.35},
                     other={"sensor": "flash", "kind": "dropout"})  # fmt: skip
    for sensor, last in (("stars", 1.3), ("flash", 9.0)):
        times = sorted(time for name, time in nominal() if name == sensor)
        kept = [time for time in times if not START <= time <= last]
        assert 0 < len(kept) < len(times)
        assert sorted(time for name, time in found if name == sensor) == kept


def test_a_frozen_sensor_repeats_its_last_measurement():
    faulty, usual = pair("altimeter", kind="frozen")
    assert faulty.range == nominal()["altimeter", 1.0].range
    assert faulty.time == usual.time
    found, _ = flown(fault={"sensor": "imu", "kind": "frozen"})
    last = nominal()["imu", 1.1]  # the first complete cycle after the start is the next one
    for field in ("angle", "velocity"):
        repeated = np.tile(getattr(last, field)[-1], (10, 1))
        np.testing.assert_allclose(getattr(found["imu", 1.2], field), repeated, atol=1e-15)


def test_a_frozen_sensor_repeats_the_faults_before_it_in_the_file():
    bias = {"sensor": "altimeter", "kind": "bias", "size": 100.0, "start_s": 0.0}
    freeze = {"sensor": "altimeter", "kind": "frozen"}
    usual = flown(bias=bias)[0]["altimeter", 1.0].range
    for faults in ({"bias": bias, "freeze": freeze}, {"freeze": freeze, "bias": bias}):
        found, _ = flown(**faults)
        assert found["altimeter", 1.1].range == pytest.approx(usual)
        assert found["altimeter", 1.4].range == pytest.approx(usual)


def test_a_sensor_frozen_from_the_start_repeats_its_first_measurement():
    found, _ = flown(fault={"sensor": "altimeter", "kind": "frozen", "start_s": 0.0})
    ranges = [m.range for (name, _), m in found.items() if name == "altimeter"]
    assert len(ranges) > 10
    assert len(set(ranges)) == 1


@pytest.mark.parametrize("order", [("bias", "freeze"), ("freeze", "bias")])
def test_a_bias_of_a_frozen_inertial_unit_does_not_grow(order):
    faults = {
        "bias": {"sensor": "imu", "kind": "bias", "channel": "acceleration", "size": 1.0,
                 "start_s": 0.0, "end_s": 1.25},
        "freeze": {"sensor": "imu", "kind": "frozen"},
    }  # fmt: skip
    found, _ = flown(**{name: faults[name] for name in order})
    last, *frozen = (found["imu", time].velocity[:, 2] for time in (1.1, 1.2, 1.3, 1.4))
    quantum = 1e-4
    assert frozen[0] == pytest.approx(np.full(10, last[-1]), abs=quantum)
    # A bias before the freeze is repeated with it; one after the freeze ends on its own.
    after = last[-1] - (0.01 if order == ("freeze", "bias") else 0.0)
    assert frozen[2] == pytest.approx(np.full(10, after), abs=quantum)


def test_latencies_of_one_sensor_add_up():
    exact = {"altimeter": {"noise_ratio": 0.0, "noise_floor_m": 1e-9}}
    late = {"kind": "latency", "sensor": "altimeter", "delay_s": 0.3, "start_s": START}
    tap = MessageRecorder()
    scenario = SCENARIO.changed(sensors=exact, sensor_faults={"a": late, "b": late})
    simulation = lunarsim.Simulation(scenario, 3, None, tap=tap)
    while simulation.time < 1.5:
        simulation.move()
    ranges = {round(m.time, 6): dict(m.items)["altimeter"] for m, _, _ in tap.exchanges}
    assert ranges[1.1].range == pytest.approx(ranges[0.5].range, abs=1e-6)


def test_the_end_of_a_fault_is_exclusive():
    found, _ = flown(fault={"sensor": "altimeter", "kind": "dropout", "end_s": 1.2})
    assert ("altimeter", 1.1) not in found
    assert ("altimeter", 1.2) in found


def test_a_checkpoint_within_faults_continues_with_the_same_bits():
    faults = {
        "late": {"sensor": "altimeter", "kind": "latency", "delay_s": 0.35, "start_s": 0.5},
        "hiss": {"sensor": "velocimeter", "kind": "noise", "sigma": 0.1, "start_s": 0.0},
        "stuck": {"sensor": "stars", "kind": "frozen", "start_s": 0.7},
        "bias": {"sensor": "imu", "kind": "noise", "sigma": 1e-3, "start_s": 0.0},
        "freeze": {"sensor": "imu", "kind": "frozen", "start_s": 0.8, "end_s": 1.0},
    }
    simulation = lunarsim.Simulation(SCENARIO.changed(sensor_faults=faults), 3, None)
    while simulation.time < 0.9 - 1e-9:
        simulation.move()
    again = Checkpoint(simulation).resumed()
    for one in (simulation, again):
        while one.time < 1.5:
            one.move()
    first, second = simulation.flight(), again.flight()
    for name, column in (first.trajectory | first.navigation).items():
        assert (second.trajectory | second.navigation)[name].tobytes() == column.tobytes()


@pytest.mark.parametrize(
    ("kind", "key", "value"), [("bias", "size", -1e5), ("drift", "rate", 1e308),
                               ("noise", "sigma", 1e300), ("bias", "size", float("nan"))],
)  # fmt: skip
def test_sizes_beyond_their_bounds_are_refused(kind, key, value):
    """A huge size made a mapper or the filter fail in flight, with an unrelated message."""
    with pytest.raises(lunarsim.InputError, match=rf"sensor_faults\.a\.{key}: must be"):
        SCENARIO.changed(sensor_faults={"a": {"sensor": "flash", "kind": kind, key: value}})


def test_latency_delivers_older_measurements_with_current_stamps():
    exact = {"altimeter": {"noise_ratio": 0.0, "noise_floor_m": 1e-9}}
    tap = MessageRecorder()
    scenario = SCENARIO.changed(
        sensors=exact,
        sensor_faults={"late": {"kind": "latency", "sensor": "altimeter", "delay_s": 0.25,
                                "start_s": START}},
    )  # fmt: skip
    simulation = lunarsim.Simulation(scenario, 3, None, tap=tap)
    while simulation.time < 1.5:
        simulation.move()
    ranges = {round(m.time, 6): dict(m.items)["altimeter"] for m, _, _ in tap.exchanges}
    # 0.25 s before 1.1 s is 0.85 s: the last cycle before is that of 0.8 s.
    assert ranges[1.1].range == pytest.approx(ranges[0.8].range, abs=1e-6)
    assert ranges[1.1].time == pytest.approx(1.1)
    assert abs(ranges[0.9].range - ranges[0.8].range) > 0.5


def test_a_wrong_range_gate_loses_returns_outside():
    usual = nominal()["velocimeter", 1.1]
    limit = float(np.mean(usual.range))
    faulty, _ = pair("velocimeter", kind="range-gate", gate_max_m=limit)
    lost = usual.range > limit
    assert lost.any()
    assert not lost.all()
    for field in ("range", "speed", "speed_sigma", "range_sigma"):
        np.testing.assert_array_equal(np.isnan(getattr(faulty, field)), lost)
        np.testing.assert_array_equal(getattr(faulty, field)[~lost], getattr(usual, field)[~lost])


def test_starts_and_ends_are_events_and_seeds_repeat():
    faults = {
        "cliff": {"sensor": "altimeter", "kind": "bias", "size": 3.0, "end_s": 1.2},
        "hiss": {"sensor": "velocimeter", "kind": "noise", "sigma": 0.1},
        "later": {"sensor": "stars", "kind": "dropout", "start_s": 90.0},
    }
    _, first = flown(**faults)
    events = [e for e in first.events if e["name"].startswith("fault")]
    assert events == [
        {"time": START, "name": "fault-started", "fault": "cliff", "kind": "bias",
         "sensor": "altimeter"},
        {"time": START, "name": "fault-started", "fault": "hiss", "kind": "noise",
         "sensor": "velocimeter"},
        {"time": 1.2, "name": "fault-ended", "fault": "cliff", "kind": "bias",
         "sensor": "altimeter"},
    ]  # fmt: skip
    _, second = flown(**faults)
    for name, column in first.trajectory.items():
        np.testing.assert_array_equal(column, second.trajectory[name])


@pytest.mark.parametrize("never", [{"start_s": 1e4}, {"start_s": 0.0, "occurs": False}])
def test_faults_that_never_start_or_do_not_occur_change_no_bit(never):
    faults = {
        f"{sensor}-{kind}": {"sensor": sensor, "kind": kind, **never}
        for sensor, kinds in {
            "imu": ("bias", "drift", "noise", "frozen"),
            "altimeter": ("bias", "drift", "noise", "dropout", "frozen", "latency", "range-gate"),
            "flash": ("noise", "frozen", "latency"),
        }.items()
        for kind in kinds
    }
    _, usual = flown()
    _, with_faults = flown(**faults)
    for name, column in usual.trajectory.items():
        np.testing.assert_array_equal(column, with_faults.trajectory[name])


def test_navigation_reports_a_biased_velocimeter():
    words = {"covariance-inflated", "drift", "beam-excluded", "lost"}
    usual, faulty = (
        {event["name"] for event in flown(6.0, **faults)[1].events}
        for faults in ({}, {"fault": {"sensor": "velocimeter", "kind": "bias", "size": 0.5}})
    )
    assert not usual & words
    assert faulty & words


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"sensor": "imu", "kind": "dropout"}, "sensor_faults.a.kind: is not possible for a sensor "
         "of kind 'imu', got 'dropout'. Kinds for this sensor: bias, drift, noise, frozen."),
        ({"sensor": "stars", "kind": "range-gate"}, "Kinds for this sensor: bias, drift, noise, "
         "dropout, frozen, latency."),
        ({"sensor": "altimetre", "kind": "bias"}, "sensor_faults.a.sensor: must be the name of a "
         "sensor, got 'altimetre'. Did you mean 'altimeter'?"),
        ({"sensor": "altimeter", "kind": "bias", "channel": "speed"}, "sensor_faults.a.channel: "
         "must be a quantity that a sensor of kind 'radar-altimeter' measures, got 'speed'. "
         "Quantities: range."),
        ({"sensor": "altimeter", "kind": "bias", "start_s": 5.0, "end_s": 4.0},
         "sensor_faults.a.end_s: must be later than start_s, which is 5 s, got 4.0."),
        ({"sensor": "altimeter", "kind": "range-gate", "gate_min_m": 5.0, "gate_max_m": 4.0},
         "sensor_faults.a.gate_min_m: must be less than gate_max_m, which is 4 m, got 5.0."),
        ({"sensor": "altimeter", "kind": "stuck"}, "sensor_faults.a.kind: "),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(table, message):
    with pytest.raises(lunarsim.InputError) as caught:
        SCENARIO.changed(sensor_faults={"a": table})
    assert message in str(caught.value)


def test_dispersions_and_options_reach_the_keys():
    made = SCENARIO.changed(sensor_faults={"a": {"sensor": "altimeter", "kind": "bias"}})
    changed = with_values(made, {"sensor_faults.a.size": 4.0, "sensor_faults.a.start_s": 2.0}, "x")
    fault = changed.sensor_faults["a"]
    assert (fault.size, fault.start_s) == (4.0, 2.0)
    assert lunarsim.Scenario.from_toml(changed.to_toml()).sensor_faults["a"].size == 4.0
    assert "a" not in changed.changed(sensor_faults={"a": None}).sensor_faults
    assert "sensor_faults" not in SCENARIO.to_dict()
