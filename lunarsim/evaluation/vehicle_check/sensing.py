"""Sensors against their tasking: range, pointing, footprint, sample spacing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.evaluation.vehicle_check.mission import (
    Mission,
    angle_between,
    decision_mapper,
    source_mappers,
)
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.frames import attitude_from_thrust, quat_rotate
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.instruments import (
    AltimeterInstrument,
    CameraInstrument,
    LidarInstrument,
    VelocimeterInstrument,
)
from lunarsim.onboard.hazards.mapper import sensor_names
from lunarsim.onboard.tasking.schedules import AtAltitudes, Sweep

# Mean number of photons at which half of the pixels have a return: 1 - exp(-n) = 0.5.
_HALF_RETURNS = float(np.log(2.0))
_REFERENCE_RANGE_M = 500.0  # range to which the key `photons` of a LiDAR refers
# Samples per radius of the legs that slope and roughness need at least.
_MIN_SAMPLES_PER_RADIUS = 2.0
# Pixels across the smallest rock that a shadow mapper must measure.
_MIN_PIXELS_PER_ROCK = 2.0
# Beams of a velocimeter that determine a velocity.
_MIN_BEAMS = 3


@dataclass(frozen=True)
class SiteView:
    """Geometry of a measurement of the site on the nominal approach.

    Attributes
    ----------
    altitude
        Altitude of the footpads above the site, m.
    range
        Distance along the boresight to flat terrain at the height of the site, m.
    incidence
        Angle of the boresight from the vertical, rad.
    pointing
        Angle of the boresight from body -z, rad.
    """

    altitude: float
    range: float
    incidence: float
    pointing: float


def view_at(mission: Mission, altitude: float, *, nadir: bool = False) -> SiteView:
    """Return the geometry of a measurement at an altitude (m) of the nominal approach.

    The sensor points to the site, or straight down with `nadir`.
    """
    path = mission.approach.path
    k = path.index_at(altitude)
    down = -path.direction[k]
    ray = np.array([0.0, 0.0, -float(path.position[k, 2])]) if nadir else -path.position[k]
    distance = float(np.linalg.norm(ray))
    incidence = angle_between(ray, np.array([0.0, 0.0, -1.0]))
    return SiteView(float(path.altitude[k]), distance, incidence, angle_between(ray, down))


def views_of(mission: Mission, sensor: str) -> list[SiteView]:
    """Return the geometry of a sensor's measurements, from the highest to the lowest.

    It is empty if the schedule does not state its altitudes.
    """
    part = mission.software.tasking.get(sensor)
    nadir = isinstance(part, AtAltitudes) and part.boresight == "nadir"
    return [view_at(mission, h, nadir=nadir) for h in mission.measurement_altitudes(sensor)]


def sample_spacing(view: SiteView, pixel: float) -> float:
    """Return the distance between neighbouring samples on flat terrain, m.

    A pixel of the angle p covers ``p d`` across the line of sight and ``p d / cos i`` along it at
    the range d and the incidence i; the result is their geometric mean.
    """
    return float(view.range * pixel / np.sqrt(max(np.cos(view.incidence), 1e-3)))


def sensor_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of all sensors."""
    for name, sensor in mission.sensors.items():
        instrument = sensor.calibration() if hasattr(sensor, "calibration") else None
        if isinstance(instrument, LidarInstrument | CameraInstrument):
            views = views_of(mission, name)
            if views:
                yield from _tasked_rows(mission, name, sensor, instrument, views)
        elif isinstance(instrument, AltimeterInstrument):
            yield from _beam_rows(mission, name, sensor, np.array([instrument.boresight]), 1)
        elif isinstance(instrument, VelocimeterInstrument):
            beams = np.array(instrument.directions)
            yield from _beam_rows(mission, name, sensor, beams, _MIN_BEAMS)
    yield from _coverage_rows(mission)


def _tasked_rows(
    mission: Mission, name: str, sensor: Any, instrument: Any, views: list[SiteView]
) -> Iterator[CheckRow]:
    """Yield the checks of range, pointing and spacing of a LiDAR or a camera.

    The range is that of the highest measurement; the spacing is that of the lowest one.
    """
    highest, lowest, keys = views[0], views[-1], f"tasking.{name}"
    reach = getattr(sensor, "max_range", None)
    if reach is not None:
        yield CheckRow(
            f"range-{name}", "sensors",
            f"range of '{name}' at its first measurement ({highest.altitude:.0f} m altitude)",
            highest.range, float(reach), "m",
            "Otherwise this measurement has no returns and its terrain stays unknown: raise "
            f"sensors.{name}.max_range_m, or lower the altitudes of {keys}.", wanted_margin=0.1,
        )  # fmt: skip
    if getattr(sensor, "photons", None) is not None:
        mean = sensor.photons * np.cos(highest.incidence)
        yield CheckRow(
            f"photons-{name}", "sensors",
            f"photons per return of '{name}' at its first measurement",
            _HALF_RETURNS, float(mean * (_REFERENCE_RANGE_M / highest.range) ** 2), "",
            f"Otherwise most pixels have no return: raise sensors.{name}.photons, or lower the "
            f"altitudes of {keys}.", wanted_margin=1.0,
        )  # fmt: skip
    half_view = float(np.arctan(instrument.tan_half_fov))
    pointing = max(v.pointing for v in views)
    yield CheckRow(
        f"pointing-{name}", "sensors",
        f"gimbal limit of '{name}' plus half its field of view against the site's direction",
        float(np.rad2deg(pointing)), float(np.rad2deg(instrument.gimbal_limit + half_view)), "deg",
        f"Otherwise the site is outside the image: raise sensors.{name}.gimbal_limit_deg or its "
        f"field of view, or change the altitudes of {keys}.",
    )  # fmt: skip
    if isinstance(instrument, LidarInstrument) and instrument.max_incidence < 0.5 * np.pi:
        yield CheckRow(
            f"incidence-{name}", "sensors", f"maximum incidence of '{name}' at its measurements",
            float(np.rad2deg(min(v.incidence for v in views))),
            float(np.rad2deg(instrument.max_incidence)), "deg",
            f"Otherwise there are no returns: raise sensors.{name}.max_incidence_deg, or steepen "
            "the approach.", wanted_margin=0.1,
        )  # fmt: skip
    yield _spacing_row(mission, name, instrument, lowest)


def _spacing_row(mission: Mission, name: str, instrument: Any, lowest: SiteView) -> CheckRow:
    """Return the row of the spacing of a sensor's samples at its lowest measurement."""
    spacing = sample_spacing(lowest, instrument.pixel)
    rocks = [
        float(part.min_hazard_diameter) for part in mission.software.mappers.values()
        if name in sensor_names(part) and hasattr(part, "min_hazard_diameter")
    ]  # fmt: skip
    if rocks and isinstance(instrument, CameraInstrument):
        limit, what = min(rocks) / _MIN_PIXELS_PER_ROCK, "half the smallest hazardous rock"
    else:
        limit = mission.lander.leg_radius / _MIN_SAMPLES_PER_RADIUS
        what = "half the radius of the legs"
    return CheckRow(
        f"spacing-{name}", "sensors",
        f"spacing of samples of '{name}' at {lowest.altitude:.0f} m altitude against {what}",
        limit, spacing, "m",
        "Otherwise hazards lie between the samples: give the sensor more pixels or a narrower "
        f"field of view, or lower the altitudes of tasking.{name}.", "at most", 0.1,
    )  # fmt: skip


def _beam_rows(
    mission: Mission, name: str, sensor: Any, beams: Any, needed: int
) -> Iterator[CheckRow]:
    """Yield the checks of range and incidence of fixed beams.

    Navigation must have the sensor from the first hazard measurement or decision on; the margin is
    sufficient if it has it from the start. The range of a beam over flat terrain is the altitude
    over the cosine of its angle from the vertical. `beams` (n, 3) are unit vectors, body axes, of
    which `needed` must have returns.
    """
    reach = getattr(sensor, "max_range", None)
    if reach is None:
        return
    heading = mission.scenario.start.make().heading
    first = [max(h) for n in mission.software.tasking if (h := mission.measurement_altitudes(n))]
    at = max([mission.software.decisions.first_altitude, *first])
    path, ranges, angles = mission.approach.path, [], []
    for k in (path.index_at(at), 0):
        attitude = attitude_from_thrust(path.direction[k], heading)
        cosine = np.sort(-quat_rotate(attitude, beams)[:, 2])[::-1][needed - 1]
        ranges.append(float(path.position[k, 2]) / max(float(cosine), 1e-3))
        angles.append(float(np.arccos(np.clip(cosine, -1.0, 1.0))))
    yield CheckRow(
        f"range-{name}", "sensors",
        f"range of '{name}' at {min(at, float(path.altitude[0])):.0f} m altitude",
        ranges[0], float(reach), "m",
        "Otherwise hazard maps and diverts begin without this aid of navigation: raise "
        f"sensors.{name}.max_range_m.", wanted_margin=max(ranges[1] / ranges[0] - 1.0, 0.0),
    )  # fmt: skip
    limit = getattr(sensor, "max_incidence", None)
    if limit is not None:
        yield CheckRow(
            f"incidence-{name}", "sensors", f"maximum incidence of '{name}' at the same altitude",
            float(np.rad2deg(angles[0])), float(np.rad2deg(limit)), "deg",
            "Otherwise its beams have no returns while the lander is tilted: raise "
            f"sensors.{name}.max_incidence_deg, or lower approach.max_tilt_deg.",
            wanted_margin=max(angles[1] / max(angles[0], 1e-6) - 1.0, 0.0),
        )  # fmt: skip


def _coverage_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the row of the observed area against the decision map.

    The half width of a footprint is range times the tangent of half the field of view, plus half
    the side of a sweep. The largest one before the last decision counts. Half of the map's half
    side is required; the complete map gives a sufficient margin.
    """
    name = decision_mapper(mission.software)
    if name is None or not mission.allows_diverts:
        return
    parts = [mission.software.mappers[n] for n in source_mappers(mission.software, name)]
    widths = []
    for sensor in {n for part in parts for n in sensor_names(part)}:
        instrument = mission.sensors[sensor].calibration()
        tangent = getattr(instrument, "tan_half_fov", None)
        task = mission.software.tasking.get(sensor)
        swept = 0.5 * task.size if isinstance(task, Sweep) else 0.0
        reach = getattr(mission.sensors[sensor], "max_range", np.inf)
        seen = [v for v in views_of(mission, sensor) if v.range <= reach]
        if tangent is not None and seen:
            widths.append(swept + tangent * max(v.range for v in seen))
    if not widths:
        return
    half = mission.edge + mission.lander.leg_radius + 0.5 * mission.lander.pad_diameter
    yield CheckRow(
        "footprint-map", "sensors", f"half width of the observed area against the map '{name}'",
        0.5 * half, max(widths), "m",
        "Otherwise most of the map stays unobserved and there are few sites to divert to: widen "
        "the sensor's field of view, measure from higher altitudes, or reduce size_m of the map.",
        wanted_margin=1.0,
    )  # fmt: skip


def lidar_samples(mission: Mission, mapper: Any) -> tuple[float, float] | None:
    """Return noise and spacing of a mapper's LiDAR samples at the lowest scan, m.

    None if the mapper uses no LiDAR, or the schedule does not state its altitudes. The noise is 1
    sigma of a range.
    """
    for name in sensor_names(mapper):
        sensor = mission.sensors[name]
        if issubclass(sensor.measurement_type, LidarScan):
            instrument, views = sensor.calibration(), views_of(mission, name)
            noise = getattr(sensor, "noise_ratio", None)
            if views and noise is not None and isinstance(instrument, LidarInstrument):
                spacing = sample_spacing(views[-1], instrument.pixel)
                return float(noise) * views[-1].range, spacing
    return None
