"""What a sensor is expected to see of the ground."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.frames import direction_from_angles
from lunarsim.models.instruments import CameraInstrument, LidarInstrument
from lunarsim.models.lander import Lander
from lunarsim.onboard.active_perception.information import ExpectedRocks
from lunarsim.onboard.active_perception.sensor_coverage import (
    build_camera_model,
    build_coverage_models,
    build_lidar_model,
    mean_rock_height,
    position_variance,
    table_directions,
)
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.population import RockExpectation
from lunarsim.sensors.framing_camera import FramingCamera
from lunarsim.sensors.lidar import FlashLidar


def briefing(elevation=20.0, cover=0.05, mappers=("camera", "flash"), tasked=("camera", "flash")):
    return SimpleNamespace(
        lander=Lander(), rocks=RockExpectation(cover=cover, shape="cube"),
        sun=direction_from_angles(np.radians(225.0), np.radians(elevation)),
        instruments={"camera": CameraInstrument(np.pi), "flash": LidarInstrument(np.pi),
                     "imu": None},
        software=SimpleNamespace(
            mappers={name: SimpleNamespace(sensor=name) for name in mappers},
            tasking=dict.fromkeys(tasked),
        ),
    )  # fmt: skip


@pytest.fixture(scope="module")
def camera():
    return build_camera_model("camera", CameraInstrument(np.pi), briefing(), 0.5)


def test_a_camera_is_as_sharp_as_the_shadow_model_says(camera):
    model = ShapeMixture(np.radians(20.0), "cube")
    azimuth, depression = table_directions()
    for i, j in ((0, 12), (16, 20), (32, 30), (25, 8)):
        q = model.visible_q(0.4, azimuth[i, j], depression[i, j], 150.0 / 554.3)
        assert 0.4 * camera.sharpness[i, j] / (150.0 / 554.3) == pytest.approx(float(q))
    # With the Sun behind it and as low as that, rocks hide their shadows; before it they do not.
    low = int(np.argmin(abs(depression[0] - np.radians(22.0))))
    assert camera.sharpness[-1, low] < 0.5 * camera.sharpness[0, low]
    assert (camera.sharpness[:, 0] == 0.0).all()
    np.testing.assert_allclose(camera.sun, np.array([-1.0, -1.0]) / np.sqrt(2.0))


def test_shadows_of_other_rocks_hide_terrain_the_more_the_more_there_are(camera):
    crowded = build_camera_model("camera", CameraInstrument(np.pi), briefing(cover=0.15), 0.5)
    assert (crowded.visible_fraction <= camera.visible_fraction).all()
    assert (crowded.visible_fraction < camera.visible_fraction)[:, -1].all()
    assert 0.7 < camera.visible_fraction[0, -1] < 1.0
    # From where the Sun stands and as low, nothing dark is seen.
    assert camera.visible_fraction[-1, 0] == pytest.approx(1.0)


def test_places_seen_at_a_grazing_angle_lie_astray(camera):
    steep, grazing = position_variance(np.radians([85.0, 25.0]))
    assert grazing > 15.0 * steep
    # Straight down a direction errs alike on both axes; at 30 deg twice as far along the sight.
    assert position_variance(np.pi / 2) == pytest.approx(1e-6)
    assert position_variance(np.pi / 6) == pytest.approx(0.5 * (5e-6 + 0.75 * 0.007**2))
    np.testing.assert_allclose(
        camera.displacement[:, -1], 0.5 * position_variance(np.pi / 2) / 0.25**2
    )
    assert np.isfinite(camera.displacement).all()


def test_a_lidar_misses_what_no_return_falls_on():
    eye = build_lidar_model("flash", LidarInstrument(np.pi), briefing(), 0.5)
    _, depression = table_directions()
    np.testing.assert_allclose(eye.sharpness, np.sqrt(np.sin(depression)))
    # Returns on a disc of 0.25 m from 200 m, straight down: one every 0.156 m.
    sharpness = 1.0 / (200.0 * eye.pixel)
    rng = np.random.default_rng(1)
    cell = 200.0 * eye.pixel
    empty = np.mean([
        len(p) == 0 or not (np.hypot(*(p - 2.0).T) < 0.25).any()
        for p in (rng.uniform(0.0, 4.0, (rng.poisson((4.0 / cell) ** 2), 2)) for _ in range(4000))
    ])  # fmt: skip
    assert np.exp(-np.pi * (0.25 * sharpness) ** 2) == pytest.approx(empty, abs=0.01)
    assert (eye.displacement == 0.0).all()
    assert eye.max_range == LidarInstrument(np.pi).max_range < np.inf
    assert eye.visible_fraction[0, 0] == 0.0
    assert eye.visible_fraction[0, -1] == pytest.approx(1.0)
    # Rocks before it hide so much of the ground at 30 deg.
    rocks = ExpectedRocks.golombek(0.05, 0.3)
    hidden = (
        2.0 * mean_rock_height(briefing().rocks) * rocks.number @ rocks.radius**2 * np.sqrt(3.0)
    )
    assert eye.visible_fraction[0, 16] == pytest.approx(np.exp(-hidden), rel=1e-6)


def test_beyond_the_greatest_incidence_nothing_comes_back():
    eye = build_lidar_model(
        "flash", LidarInstrument(np.pi, max_incidence=np.radians(60.0)), briefing(), 0.5
    )
    _, depression = table_directions()
    assert (eye.sharpness[depression < np.radians(29.9)] == 0.0).all()
    assert (eye.sharpness[depression > np.radians(30.1)] > 0.0).all()


def test_only_what_a_mapper_takes_and_something_points_is_a_sensor():
    assert [e.name for e in build_coverage_models(briefing(), 0.5)] == ["camera", "flash"]
    assert [e.name for e in build_coverage_models(briefing(mappers=("flash",)), 0.5)] == ["flash"]
    assert [e.name for e in build_coverage_models(briefing(tasked=("flash",)), 0.5)] == ["flash"]
    assert [e.name for e in build_coverage_models(briefing(elevation=1.0), 0.5)] == ["flash"]
    assert build_coverage_models(briefing(mappers=()), 0.5) == []


def test_instruments_report_pixel_and_field():
    camera = FramingCamera(width=320, height=240, field_of_view=np.radians(60.0)).calibration()
    assert camera.pixel == pytest.approx(np.tan(np.radians(30.0)) / 160.0)
    assert camera.tan_half_fov == pytest.approx(0.75 * np.tan(np.radians(30.0)))
    flash = FlashLidar(rows=64, cols=128, half_fov_tangent=0.2, max_range=700.0)
    assert flash.calibration().pixel == pytest.approx(0.4 / 64)
    assert flash.calibration().max_range == 700.0
    even = replace(flash, pixel_spacing="angle").calibration()
    assert even.pixel == pytest.approx(2.0 * np.arctan(0.2) / 64)
