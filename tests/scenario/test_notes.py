"""What is told of a scenario that can be flown and is odd all the same."""

from __future__ import annotations

import pytest

from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.scenario.scenario_warnings import warnings_for
from lunarsim.simulation import Simulation
from tests.worlds import SCENARIOS

CAMERA = {"kind": "camera"}
FIXED = {"imu": "imu", "fix": "navigation-fix", "flash": "flash-lidar"}


def notes(**tables):
    return warnings_for(Scenario.from_dict(tables))


def test_the_default_study_has_nothing_odd():
    assert notes() == []


@pytest.mark.parametrize(
    ("tables", "begins", "told"),
    [
        (
            {"vehicle": {"thrust_min_n": 1700.0}, "truth": {"vehicle": {"thrust_scale": 1.4}}},
            "truth.vehicle: the minimum thrust of the true lander is 2380 N", "weight of 1784 N",
        ),
        (
            {"vehicle": {"kind": "jet-lander", "engine": {"gimbal_limit_deg": 0.0}},
             "control": {"kind": "phase-plane"},
             "truth": {"vehicle": {"thrust_misalignment_deg": [8.0, 0.0]}}},
            "truth.vehicle: the misaligned thrust turns", "thrust_misalignment_deg = [8, 0]",
        ),
        (
            {"sensor_faults": {"a": {"kind": "bias", "sensor": "altimeter"}}},
            "sensor_faults.a.size = 0", "no effect",
        ),
        (
            {"vehicle": {"dry_mass_kg": 400.0, "inertia_dry_kg_m2": [1100.0, 1100.0, 1300.0]}},
            "vehicle.inertia_dry_kg_m2: ", "for 400 kg",
        ),
        (
            {"vehicle": {"inertia_dry_kg_m2": [11.0, 11.0, 13.0]}},
            "vehicle.inertia_dry_kg_m2: ", "got [11, 11, 13]. Omit it",
        ),
        (
            {"vehicle": {"inertia_full_kg_m2": [1000.0, 1000.0, 1000.0]}},
            "vehicle.inertia_full_kg_m2", "less than inertia_dry_kg_m2",
        ),
        ({"vehicle": {"torque_max_n_m": [1.0, 600.0, 300.0]}}, "vehicle.torque_max_n_m", "rad/s^2"),
        (
            {"vehicle": {"torque_max_n_m": [40_000.0, 600.0, 300.0]}}, "vehicle.torque_max_n_m",
            "rad/s^2",
        ),
        ({"vehicle": {"com_height_m": 20.0}}, "vehicle.slope_limit_deg: ", "tips over at 4.75 deg"),
        ({"vehicle": {"roughness_limit_m": 0.4}}, "vehicle.roughness_limit_m", "belly_clearance_m"),
        (
            {
                "sun": {"elevation_deg": 5.0},
                "sensors": {name: {"kind": kind} for name, kind in FIXED.items()},
            },
            "sun.elevation_deg = 5",
            "no sensor depends on sunlight",
        ),
        (
            {"terrain": {"kind": "hazard-field"}, "rocks": {"cover": 0.1}},
            "rocks.cover = 0.1", "its own boulders",
        ),
        ({"rocks": {"cover": 0.0, "shape": "cube"}}, "rocks.shape = 'cube'", "cover = 0"),
        ({"rocks": {"min_block_crater_diameter_m": 30.0}},
        "rocks.min_block_crater_diameter_m = 30", "cluster_fraction = 0"),
        (
            {"terrain": {"kind": "dtm", "path": "x.tif", "preset": "mare", "detail": False}},
            "terrain.preset = 'mare'", "detail = false",
        ),
        ({"terrain": {"crater_equilibrium_diameter_m": 9.0}},
        "terrain.crater_equilibrium_diameter_m", "no craters"),
        (
            {"policy": {"kind": "no-divert"}, "decisions": {"interval_s": 2.0}},
            "decisions.interval_s = 2", "never diverts",
        ),
    ],
)  # fmt: skip
def test_each_oddity_is_reported_once_with_key_and_value(tables, begins, told):
    (note,) = [n for n in notes(**tables) if n.startswith(begins)]
    assert told in note
    assert "\n" not in note


def test_the_sun_is_of_use_to_what_sees_it():
    camera_and_lidar = Scenario.load(SCENARIOS / "camera_and_lidar.toml").changed(
        sun={"elevation_deg": 7.0}
    )
    assert warnings_for(camera_and_lidar) == []
    stars = Scenario.load(SCENARIOS / "instruments.toml").changed(sun={"elevation_deg": 7.0})
    assert not [n for n in warnings_for(stars) if n.startswith("sun")]


def test_inertia_follows_the_masses_that_are_given():
    assert Lander().inertia_dry == (1100.0, 1100.0, 1300.0)
    assert Lander().inertia_full == (1400.0, 1400.0, 1600.0)
    half = Scenario.from_dict(
        {"vehicle": {"dry_mass_kg": 550.0, "propellant_mass_kg": 200.0, "thrust_min_n": 300.0}}
    ).vehicle.make()
    assert half.inertia_dry == (550.0, 550.0, 650.0)
    assert half.inertia_full == (700.0, 700.0, 800.0)
    own = Lander(inertia_dry=(900.0, 900.0, 900.0), propellant_mass=100.0)
    assert own.inertia_full == (975.0, 975.0, 975.0)
    assert JetLander(dry_mass=2200.0).inertia_dry == (2200.0, 2200.0, 2600.0)


def test_a_scenario_that_is_changed_twice_follows_the_last_mass():
    once = Scenario.from_dict({}).changed(vehicle={"dry_mass_kg": 800.0})
    again = once.changed(vehicle={"dry_mass_kg": 1200.0})
    assert again.vehicle.make().inertia_dry[0] == 1200.0
    assert warnings_for(again) == []


LIDAR = {name: {"kind": kind} for name, kind in FIXED.items()}


@pytest.mark.parametrize(
    ("tasking", "told"),
    [
        ({"kind": "at-altitudes", "altitudes_m": [700.0, 200.0]}, "above 200 m only"),
        ({"kind": "periodic", "last_altitude_m": 150.0}, "above 150 m only"),
        ({"kind": "at-altitudes", "altitudes_m": [700.0, 80.0]}, None),
        ({"kind": "periodic"}, None),
    ],
)
def test_a_lidar_whose_range_is_below_all_tasked_altitudes_is_odd(tasking, told):
    flash = LIDAR["flash"] | {"max_range_m": 100.0}
    found = notes(sensors=LIDAR | {"flash": flash}, tasking={"flash": tasking})
    if told is None:
        assert found == []
    else:
        (note,) = found
        assert note.startswith("sensors.flash.max_range_m: ") and told in note


def test_variation_is_odd_where_landers_fly_by_themselves():
    (note,) = notes(domain_randomization={"payload_kg": 10.0})
    assert "domain_randomization" in note and "lunarsim evaluate Guidance-v1" in note


def test_a_camera_that_no_mapper_uses_may_record():
    tables = {
        "terrain": {"size_m": 60.0},
        "sensors": LIDAR | {"eye": {"kind": "camera", "width": 64, "height": 48}},
        "tasking": {"flash": {"kind": "at-altitudes"}, "eye": {"kind": "periodic", "rate_hz": 0.5}},
    }
    (note,) = notes(**tables)
    assert note.startswith("sensors.eye: no mapper uses its images")
    flight = Simulation(Scenario.from_dict(tables), 1, "no-divert").run()
    assert {e["sensor"] for e in flight.events if e["name"] == "image"} == {"eye"}


@pytest.mark.parametrize(("scale", "warned"), [(0.35, True), (0.45, False)])
def test_a_true_lander_that_cannot_hover_is_odd(scale, warned):
    """The default lander weighs 0.38 of its maximum thrust."""
    found = notes(truth={"vehicle": {"thrust_scale": scale}})
    assert any(note.startswith("truth.vehicle: ") for note in found) == warned
