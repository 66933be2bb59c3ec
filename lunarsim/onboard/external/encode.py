"""Write the data of the onboard computer into messages for external software."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.interface.definitions import MESSAGES, VERSION, SensorKind
from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
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
from lunarsim.models.instruments import (
    AltimeterInstrument,
    CameraInstrument,
    InertialInstrument,
    LidarInstrument,
    NavigationFixInstrument,
    StarTrackerInstrument,
    VelocimeterInstrument,
)
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.contract import Observation

_SENSOR_KINDS: dict[type, SensorKind] = {
    InertialInstrument: SensorKind.INERTIAL_UNIT,
    AltimeterInstrument: SensorKind.ALTIMETER,
    VelocimeterInstrument: SensorKind.VELOCIMETER,
    StarTrackerInstrument: SensorKind.STAR_TRACKER,
    NavigationFixInstrument: SensorKind.NAVIGATION_FIX,
    LidarInstrument: SensorKind.LIDAR,
    CameraInstrument: SensorKind.CAMERA,
}
_TEXT_BYTES = {
    (message, f.name): f.shape[0]
    for message, definition in MESSAGES.items()
    for f in definition.fields
    if f.type == "text"
}


def checked_text(message: str, name: str, value: str, field: str) -> bytes:
    """Return a text as bytes for a field of a message.

    Raises
    ------
    InputError
        If the text is too long; `field` is its scenario key.
    """
    data, limit = value.encode(), _TEXT_BYTES[message, name] - 1
    if len(data) > limit or b"\0" in data:
        raise InputError(field, value[:40], f"must have at most {limit} bytes, and none of them 0")
    return data


def write_estimate(out: Struct, e: Estimate) -> None:
    """Write an estimate into a message `Estimate`."""
    out.set(
        time=e.time, position=e.position, velocity=e.velocity, attitude=e.attitude, rate=e.rate,
        mass=e.mass, covariance=e.covariance, lost=e.lost,
    )  # fmt: skip


def read_estimate(given: Struct) -> Estimate:
    """Return the estimate in a message `Estimate`."""
    covariance, flat = given.get("covariance").copy(), given.flat["covariance"]
    if not math.isfinite(flat.dot(flat)):
        covariance[:] = 0.0  # not written
    return Estimate(
        time=float(given.get("time")),
        position=given.get("position").copy(),
        velocity=given.get("velocity").copy(),
        attitude=given.get("attitude").copy(),
        rate=given.get("rate").copy(),
        mass=float(given.get("mass")),
        covariance=covariance,
        lost=bool(given.get("lost")),
    )


def write_end(out: Struct, end: PhaseEnd) -> None:
    """Write the end of a phase into a message `PhaseEnd`."""
    out.set(position=end.position, velocity=end.velocity, acceleration=end.acceleration)


def write_grid(out: Struct, grid: Any) -> None:
    """Write a `lunarsim.Grid` into a message `Grid`."""
    out.set(x0=grid.x0, y0=grid.y0, posting=grid.posting, rows=grid.rows, cols=grid.cols)


def new_briefing(briefing: Briefing, configuration: str) -> Struct:
    """Return the message `Briefing`; `configuration` is the text for the software.

    Raises
    ------
    InputError
        If the configuration, or the name of a sensor, is too long.
    """
    out, start, lander = Struct("Briefing"), briefing.start, briefing.lander
    out.set(
        interface_version=VERSION,
        configuration=checked_text("Briefing", "configuration", configuration, "configuration"),
        gravity=briefing.surface_gravity, target=briefing.target, heading=briefing.heading,
        start_position=start.position, start_velocity=start.velocity,
        start_attitude=start.attitude, start_position_sigma=start.position_sigma,
        start_velocity_sigma=start.velocity_sigma, start_attitude_sigma=start.attitude_sigma,
        time_to_go=briefing.time_to_go,
        lag=briefing.software.control.response_time + lander.thrust_lag,
        sun=briefing.sun, step=briefing.step, cycle=briefing.cycle,
    )  # fmt: skip
    vehicle = out.parts["vehicle"]
    vehicle.set(**{f.name: getattr(lander, f.name) for f in vehicle.message.fields})
    sensors = out.resize_list("sensor", len(briefing.instruments))
    for element, (name, instrument) in zip(sensors, briefing.instruments.items(), strict=True):
        _write_sensor(element, name, instrument, briefing)
    if briefing.prior_map is not None:
        (prior,) = out.resize_list("prior_map", 1)
        write_grid(prior.parts["grid"], briefing.prior_map.grid)
        prior.attach(elevation=np.asarray(briefing.prior_map.elevation, np.float64))
        prior.set(sigma=briefing.prior_map.sigma)
    return out


def _write_sensor(out: Struct, name: str, instrument: Any, briefing: Briefing) -> None:
    """Write a sensor into a message `Sensor`."""
    out.set(
        name=checked_text("Sensor", "name", name, f"sensors.{name}"),
        kind=_SENSOR_KINDS.get(type(instrument), SensorKind.OTHER),
        is_tasked=name in briefing.software.tasking,
    )
    if isinstance(instrument, AltimeterInstrument):
        out.set(boresight=instrument.boresight)
    if isinstance(instrument, VelocimeterInstrument):
        out.set(beam_count=len(instrument.directions))
        out.attach(beam=np.array(instrument.directions, np.float64))


class MeasurementWriter:
    """Writes measurements into messages.

    Parameters
    ----------
    sensors
        Names of the sensors, in the order of the briefing.
    """

    def __init__(self, sensors: tuple[str, ...]) -> None:
        self._index = {name: k for k, name in enumerate(sensors)}

    def write(self, out: Struct, measurements: Measurements) -> None:
        """Write all measurements of a cycle into a message `Measurements`."""
        out.set(time=measurements.time)
        by_list: dict[str, list[tuple[str, Any]]] = {}
        for sensor, measurement in measurements.items:
            name = _WRITERS.get(type(measurement))
            if name is not None:
                by_list.setdefault(name, []).append((sensor, measurement))
        for name in _WRITERS.values():
            found = by_list.get(name, ())
            if found or out.parts[name]:
                elements = out.resize_list(name, len(found))
                for element, (sensor, measurement) in zip(elements, found, strict=True):
                    self.write_one(element, sensor, measurement)

    def write_one(self, out: Struct, sensor: str, m: Any) -> None:
        """Write one measurement of a sensor into its message."""
        out.set(sensor=self._index[sensor], time=m.time)
        if isinstance(m, InertialSamples):
            out.set(sample_count=len(m.angle))
            out.attach(angle=m.angle, velocity=m.velocity)
        elif isinstance(m, AltimeterReading):
            out.set(range=m.range, sigma=m.sigma)
        elif isinstance(m, DopplerReading):
            out.set(beam_count=len(m.speed))
            out.attach(
                speed=m.speed, range=m.range, speed_sigma=m.speed_sigma, range_sigma=m.range_sigma
            )
        elif isinstance(m, AttitudeReading):
            out.set(attitude=m.attitude, covariance=m.covariance)
        elif isinstance(m, NavigationFix):
            out.set(
                position=m.position, velocity=m.velocity, attitude=m.attitude,
                covariance=m.covariance,
            )  # fmt: skip
        elif isinstance(m, LidarScan):
            out.set(rows=m.shape[0], cols=m.shape[1], mount=m.mount)
            out.attach(range=m.range, direction=m.direction, sigma=m.sigma)
        else:
            _write_image(out, m)


def _write_image(out: Struct, image: CameraImage) -> None:
    """Write an image into a message `CameraImage`."""
    camera, counts = image.camera, np.ascontiguousarray(image.counts)
    out.set(
        width=camera.width, height=camera.height, bytes_per_pixel=counts.itemsize,
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, distortion=camera.distortion,
        offset=camera.offset, mount=camera.mount, exposure=image.exposure,
    )  # fmt: skip
    out.attach(pixels=counts.reshape(-1).view(np.uint8))


# Lists of `Measurements` by type of the measurement.
_WRITERS: dict[type, str] = {
    InertialSamples: "inertial_samples",
    AltimeterReading: "altimeter_reading",
    DopplerReading: "doppler_reading",
    AttitudeReading: "attitude_reading",
    NavigationFix: "navigation_fix",
    LidarScan: "lidar_scan",
    CameraImage: "camera_image",
}


def write_map(out: Struct, hazards: HazardMap) -> None:
    """Write a hazard map into a message `HazardMap`."""
    write_grid(out.parts["grid"], hazards.grid)
    out.attach(
        p_safe=np.asarray(hazards.p_safe, np.float32), observed=hazards.observed.view(np.uint8)
    )
    elevation = hazards.elevation
    out.set(elevation_count=0 if elevation is None else elevation.size)
    out.attach(elevation=np.zeros(0, np.float32) if elevation is None else elevation)


def write_observation(out: Struct, seen: Observation) -> None:
    """Write the observation of a policy into a message `PolicyInput`."""
    write_estimate(out.parts["estimate"], seen.estimate)
    write_map(out.parts["map"], seen.hazard_map)
    sites, candidates = seen.candidates, out.parts["candidates"]
    candidates.set(site_count=len(sites))
    candidates.attach(
        position=sites.position, p_safe=sites.p_safe, distance=sites.distance,
        propellant=sites.propellant, value=sites.value,
    )  # fmt: skip
    out.set(
        time=seen.time, site=seen.site, site_p_safe=seen.site_p_safe,
        site_propellant=seen.site_propellant, time_to_go=seen.time_to_go,
        propellant=seen.propellant, site_eligible=seen.site_eligible, site_value=seen.site_value,
        expected_miss=seen.expected_miss,
    )  # fmt: skip
