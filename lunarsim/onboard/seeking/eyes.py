"""What a sensor is expected to see of the ground from a direction and a range.

Two tables over the cosine of the azimuth off the Sun and the sine of the depression of the line of
sight say how sharp a look is and how much of the ground it can tell of; a third, over sharpness,
says what it takes away of the uncertainty. A camera sees rocks by their shadows: q, the root of the
dark pixels of a rock, and its miss rate are those of the shadow mapper's model; what lies in the
shadow of another rock it cannot tell. A LiDAR sees them by returns: one is missed if no return
falls on it, and what lies behind another rock it cannot tell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.models.instruments import CameraInstrument, LidarInstrument, PointedInstrument
from lunarsim.onboard.hazards.mapper import sensors_of
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.shadow_model import LEAST_ELEVATION, MOST_ELEVATION
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.seeking.information import ExpectedRocks, told_by_look
from lunarsim.rocks.population import RockExpectation

Array = NDArray[np.float64]

# Nodes of the tables of directions (azimuth and depression), and of sharpness, which ends where
# the least rock has so many pixels or returns across.
_NODES, _SHARPNESSES, _SHARPEST = 33, 129, 12.0
# Rocks from this share of the least hazard on hide ground: smaller ones do not look like a hazard.
_HIDING = 0.6
# What a camera errs by while it has seen ground from one side alone, 1 sigma: of directions, rad,
# and of the height above the ground, a share of it (as the shadow tracker's covariances tell).
_POINTING, _HEIGHT = 1e-3, 0.007


@dataclass(frozen=True)
class Eye:
    """A sensor as the planner knows it.

    Attributes
    ----------
    name
        Of the sensor.
    sharp
        Sharpness of a look for a metre of radius and a pixel of 1 m (33, 33), over the cosine of
        the azimuth off the Sun from -1 to 1 and the sine of the depression from 0 to 1.
    open
        Share of the ground that the look can tell of (33, 33).
    astray
        How far what is seen lies astray (33, 33): half the variance of a place over the square of
        the least hazard's radius, from a range of 1 m, 1/m^2. So much less does a look tell.
    told
        Share of the uncertainty that a look takes away (129,), over sharpness from 0 to `sharpest`.
    sharpest
        Sharpness at the end of `told`.
    pixel
        Angle of a pixel, rad.
    half_field
        Tangent of half the narrower side of the field of view.
    gimbal_limit
        Of the boresight from straight down through the lander, rad.
    longest
        Range, m.
    sun
        Direction towards the Sun on the ground (2,), unit vector.
    """

    name: str
    sharp: Array
    open: Array
    astray: Array
    told: Array
    sharpest: float
    pixel: float
    half_field: float
    gimbal_limit: float
    longest: float
    sun: Array


def directions() -> tuple[Array, Array]:
    """Return azimuth off the Sun and depression of the tables' nodes (33, 33), rad."""
    cosine, sine = np.linspace(-1.0, 1.0, _NODES), np.linspace(0.0, 1.0, _NODES)
    azimuth, depression = np.meshgrid(np.arccos(cosine), np.arcsin(sine), indexing="ij")
    return azimuth, depression


def eyes_of(briefing: Briefing, least_diameter: float) -> list[Eye]:
    """Return the sensors that see hazards: those on gimbals that a mapper takes in.

    A camera without a Sun that throws shadows sees none.

    Parameters
    ----------
    briefing
        Of the flight.
    least_diameter
        Of a rock that is a hazard, m.
    """
    parts = [part for part in briefing.software.mappers.values() if hasattr(part, "sensor")]
    taken = {sensor for part in parts for sensor in sensors_of(part)}
    found = []
    for name, known in briefing.instruments.items():
        if name not in taken or name not in briefing.software.tasking:
            continue
        if isinstance(known, CameraInstrument):
            elevation = float(np.arcsin(np.clip(briefing.sun[2], -1.0, 1.0)))
            if LEAST_ELEVATION <= elevation <= MOST_ELEVATION:
                found.append(camera_eye(name, known, briefing, least_diameter))
        elif isinstance(known, LidarInstrument):
            found.append(lidar_eye(name, known, briefing, least_diameter))
    return found


def camera_eye(
    name: str, camera: CameraInstrument, briefing: Briefing, least_diameter: float
) -> Eye:
    """Return a camera, by which rocks are seen by their shadows (Eqs. 13 to 15 of that paper).

    The root of the area that a rock of radius 1 darkens, foreshortened, over the size of a pixel is
    its q; the ground is open where the shadow of no other rock falls.
    """
    model = ShapeMixture(float(np.arcsin(briefing.sun[2])), briefing.rocks.shape)
    azimuth, depression = directions()
    sharp = model.visible_pixels(1.0, azimuth, depression, 1.0)
    hiding = ExpectedRocks.of(briefing.rocks.cover, _HIDING * least_diameter)
    area = model.patch(azimuth, depression).area
    dark = float(hiding.number @ hiding.radius**2) * area
    rates = DetectionRates()
    astray = 0.5 * place_variance(depression) / (0.5 * least_diameter) ** 2
    return _eye(
        name, camera, briefing, least_diameter, (sharp, np.exp(-dark), astray), rates.false_clear,
        np.inf,
    )  # fmt: skip


def place_variance(depression: Array) -> Array:
    """Return the variance of a place seen from a range of 1 m by a camera alone (...), m^2.

    Mean over both axes: an error of the direction, which moves a place along the line of sight by
    so much over the sine of the depression, and one of the height above the ground.
    """
    sine = np.maximum(np.sin(depression), 1e-3)
    height = _HEIGHT * np.cos(depression)
    return np.asarray(0.5 * (_POINTING**2 * (1.0 + 1.0 / sine**2) + height**2))


def lidar_eye(name: str, lidar: LidarInstrument, briefing: Briefing, least_diameter: float) -> Eye:
    """Return a LiDAR, which misses a rock if no return falls on it.

    Returns lie a pixel apart across the line of sight and a pixel over the sine of the depression
    along it; the ground is open where no rock stands before it. Beyond the greatest incidence
    nothing comes back.
    """
    _, depression = directions()
    sine = np.sin(depression)
    sharp = np.sqrt(sine) * (sine >= np.cos(lidar.max_incidence) - 1e-12)
    hiding = ExpectedRocks.of(briefing.rocks.cover, _HIDING * least_diameter)
    broad = 2.0 * height_of(briefing.rocks) * float(hiding.number @ hiding.radius**2)
    with np.errstate(divide="ignore"):
        hidden = broad * np.sqrt(1.0 - sine**2) / sine
    return _eye(
        name, lidar, briefing, least_diameter, (sharp, np.exp(-hidden), np.zeros_like(sharp)),
        without_return, lidar.max_range,
    )  # fmt: skip


def without_return(returns: Any) -> Array:
    """Return the probability that none of the returns falls on a disc (...).

    Parameters
    ----------
    returns
        Root of the number of returns on the square of its radius (...).
    """
    return np.asarray(np.exp(-np.pi * np.asarray(returns, dtype=np.float64) ** 2))


def height_of(rocks: RockExpectation) -> float:
    """Return the mean height of the rocks expected above the ground, in radii."""
    drawn = rocks.model().draw(np.full(64, 2.0), np.random.default_rng(1972))
    return float(np.mean(drawn.base + drawn.height))


def _eye(
    name: str, known: PointedInstrument, briefing: Briefing, least_diameter: float,
    tables: tuple[Array, Array, Array], missed: Callable[[Array], Array], longest: float,
) -> Eye:  # fmt: skip
    """Return an eye whose looks miss rocks at a rate."""
    rocks = ExpectedRocks.of(briefing.rocks.cover, least_diameter)
    sharpest = _SHARPEST / float(rocks.radius[0])
    sharpness = np.linspace(0.0, sharpest, _SHARPNESSES)
    told = told_by_look(rocks, footprint_of(briefing), missed, sharpness)
    level = np.asarray(briefing.sun[:2], dtype=np.float64)
    size = float(np.hypot(*level))
    sun = level / size if size > 0.0 else np.array([1.0, 0.0])
    assert isinstance(known, CameraInstrument | LidarInstrument)
    return Eye(
        name, *tables, told, sharpest, known.pixel, known.half_field, known.gimbal_limit, longest,
        sun,
    )  # fmt: skip


def footprint_of(briefing: Briefing) -> float:
    """Return the radius of the disc into which no rock may reach under the lander, m."""
    lander = briefing.lander
    return float(lander.leg_radius + 0.5 * lander.pad_diameter)
