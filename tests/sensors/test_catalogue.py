"""Named sensor units of the catalogue, through scenario keys."""

from __future__ import annotations

import math
import re

import pytest
from click.testing import CliRunner

import lunarsim
from lunarsim.cli import main
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.parts.settings import settings_of
from lunarsim.sensors.catalogue import sensor_units

SENSORS = {
    "imu": {"kind": "imu"},
    "altimeter": {"kind": "radar-altimeter"},
    "velocimeter": {"kind": "velocimeter"},
    "stars": {"kind": "star-tracker"},
}


def scenario(**changed):
    """Scenario with one sensor of each kind and some of their tables changed."""
    flash = {"flash": {"kind": "flash-lidar", "rows": 16, "cols": 16}}
    return lunarsim.Scenario.from_dict({"sensors": SENSORS | flash | changed})


@pytest.mark.parametrize("name", sensor_units())
def test_each_unit_flies_and_each_value_has_a_source(name):
    unit = sensor_units()[name]
    if unit.kind == "camera":
        extra = {"tasking": {"cam": {"kind": "periodic"}, "flash": {"kind": "at-altitudes"}}}
        made = lunarsim.Scenario.from_dict(
            {"sensors": SENSORS | {"flash": {"kind": "flash-lidar"}, "cam": {"unit": name}}} | extra
        )
        part = made.sensors["cam"]
    else:
        own = next(k for k, t in (SENSORS | {"flash": {"kind": "flash-lidar"}}).items()
                   if t["kind"] == unit.kind)  # fmt: skip
        part = scenario(**{own: {"unit": name}}).sensors[own]
    assert (part.kind, part.unit) == (unit.kind, name)
    assert re.search(r"https?://[^\s/]+\.[a-z]+/\S", unit.source)
    assert "\n" not in unit.source
    assert all(source for _, source in unit.values.values())
    if unit.kind == "imu":  # omitted keys would be those of the default unit
        keys = set(settings_of(TriadErrors).model_fields) - {"correlation_time_s"}
        wanted = {f"{triad}.{key}" for triad in ("gyroscopes", "accelerometers") for key in keys}
        assert set(unit.values) == wanted


def test_a_unit_fills_keys_in_si_units_that_the_scenario_overrides():
    imu = {"unit": "STIM300", "gyroscopes": {"scale_factor": "100 ppm"}}
    made = scenario(imu=imu).sensors["imu"].make()
    assert made.gyroscopes.bias_instability == pytest.approx(math.radians(0.5 / 3600.0))
    assert made.gyroscopes.random_walk == pytest.approx(math.radians(0.15 / 60.0))
    assert made.gyroscopes.scale_factor == pytest.approx(1e-4)
    assert made.accelerometers.bias == pytest.approx(0.75e-3 * 9.80665)
    assert made.accelerometers.random_walk == pytest.approx(0.06 / 60.0)


def test_another_unit_keeps_keys_that_it_does_not_have():
    first = scenario(stars={"unit": "RIGEL-L", "boresight": [1.0, 0.0, 0.0]})
    second = first.changed(sensors={"stars": {"unit": "ALTAIR-HB+"}})
    stars = second.sensors["stars"]
    assert (stars.roll_noise_deg, stars.boresight) == (0.0167, (1.0, 0.0, 0.0))
    again = lunarsim.Scenario.from_toml(second.to_toml())
    assert again.sensors["stars"] == stars
    assert second.changed(sensors={"stars": {"roll_noise_deg": 0.02}}).sensors["stars"].unit


_DEG, _HOUR, _G = math.pi / 180.0, 3600.0, 9.80665


@pytest.mark.parametrize(
    ("unit", "triad", "bias", "random_walk"),
    [
        ("HG1700", "gyroscopes", 1.0 * _DEG / _HOUR, 0.125 * _DEG / 60.0),
        ("HG1700", "accelerometers", 1e-3 * _G, 0.065 * 0.3048 / 60.0),
        ("HG9900", "gyroscopes", 0.0035 * _DEG / _HOUR, 0.002 * _DEG / 60.0),
        ("HG9900", "accelerometers", 25e-6 * _G, 10e-6 * _G),
    ],
)
def test_inertial_units_have_the_values_of_their_datasheets(unit, triad, bias, random_walk):
    errors = getattr(scenario(imu={"unit": unit}).sensors["imu"].make(), triad)
    assert errors.bias == pytest.approx(bias, rel=1e-12)
    assert errors.random_walk == pytest.approx(random_walk, rel=1e-3)  # 0.065 ft/s is rounded


def test_the_camera_has_the_noise_of_its_detector():
    """From the datasheet of the MT9P031: maximum SNR 38.1 dB, dynamic range 70.1 dB."""
    values = {key: value for key, (value, _) in sensor_units()["TAGCAMS-NavCam"].values.items()}
    full_well = values["full_well_electrons"]
    assert full_well == pytest.approx(10.0 ** (38.1 / 10.0), rel=0.01)  # SNR is its square root
    assert values["read_noise_electrons"] == pytest.approx(full_well / 10 ** (70.1 / 20), rel=0.02)


def test_angles_of_datasheets_are_converted():
    texts = {"misalignment": "5 arcsec", "quantum": "0.5 arcsec"}
    made = scenario(imu={"kind": "imu", "gyroscopes": texts}).sensors["imu"].make()
    assert made.gyroscopes.misalignment == pytest.approx(5.0 * _DEG / 3600.0)
    assert made.gyroscopes.quantum == pytest.approx(0.5 * _DEG / 3600.0)
    texts = {"misalignment": "0.2 mrad"}
    made = scenario(imu={"kind": "imu", "accelerometers": texts}).sensors["imu"].make()
    assert made.accelerometers.misalignment == pytest.approx(2e-4)


@pytest.mark.parametrize(
    "text",
    ["1_0 deg/h", "nan deg/h", "inf deg/h", "\u0661 deg/h", "1e deg/h", ". deg/h", "0x1 deg/h"],
)
def test_numbers_with_units_are_decimal(text):
    imu = {"kind": "imu", "gyroscopes": {"bias": text}}
    with pytest.raises(lunarsim.InputError, match=r"sensors\.imu\.gyroscopes\.bias: must be a num"):
        scenario(imu=imu)


@pytest.mark.parametrize("text", ["0.5 deg/h", "+.5 deg/h", "5E-1 deg/h", " 0.50  deg/h "])
def test_decimal_numbers_with_units_may_have_a_sign_and_an_exponent(text):
    made = scenario(imu={"kind": "imu", "gyroscopes": {"bias": text}}).sensors["imu"].make()
    assert made.gyroscopes.bias == pytest.approx(0.5 * _DEG / _HOUR)


def test_a_change_to_a_unit_of_another_kind_names_the_table():
    """It must not replace an altimeter by a velocimeter."""
    for change in ({"unit": "NDL"}, {"unit": "NDL", "kind": "radar-altimeter"}):
        with pytest.raises(lunarsim.InputError) as caught:
            scenario().changed(sensors={"altimeter": change})
        assert "sensors.altimeter.unit: must be a unit of kind 'radar-altimeter'" in str(
            caught.value
        )
    changed = scenario().changed(sensors={"altimeter": {"unit": "NDL", "kind": "velocimeter"}})
    assert changed.sensors["altimeter"].kind == "velocimeter"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"unit": "LN-200"}, "sensors.imu.unit: must be the name of a sensor unit, got 'LN-200'. "
         "Units: STIM300, HG1700"),
        ({"unit": "NDL", "kind": "imu"}, "sensors.imu.unit: must be a unit of kind 'imu', "
         "got 'NDL'. NDL is of kind 'velocimeter'."),
        ({"kind": "imu", "gyroscopes": {"bias": "1 mg"}}, "sensors.imu.gyroscopes.bias: must be "
         "a number in SI units, or a text with a number and its unit, got '1 mg'. "
         "Texts for this key: '0.5 deg/h' or '0.5 deg/s'."),
    ],
)  # fmt: skip
def test_mistakes_name_field_value_and_remedy(table, message):
    with pytest.raises(lunarsim.InputError) as caught:
        scenario(imu=table)
    assert message in str(caught.value)


def test_the_command_prints_values_and_sources():
    text = CliRunner().invoke(main, ["parts", "--units"]).output
    assert "STIM300 (imu)" in text
    assert "0.5 deg/h" in text
    assert "gyro bias instability" in text
