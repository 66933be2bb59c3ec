"""Predict what a sensor detects on the terrain from a direction and a range.

Two tables give the sharpness of an observation and the fraction of terrain that it can evaluate.
Their axes are the cosine of the azimuth from the Sun and the sine of the depression of the line of
sight. A third table gives the fraction of uncertainty that an observation of a given sharpness
removes. A camera detects rocks by their shadows; q, the square root of the number of dark pixels
of a rock, and its miss rate come from the model of the shadow mapper. Terrain in the shadow of
another rock cannot be evaluated. A LiDAR misses a rock if no return falls on it; terrain behind
another rock cannot be evaluated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.messages.briefing import Briefing
from lunarsim.models.instruments import CameraInstrument, LidarInstrument, PointedInstrument
from lunarsim.onboard.active_perception.information import ExpectedRocks, removed_uncertainty
from lunarsim.onboard.hazards.mapper import sensor_names
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.shadow_model import MAX_SUN_ELEVATION, MIN_SUN_ELEVATION
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.population import RockExpectation
from lunarsim.typing import Array

# Nodes of the direction tables (azimuth, depression) and of the sharpness table, and the number of
# pixels or returns across the smallest rock at which the sharpness table ends.
_DIRECTION_NODES, _SHARPNESS_NODES, _MAX_SHARPNESS_PER_RADIUS = 33, 129, 12.0
# Minimum diameter of rocks that hide terrain, as a fraction of the smallest hazard. Smaller rocks
# are not mistaken for a hazard.
_MIN_HIDING_DIAMETER_RATIO = 0.6
# Errors of a camera that has observed the terrain from one side only, 1 sigma: direction (rad), and
# height as a fraction of the height above terrain. They match the covariances of the shadow
# tracker.
_POINTING_SIGMA_RAD, _HEIGHT_SIGMA_RATIO = 1e-3, 0.007


@dataclass(frozen=True)
class SensorCoverageModel:
    """Tables of what a sensor detects on the terrain, by direction and range.

    Sharpness is the size of a rock in the image of the sensor: for a camera, the square root of the
    number of dark pixels; for a LiDAR, that of the number of returns.

    Attributes
    ----------
    name
        Name of the sensor.
    sharpness
        Sharpness for a rock of 1 m radius and a pixel of 1 m (33, 33), over the cosine of the
        azimuth from the Sun (-1 to 1) and the sine of the depression (0 to 1).
    visible_fraction
        Fraction of the terrain that the observation can evaluate because nothing hides it (33, 33).
    displacement
        Loss of information by displaced detections (33, 33): half the variance of a position at a
        range of 1 m divided by the squared radius of the smallest hazard, 1/m^2. It reduces the
        information exponentially.
    reduction
        Fraction of hazard uncertainty that an observation removes (129,), over sharpness per metre
        of radius from 0 to `max_sharpness`.
    max_sharpness
        Sharpness at the end of `reduction`.
    pixel
        Angle of a pixel, rad.
    half_field
        Tangent of half the narrower side of the field of view.
    gimbal_limit
        Maximum angle of the boresight from the downward vehicle axis, rad.
    max_range
        Maximum range, m.
    sun
        Horizontal direction towards the Sun (2,), unit vector.
    """

    name: str
    sharpness: Array
    visible_fraction: Array
    displacement: Array
    reduction: Array
    max_sharpness: float
    pixel: float
    half_field: float
    gimbal_limit: float
    max_range: float
    sun: Array


def table_directions() -> tuple[Array, Array]:
    """Return the viewing directions at the nodes of the direction tables, rad.

    They are the azimuth of the sensor from the Sun and the depression of the line of sight, both
    (33, 33), azimuth by rows.
    """
    cosine, sine = np.linspace(-1.0, 1.0, _DIRECTION_NODES), np.linspace(0.0, 1.0, _DIRECTION_NODES)
    azimuth, depression = np.meshgrid(np.arccos(cosine), np.arcsin(sine), indexing="ij")
    return azimuth, depression


def build_coverage_models(briefing: Briefing, min_diameter: float) -> list[SensorCoverageModel]:
    """Build coverage models of the sensors that detect hazards.

    These are the tasked sensors whose measurements a mapper uses. A camera is included only if the
    Sun casts usable shadows.

    Parameters
    ----------
    briefing
        Data known before the flight.
    min_diameter
        Minimum diameter of a rock that is a hazard, m.
    """
    parts = [part for part in briefing.software.mappers.values() if hasattr(part, "sensor")]
    mapped_sensors = {sensor for part in parts for sensor in sensor_names(part)}
    models = []
    for name, instrument in briefing.instruments.items():
        if name not in mapped_sensors or name not in briefing.software.tasking:
            continue
        if isinstance(instrument, CameraInstrument):
            elevation = float(np.arcsin(np.clip(briefing.sun[2], -1.0, 1.0)))
            if MIN_SUN_ELEVATION <= elevation <= MAX_SUN_ELEVATION:
                models.append(build_camera_model(name, instrument, briefing, min_diameter))
        elif isinstance(instrument, LidarInstrument):
            models.append(build_lidar_model(name, instrument, briefing, min_diameter))
    return models


def build_camera_model(
    name: str, camera: CameraInstrument, briefing: Briefing, min_diameter: float
) -> SensorCoverageModel:
    """Build the coverage model of a camera, which detects rocks by their shadows.

    Sharpness q is the square root of the foreshortened area that a rock of radius 1 darkens,
    divided by the pixel size (Eqs. 13 to 15 of the shadow EKF paper). Terrain is visible where no
    shadow of another rock falls. `name` is that of the sensor and `min_diameter` the minimum
    diameter of a hazard, m.
    """
    model = ShapeMixture(float(np.arcsin(briefing.sun[2])), briefing.rocks.shape)
    azimuth, depression = table_directions()
    sharpness = model.visible_q(1.0, azimuth, depression, 1.0)
    hiding_rocks = ExpectedRocks.golombek(
        briefing.rocks.cover, _MIN_HIDING_DIAMETER_RATIO * min_diameter
    )
    area = model.patch(azimuth, depression).area
    dark_cover = float(hiding_rocks.number @ hiding_rocks.radius**2) * area
    rates = DetectionRates()
    displacement = 0.5 * position_variance(depression) / (0.5 * min_diameter) ** 2
    return _build_model(
        name,
        camera,
        briefing,
        min_diameter,
        (sharpness, np.exp(-dark_cover), displacement),
        rates.false_clear,
        np.inf,
    )


def position_variance(depression: Array) -> Array:
    """Return the variance of positions from a camera at a range of 1 m (...), m^2.

    The variance is the mean over both horizontal axes and depends on the `depression` of the line
    of sight (...), rad. A pointing error moves a position along the line of sight by its angle
    divided by the sine of the depression; a height error adds to it.
    """
    sine = np.maximum(np.sin(depression), 1e-3)
    height = _HEIGHT_SIGMA_RATIO * np.cos(depression)
    return np.asarray(0.5 * (_POINTING_SIGMA_RAD**2 * (1.0 + 1.0 / sine**2) + height**2))


def build_lidar_model(
    name: str, lidar: LidarInstrument, briefing: Briefing, min_diameter: float
) -> SensorCoverageModel:
    """Build the coverage model of a LiDAR, which misses rocks between its returns.

    Returns are spaced by one pixel across the line of sight, and by one pixel over the sine of the
    depression along it. Terrain is visible where no rock stands in front of it. Beyond the maximum
    incidence angle there are no returns. `name` is that of the sensor and `min_diameter` the
    minimum diameter of a hazard, m.
    """
    _, depression = table_directions()
    sine = np.sin(depression)
    sharpness = np.sqrt(sine) * (sine >= np.cos(lidar.max_incidence) - 1e-12)
    hiding_rocks = ExpectedRocks.golombek(
        briefing.rocks.cover, _MIN_HIDING_DIAMETER_RATIO * min_diameter
    )
    frontal_area = (
        2.0 * mean_rock_height(briefing.rocks) * float(hiding_rocks.number @ hiding_rocks.radius**2)
    )
    with np.errstate(divide="ignore"):
        hidden_cover = frontal_area * np.sqrt(1.0 - sine**2) / sine
    return _build_model(
        name,
        lidar,
        briefing,
        min_diameter,
        (sharpness, np.exp(-hidden_cover), np.zeros_like(sharpness)),
        no_return_probability,
        lidar.max_range,
    )


def no_return_probability(returns_per_radius: Any) -> Array:
    """Return the probability that no LiDAR return falls on a disc (...).

    `returns_per_radius` (...) is the radius of the disc divided by the mean spacing of returns: the
    square root of the number of returns on a square with this side.
    """
    return np.asarray(np.exp(-np.pi * np.asarray(returns_per_radius, dtype=np.float64) ** 2))


def mean_rock_height(rocks: RockExpectation) -> float:
    """Return the mean height of the expected rocks above the terrain, in radii."""
    sampled = rocks.model().draw(np.full(64, 2.0), np.random.default_rng(1972))
    return float(np.mean(sampled.base + sampled.height))


def _build_model(
    name: str, instrument: PointedInstrument, briefing: Briefing, min_diameter: float,
    tables: tuple[Array, Array, Array], miss_rate: Callable[[Array], Array], max_range: float,
) -> SensorCoverageModel:  # fmt: skip
    """Build the coverage model of a sensor from its direction tables and miss rate.

    `tables` are sharpness, visible fraction and displacement (33, 33). `miss_rate` returns the rate
    at which rocks are missed, from radius times sharpness. `max_range` is in m, `min_diameter` is
    the minimum diameter of a hazard, m.
    """
    rocks = ExpectedRocks.golombek(briefing.rocks.cover, min_diameter)
    max_sharpness = _MAX_SHARPNESS_PER_RADIUS / float(rocks.radius[0])
    sharpness = np.linspace(0.0, max_sharpness, _SHARPNESS_NODES)
    reduction = removed_uncertainty(rocks, footprint_radius(briefing), miss_rate, sharpness)
    sun_horizontal = np.asarray(briefing.sun[:2], dtype=np.float64)
    size = float(np.hypot(*sun_horizontal))
    sun = sun_horizontal / size if size > 0.0 else np.array([1.0, 0.0])
    assert isinstance(instrument, CameraInstrument | LidarInstrument)
    return SensorCoverageModel(
        name,
        *tables,
        reduction,
        max_sharpness,
        instrument.pixel,
        instrument.tan_half_fov,
        instrument.gimbal_limit,
        max_range,
        sun,
    )


def footprint_radius(briefing: Briefing) -> float:
    """Return the radius of the disc under the lander that must be free of rocks, m."""
    lander = briefing.lander
    return float(lander.leg_radius + 0.5 * lander.pad_diameter)
