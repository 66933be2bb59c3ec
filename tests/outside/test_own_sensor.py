"""A sensor from outside, and a navigation that takes what it gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_conjugate, quat_rotate
from lunarsim.parts import allow_modules
from lunarsim.simulation import Flight, Simulation

OWN = "own_sensor:LaserAltimeter"


def lander(small, **more):
    data = small.to_dict()
    sensors = {name: part for name, part in data["sensors"].items() if name != "fix"}
    # The ground is level and its height known: what the altimeter says is the lander's height.
    level = {"kind": "rocks", "terrain_slope_deg": 0.1}
    return small.from_dict(data | {"navigation": level, "sensors": sensors | more})


def height_error(simulation):
    """Fly until the lander is over the terrain; return by how much its height is wrong, m."""
    while simulation.altitude > 60.0:
        simulation.step()
    return abs(simulation.site_error[2])


def test_the_filter_takes_its_readings(small):
    without = height_error(Simulation(lander(small), 5, "no-divert"))
    with_laser = height_error(Simulation(lander(small, laser={"kind": OWN}), 5, "no-divert"))
    assert without > 1.0
    assert with_laser < 0.3 * without


def test_a_sensor_that_nobody_takes_is_named(small):
    sensors = small.to_dict()["sensors"] | {"laser": {"kind": OWN}}
    with pytest.raises(
        InputError, match=r"sensors\.laser.*sensors of kind .own_sensor:LaserAltimeter"
    ):
        small.changed(sensors=sensors)


@dataclass(frozen=True)
class SunReading:
    """Direction of the Sun in body axes (3,), with a time (s); no sigma if unknown."""

    time: float
    direction: np.ndarray
    sigma: float | None = None


@dataclass(frozen=True)
class SunSensor:
    """Sun sensor of another package that measures twice a second and is only recorded."""

    measurement_type = SunReading
    is_tasked = False
    is_recorded = True
    needs_sunlight = True

    def calibration(self):
        """Return nothing: the onboard computer does not use it."""

    def measure(self, world, state, time, rng, mount=None):
        """Return a reading every half second."""
        if round(10.0 * time) % 5:
            return None
        return SunReading(time, quat_rotate(quat_conjugate(state.attitude), world.light.direction))


def test_readings_of_a_sensor_without_a_user_are_recorded(small, tmp_path):
    allow_modules(__name__)
    sensors = small.to_dict()["sensors"] | {"sun": {"kind": f"{__name__}:SunSensor"}}
    simulation = Simulation(small.changed(sensors=sensors), 5, "no-divert")
    flight = simulation.run()
    readings = Flight.load(flight.save(tmp_path / "flight")).readings["sun"]
    assert list(readings) == ["time", "direction_0", "direction_1", "direction_2"]
    assert readings["time"] == pytest.approx(np.arange(0.0, flight.duration, 0.5), abs=1e-6)
    length = np.linalg.norm([readings[f"direction_{k}"] for k in range(3)], axis=0)
    assert length == pytest.approx(1.0)
    # Another flight in the same folder leaves no readings of this one.
    plain = Simulation(small, 5, "no-divert").run()
    assert Flight.load(plain.save(tmp_path / "flight")).readings == {}
    assert not list((tmp_path / "flight").glob("readings.*"))


@dataclass(frozen=True)
class TextSensor(SunSensor):
    """A recorded sensor whose readings hold a text."""

    def measure(self, world, state, time, rng, mount=None):
        """Return a text in place of the direction."""
        return SunReading(time, "up")


@dataclass(frozen=True)
class GrowingSensor(SunSensor):
    """A recorded sensor whose readings become longer."""

    def measure(self, world, state, time, rng, mount=None):
        """Return one more number in each cycle."""
        return SunReading(time, np.zeros(2 + round(10.0 * time)))


@pytest.mark.parametrize(
    ("kind", "words"), [("TextSensor", "numbers and vectors"), ("GrowingSensor", "same numbers")]
)
def test_readings_that_are_no_table_are_refused_when_they_are_measured(small, kind, words):
    allow_modules(__name__)
    sensors = small.to_dict()["sensors"] | {"sun": {"kind": f"{__name__}:{kind}"}}
    with pytest.raises(InputError, match=rf"sensors\.sun.*{words}"):
        Simulation(small.changed(sensors=sensors), 5, "no-divert").run()
