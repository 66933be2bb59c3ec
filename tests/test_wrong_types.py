"""Settings that are no numbers, or none that can be, are refused with their names."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError, check_types
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.hazards.shadows import HazardPrior, TrackerSettings
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.image_quality import (
    ImageQualityCheck,
    ImageRejection,
)
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.field import RockModel
from lunarsim.scenario import Scenario
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.exposure_control import ExposureControl
from lunarsim.world.light import Light
from lunarsim.world.photometry import hapke_of_albedo
from tests.conftest import ROOT
from tests.shadow_scene import at

NAN = float("nan")


@pytest.mark.parametrize(
    ("make", "name", "wrong"),
    [
        (Camera, "width", ["a", NAN, 2.5, True]),
        (Camera, "fx", ["a", None, NAN, -1.0]),
        (Camera, "cx", ["a", NAN, np.inf]),
        (Camera, "distortion", [(NAN,) * 5, (1.0, 2.0), "abcde", (-2.0, 0.0, 0.0, 0.0, 0.0)]),
        (Camera, "offset", [(NAN, 0.0, 0.0), (1.0,), "abc"]),
        (Camera, "mount", [np.eye(2), -np.eye(3), np.full((3, 3), NAN)]),
        (Camera, "exposure", ["a", None, NAN]),
        (Camera, "shot_noise", ["no", 1]),
        (Camera, "bits", [True, "8", 8.5]),
        (Camera, "detector_seed", [-1, "s"]),
        (ExposureControl, "max_change_factor", ["a"]),
        (Light, "azimuth", [None, "a"]),
        (Light, "elevation", [True]),
        (Light, "scattered_light", ["no", None]),
        (Light, "photometry", [["hapke"], 3]),
        (TrackerSettings, "min_rocks_in_view", ["a", 2.5, -1]),
        (TrackerSettings, "min_landmark_radius", ["a", NAN]),
        (DetectionRates, "missed", ["abc", (1.0, None, 0.1)]),
        (RockModel, "burial", ["ab", (0.1, "x")]),
        (HazardPrior, "cover", ["a", None]),
        (HazardPrior, "max_diameter", ["a", None]),
    ],
)
def test_settings_of_a_wrong_type_name_their_field(make, name, wrong):
    for value in wrong:
        with pytest.raises(InputError, match=name):
            make(**{name: value})


def test_what_has_no_end_is_refused():
    for factor in (np.inf, 1.0):
        with pytest.raises(InputError, match=r"camera\.exposure_change"):
            ExposureControl(max_change_factor=factor)
    with pytest.raises(InputError, match=r"prior\.max_diameter"):
        HazardPrior(max_diameter=np.inf)


def test_numbers_of_numpy_are_numbers():
    assert Camera(width=np.int64(320), fx=np.float32(300.0)).width == 320
    check_types("x", Camera())
    assert TrackerSettings(min_rocks_in_view=np.int32(3), min_birth_q=2).min_rocks_in_view == 3


def test_models_of_shadows_refuse_what_is_no_sun_and_no_shape():
    for elevation in ("a", None, NAN, 2.0):
        with pytest.raises(InputError, match=r"sun\.elevation"):
            ShadowModel(elevation)
    with pytest.raises(InputError, match=r"rocks\.shape"):
        ShapeMixture(0.3, "egg")
    for albedo in (-0.1, NAN, 1.1):
        with pytest.raises(InputError, match=r"sun\.albedo"):
            hapke_of_albedo(albedo, 0.26, 0.08, 2.0, 0.07, 0.4)


def test_distortion_that_can_be_taken_out_is_taken():
    """Brown-Conrady folds a wide picture over where a narrow one is well."""
    strong = (-0.6, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"camera\.distortion: .*narrower"):
        Camera.with_field_of_view(320, 240, 80.0, distortion=strong)
    x, y = Camera.with_field_of_view(320, 240, 30.0, distortion=strong).tangents
    shrunk = 1.0 - 0.6 * (x * x + y * y)
    camera = CameraModel(320, 240, *2 * [160.0 / np.tan(np.radians(15.0))])
    np.testing.assert_allclose(
        camera.fx * x * shrunk + camera.cx, np.broadcast_to(np.arange(320), (240, 320)), atol=1e-6
    )


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"sun": {"elevation_deg": 1.9}}, "sun.elevation_deg"),
        ({"sun": {"elevation_deg": 80.5}}, "sun.elevation_deg"),
        ({"sensors": {"camera": {"exposure_min_s": 1.0}}}, "exposure_min_s"),
        ({"sensors": {"camera": {"distortion": [-2.0, 0, 0, 0, 0]}}}, "camera.distortion"),
        ({"sensors": {"camera": {"blur_sigma_px": 1e9}}}, "blur_sigma_px"),
        ({"sensors": {"camera": {"read_noise_electrons": 1e300}}}, "read_noise_electrons"),
    ],
)
def test_a_scenario_that_no_flight_could_begin_with_is_refused_before(changes, name):
    scenario = Scenario.load(ROOT / "scenarios" / "shadow_modified.toml")
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        scenario.changed(**changes)


def test_nothing_that_a_sensor_gives_raises():
    state, camera = at((0.0, 0.0, 40.0))
    health = ImageQualityCheck()
    for counts in ([[1, 2], [3]], None, "abc", object()):
        assert health.before_detection(counts, camera.model, state).fault is ImageRejection.FORM
    counts = np.full((480, 640), 100, np.uint8)
    for position in (np.zeros(2), None, "abc"):
        pose = type("Pose", (), {"position": position, "attitude": state.attitude})()
        assert health.before_detection(counts, camera.model, pose).fault is ImageRejection.POSE
    for attitude in (None, "abcd", np.zeros(3)):
        pose = type("Pose", (), {"position": state.position, "attitude": attitude})()
        assert health.before_detection(counts, camera.model, pose).fault is ImageRejection.POSE
