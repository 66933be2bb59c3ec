"""Data of the onboard computer arrive in messages under their names."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from lunarsim import Grid
from lunarsim.interface.definitions import SensorKind
from lunarsim.interface.structs import Struct
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    CameraImage,
    DopplerReading,
    InertialSamples,
    LidarScan,
    Measurements,
    NavigationFix,
)
from lunarsim.messages.prior_map import PriorMap
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.external.encode import (
    MeasurementWriter,
    new_briefing,
    read_estimate,
    write_estimate,
    write_observation,
)
from lunarsim.onboard.policies.contract import Candidates
from lunarsim.simulation import Simulation
from tests.interface.software import small

RNG = np.random.default_rng(2)
N = RNG.standard_normal
MEASUREMENTS = {
    "inertial_samples": InertialSamples(1.0, N((5, 3)), N((5, 3))),
    "altimeter_reading": AltimeterReading(2.0, 3.5, 0.25),
    "doppler_reading": DopplerReading(3.0, N(4), N(4), N(4), N(4)),
    "attitude_reading": AttitudeReading(4.0, N(4), N((3, 3))),
    "navigation_fix": NavigationFix(5.0, N(3), N(3), N(4), N((9, 9))),
    "lidar_scan": LidarScan(6.0, N(6), N((6, 3)), N((3, 3)), N(6), (2, 3)),
}


def assert_written(message: Struct, source: object, skipped: tuple[str, ...] = ()) -> None:
    """Check all fields of a dataclass against the fields of a message with the same names."""
    for f in fields(source):
        if f.name in skipped:
            continue
        value = np.asarray(getattr(source, f.name), np.float64)
        found = message.arrays.get(f.name)
        found = message.get(f.name) if found is None else found
        found = np.asarray(found, np.float64)
        assert np.array_equal(np.ravel(found), np.ravel(value), equal_nan=True), f.name


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_measurement_is_written_field_by_field(name):
    writer, out = MeasurementWriter(("a", "b")), Struct("Measurements")
    measurement = MEASUREMENTS[name]
    writer.write(out, Measurements(9.0, (("b", measurement), ("a", measurement))))
    assert out.get("time") == 9.0
    first, second = out.parts[name]
    assert (first.get("sensor"), second.get("sensor")) == (1, 0)
    for part in (first, second):
        assert_written(part, measurement, ("shape",))
    # The next cycle without this measurement has an empty list.
    writer.write(out, Measurements(10.0))
    assert out.get(f"{name}_count") == 0


def test_sizes_of_scans_and_samples_are_written():
    writer, out = MeasurementWriter(("a",)), Struct("Measurements")
    names = ("inertial_samples", "doppler_reading", "lidar_scan")
    writer.write(out, Measurements(9.0, tuple(("a", MEASUREMENTS[n]) for n in names)))
    assert out.parts["inertial_samples"][0].get("sample_count") == 5
    assert out.parts["doppler_reading"][0].get("beam_count") == 4
    scan = out.parts["lidar_scan"][0]
    assert (scan.get("rows"), scan.get("cols")) == (2, 3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_image_is_written_with_its_camera(dtype):
    camera = CameraModel(
        width=4, height=3, fx=50.0, fy=60.0, cx=1.25, cy=0.75,
        distortion=(1e-3, 2e-3, 3e-3, 4e-3, 5e-3), offset=(1.0, 2.0, 3.0),
    )  # fmt: skip
    counts = RNG.integers(0, 255, (3, 4)).astype(dtype)
    out = Struct("Measurements")
    image = CameraImage(7.0, counts, camera, 0.01)
    MeasurementWriter(("camera",)).write(out, Measurements(7.0, (("camera", image),)))
    (part,) = out.parts["camera_image"]
    assert_written(part, camera)
    assert part.get("exposure") == 0.01
    assert part.get("bytes_per_pixel") == counts.itemsize
    assert np.array_equal(part.arrays["pixels"].view(dtype).reshape(3, 4), counts)


def test_estimate_comes_back():
    estimate = Simulation(small(), 3, "no-divert").estimate
    out = Struct("Estimate")
    write_estimate(out, estimate)
    assert_written(out, estimate)
    back = read_estimate(out)
    for f in fields(estimate):
        assert np.array_equal(getattr(back, f.name), getattr(estimate, f.name)), f.name


def test_briefing_is_written():
    prior_map = PriorMap(Grid.centred((1.0, 2.0), 12.0, 3.0), N((4, 4)), 0.5)
    briefing = replace(Simulation(small(), 3, "no-divert").briefing, prior_map=prior_map)
    out = new_briefing(briefing, "gain 6")
    assert out.get("configuration") == b"gain 6"
    assert_written(out.parts["vehicle"], briefing.lander, tuple(
        f.name for f in fields(briefing.lander)
        if f.name not in {g.name for g in out.message.fields}
        and f.name not in out.parts["vehicle"].flat
        and f.name not in {g.name for g in out.parts["vehicle"].message.fields}
    ))  # fmt: skip
    assert out.parts["vehicle"].get("exhaust_velocity") == briefing.lander.exhaust_velocity
    for name in ("target", "heading", "time_to_go", "sun", "step", "cycle"):
        assert np.array_equal(out.get(name), getattr(briefing, name)), name
    lag = briefing.software.control.response_time + briefing.lander.thrust_lag
    assert out.get("lag") == lag > briefing.lander.thrust_lag
    assert out.get("gravity") == pytest.approx(1.622)
    start = briefing.start
    for name in ("position", "velocity", "attitude", "position_sigma", "velocity_sigma"):
        assert np.array_equal(out.get(f"start_{name}"), getattr(start, name)), name
    assert [part.get("name") for part in out.parts["sensor"]] == [b"imu", b"fix", b"flash"]
    assert [part.get("kind") for part in out.parts["sensor"]] == [
        SensorKind.INERTIAL_UNIT, SensorKind.NAVIGATION_FIX, SensorKind.LIDAR,
    ]  # fmt: skip
    assert [part.get("is_tasked") for part in out.parts["sensor"]] == [0, 0, 1]
    (prior,) = out.parts["prior_map"]
    assert np.array_equal(prior.arrays["elevation"], briefing.prior_map.elevation, equal_nan=True)


def test_observation_is_written():
    simulation = Simulation(small(), 4)
    while not simulation.decision_due:
        simulation.move()
    sites = Candidates(
        N((4, 3)), RNG.random(4), 9.0 * RNG.random(4), 9.0 * RNG.random(4), RNG.random(4)
    )
    seen = replace(simulation.observe(), candidates=sites)
    out = Struct("PolicyInput")
    write_observation(out, seen)
    assert_written(out, seen, (
        "estimate", "hazard_map", "candidates", "scoreboard", "reachability",
    ))  # fmt: skip
    assert_written(out.parts["candidates"], seen.candidates, ("score", "source"))
    assert out.parts["candidates"].get("site_count") == len(seen.candidates)
    hazards, grid = out.parts["map"], seen.hazard_map.grid
    for name in ("p_safe", "observed", "elevation"):
        given = getattr(seen.hazard_map, name)
        assert np.array_equal(hazards.arrays[name].reshape(grid.shape), given, equal_nan=True)
    assert_written(hazards.parts["grid"], grid)
