"""Sensors against their tasking, and hazard maps against lander and calibration."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from lunarsim.evaluation.vehicle_check.mission import Mission, SiteView
from lunarsim.evaluation.vehicle_check.rows import AT_LEAST, AT_MOST, Check, Found, one
from lunarsim.frames import attitude_from_thrust, quat_rotate
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.instruments import AltimeterInstrument, PointedInstrument
from lunarsim.onboard.calibration.evidence import SLOPE_LIMIT_RANGE_RAD
from lunarsim.onboard.calibration.gaussian_dem import NOISE_RATIO_RANGE, SPACING_RATIO_RANGE
from lunarsim.onboard.calibration.quadtree import MAX_NOISE_RATIO
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapperSettings
from lunarsim.onboard.hazards.mapper import sensor_names
from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapperSettings
from lunarsim.onboard.tasking.schedules import Sweep

# Mean number of photons at which half of the pixels have a return: 1 - exp(-n) = 0.5. The key
# `photons` of a LiDAR refers to 500 m.
_HALF_RETURNS, _REFERENCE_RANGE_M = float(np.log(2.0)), 500.0
# Pixels across the smallest rock that a shadow mapper must measure.
_MIN_PIXELS_PER_ROCK = 2.0
# Beams of a velocimeter that determine a velocity.
_MIN_BEAMS = 3


def _instruments(mission: Mission) -> list[tuple[str, Any, Any]]:
    """Return name, sensor and calibration of each sensor."""
    known = ((n, s, getattr(s, "calibration", None)) for n, s in mission.sensors.items())
    return [(name, sensor, read() if read else None) for name, sensor, read in known]


def _tasked(mission: Mission) -> Iterator[tuple[str, Any, Any, list[SiteView]]]:
    """Yield name, sensor, calibration and views of each LiDAR and camera."""
    for name, sensor, instrument in _instruments(mission):
        views = mission.views(name)
        if views and isinstance(instrument, PointedInstrument):
            yield name, sensor, instrument, views


def sample_spacing(view: SiteView, pixel: float) -> float:
    """Return the distance between neighbouring samples on flat terrain, m.

    A pixel of the angle p covers ``p d`` across the line of sight and ``p d / cos i`` along it at
    the range d and the incidence i; the result is their geometric mean.
    """
    return float(view.range * pixel / np.sqrt(max(np.cos(view.incidence), 1e-3)))


def _sights(mission: Mission) -> Iterator[tuple[str, Any, float, float, float]]:
    """Yield the lines of sight of ranging sensors.

    They are name, sensor, altitude (m), range (m) and incidence (rad). Those of a LiDAR are of its
    first measurement. Altimeter and velocimeter must measure from the first hazard measurement or
    decision on. The range of a beam is the altitude over the cosine of its angle from the vertical;
    of a velocimeter, the third best beam counts.
    """
    first = [mission.software.decisions.first_altitude]
    for name, sensor, _, views in _tasked(mission):
        first.append(views[0].altitude)
        yield name, sensor, views[0].altitude, views[0].range, views[0].incidence
    path, heading = mission.path, mission.scenario.start.make().heading
    k = path.index_at(max(first))
    attitude = attitude_from_thrust(path.direction[k], heading)
    for name, sensor, instrument in _instruments(mission):
        beams, needed = getattr(instrument, "directions", ()), _MIN_BEAMS
        if isinstance(instrument, AltimeterInstrument):
            beams, needed = (instrument.boresight,), 1
        if len(beams) >= needed:
            down = np.sort(-quat_rotate(attitude, np.array(beams))[:, 2])[-needed]
            distance = float(path.position[k, 2]) / max(float(down), 1e-3)
            angle = float(np.arccos(np.clip(down, -1.0, 1.0)))
            yield name, sensor, float(path.altitude[k]), distance, angle


def _range(mission: Mission) -> Iterator[Found]:
    """Yield the required range and the range of each sensor.

    The range of a LiDAR ends where half of its pixels have no return.
    """
    for name, sensor, altitude, distance, incidence in _sights(mission):
        reach, photons = getattr(sensor, "max_range", None), getattr(sensor, "photons", None)
        if reach is not None and photons is not None:
            seen = photons * np.cos(incidence) / _HALF_RETURNS
            reach = min(reach, _REFERENCE_RANGE_M * float(np.sqrt(seen)))
        if reach is not None:
            yield from one(distance, reach, sensor=name, altitude=altitude)


def _incidence(mission: Mission) -> Iterator[Found]:
    """Yield the incidence of the line of sight of each sensor, and its limit."""
    for name, sensor, altitude, _, incidence in _sights(mission):
        limit = getattr(sensor, "max_incidence", np.inf)
        if limit < 0.5 * np.pi:
            yield from one(incidence, limit, sensor=name, altitude=altitude)


def _pointing(mission: Mission) -> Iterator[Found]:
    """Yield the largest angle of the site from body -z, and the covered angle."""
    for name, _, instrument, views in _tasked(mission):
        covered = instrument.gimbal_limit + float(np.arctan(instrument.tan_half_fov))
        yield from one(max(v.pointing for v in views), covered, sensor=name)


def _camera_spacing(mission: Mission) -> Iterator[Found]:
    """Yield half the smallest rock, and the spacing of pixels at the last image."""
    parts = [p for p in mission.software.mappers.values() if hasattr(p, "min_hazard_diameter")]
    for name, _, instrument, views in _tasked(mission):
        rocks = [float(p.min_hazard_diameter) for p in parts if name in sensor_names(p)]
        if rocks:
            spacing = sample_spacing(views[-1], instrument.pixel)
            limit = min(rocks) / _MIN_PIXELS_PER_ROCK
            yield from one(limit, spacing, sensor=name, altitude=views[-1].altitude)


def _first_map(mission: Mission) -> list[Found]:
    """Return the altitudes of the last decision and of the first measurement."""
    if mission.edge == 0.0 or np.isinf(mission.first_map_altitude):
        return []
    last = mission.software.decisions.last_altitude
    return one(last, mission.first_map_altitude, map=mission.decision_map[0])


def _coverage(mission: Mission) -> list[Found]:
    """Return half of the map's half side, and the half width of the observed area.

    The half width of a footprint is range times the tangent of half the field of view, plus half
    the side of a sweep. The largest one counts. The complete map gives a sufficient margin.
    """
    widths = []
    for name, sensor, instrument, views in _tasked(mission):
        task = mission.software.tasking.get(name)
        swept = 0.5 * task.size if isinstance(task, Sweep) else 0.0
        seen = [v.range for v in views if v.range <= getattr(sensor, "max_range", np.inf)]
        if name in mission.map_sensors and seen:
            widths.append(swept + instrument.tan_half_fov * max(seen))
    if mission.edge == 0.0 or not widths:
        return []
    half = mission.edge + mission.footprint_radius
    return one(0.5 * half, max(widths), map=mission.decision_map[0])


def _posting(mission: Mission) -> Iterator[Found]:
    """Yield the posting of each map, and the smallest rock or pad to resolve."""
    for name, mapper in mission.software.mappers.items():
        rock = getattr(mapper, "min_hazard_diameter", None)
        if hasattr(mapper, "posting") and (rock or issubclass(mapper.accepts, LidarScan)):
            words = {"map": name, "object": "smallest rock" if rock else "pad diameter"}
            yield from one(mapper.posting, rock or mission.lander.pad_diameter, **words)


def _calibrated(mission: Mission) -> Iterator[tuple[str, Any]]:
    """Yield name and settings of each mapper with a calibrated p_safe."""
    for name, mapper in mission.software.mappers.items():
        is_dem = isinstance(mapper, GaussianDemMapperSettings) and mapper.safety == "calibrated"
        if is_dem or isinstance(mapper, QuadtreeMapperSettings):
            yield name, mapper


def _slope_domain(mission: Mission) -> Iterator[Found]:
    """Yield 0, and the distance of the slope limit from the calibrated domain."""
    low, high = SLOPE_LIMIT_RANGE_RAD
    outside = abs(mission.lander.slope_limit - np.clip(mission.lander.slope_limit, low, high))
    for name, _ in _calibrated(mission):
        yield from one(0.0, outside, map=name, low=np.rad2deg(low), high=np.rad2deg(high))


def _stated_sigma(sensor: Any, distance: float) -> float:
    """Return the stated standard deviation of a range, m; 0 if none is stated."""
    stated = getattr(sensor, "stated_sigma", None)
    return float(stated(distance)) if stated else 0.0


def _scan_domain(mission: Mission) -> Iterator[Found]:
    """Yield limit and value of the ratios for which p_safe of each map is calibrated.

    They are the range noise (1 sigma) over the roughness limit, and the spacing of samples over the
    leg radius, at the lowest scan.
    """
    scans = {name: found for name, *found in _tasked(mission)}
    for name, mapper in _calibrated(mission):
        most = {"noise": MAX_NOISE_RATIO}
        if isinstance(mapper, GaussianDemMapperSettings):
            refit = mapper.calibration()
            ranges = (NOISE_RATIO_RANGE, SPACING_RATIO_RANGE)
            noise, spacing = ranges if refit is None else (refit.domain.noise, refit.domain.spacing)
            most = {"noise": noise[1], "spacing": spacing[1]}
        for source in set(sensor_names(mapper)) & set(scans):
            sensor, instrument, views = scans[source]
            found = {
                "noise": _stated_sigma(sensor, views[-1].range) / mission.lander.roughness_limit,
                "spacing": sample_spacing(views[-1], instrument.pixel) / mission.lander.leg_radius,
            }  # fmt: skip
            for ratio, limit in most.items():
                yield from one(limit, found[ratio], map=name, ratio=ratio)


SENSOR_CHECKS = (
    Check("first-map-altitude", "sensors", "m", AT_LEAST, 0.0, _first_map,
        "altitude of the first measurement for map '{map}' against the last decision",
        "the map comes too late for diverts: measure higher, or lower decisions.last_altitude_m"),
    Check("range-{sensor}", "sensors", "m", AT_LEAST, 0.1, _range,
        "range of '{sensor}' at {altitude:.0f} m altitude",
        "there are no returns: raise sensors.{sensor}.max_range_m or photons, or measure lower"),
    Check("incidence-{sensor}", "sensors", "deg", AT_LEAST, 0.1, _incidence,
        "maximum incidence of '{sensor}' at {altitude:.0f} m altitude",
        "there are no returns: raise sensors.{sensor}.max_incidence_deg, or lower "
        "approach.max_tilt_deg"),
    Check("pointing-{sensor}", "sensors", "deg", AT_LEAST, 0.0, _pointing,
        "gimbal limit of '{sensor}' plus half its field of view against the site's direction",
        "the site is outside the image: raise sensors.{sensor}.gimbal_limit_deg"),
    Check("spacing-{sensor}", "sensors", "m", AT_MOST, 0.1, _camera_spacing,
        "spacing of pixels of '{sensor}' at {altitude:.0f} m altitude against half the smallest "
        "hazardous rock",
        "rocks lie between the pixels: give the camera more pixels, or measure lower"),
    Check("footprint-map", "sensors", "m", AT_LEAST, 1.0, _coverage,
        "half width of the observed area against the map '{map}'",
        "most of the map stays unobserved: widen the sensor's field of view, measure higher, or "
        "lower size_m of the map"),
    Check("{ratio}-domain-{map}", "sensors", "", AT_MOST, 0.0, _scan_domain,
        "relative {ratio} of scans against the domain of map '{map}'",
        "p_safe of '{map}' is outside its calibrated domain: lower the sensor's range noise, give "
        "it more pixels, or measure lower"),
    Check("slope-domain-{map}", "maps", "deg", AT_MOST, 0.0, _slope_domain,
        "distance of the slope limit from the domain of map '{map}' ({low:g} to {high:g} deg)",
        "p_safe of '{map}' is outside its calibrated domain: change vehicle.slope_limit_deg"),
    Check("posting-{map}", "maps", "m", AT_LEAST, 0.0, _posting,
        "{object} against the posting of map '{map}'",
        "the map cannot show it: lower mappers.{map}.posting_m, or raise vehicle.pad_diameter_m"),
)  # fmt: skip
