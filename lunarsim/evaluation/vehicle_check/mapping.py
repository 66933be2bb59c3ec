"""Legs and limits of the lander against the hazard maps and their calibration."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.evaluation.vehicle_check.sensing import lidar_samples
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.calibration.evidence import SLOPE_LIMIT_RANGE_RAD
from lunarsim.onboard.calibration.gaussian_dem import NOISE_RATIO_RANGE, SPACING_RATIO_RANGE
from lunarsim.onboard.calibration.quadtree import MAX_NOISE_RATIO
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapperSettings
from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapperSettings

# Exposed height over diameter of hemispheres and cubes; other shapes state their mean.
_HEIGHT_RATIOS = {"hemisphere": 0.5, "cube": 1.0}


def mapping_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of legs and limits against the hazard maps."""
    for name, mapper in mission.software.mappers.items():
        yield from _posting_rows(mission, name, mapper)
        yield from _domain_rows(mission, name, mapper)
    yield from _clearance_rows(mission)


def _posting_rows(mission: Mission, name: str, mapper: Any) -> Iterator[CheckRow]:
    """Yield the checks of a map's posting against pads and legs.

    A map of elevations must resolve a pad; a map of rocks must resolve the smallest hazardous rock.
    """
    posting, lander = getattr(mapper, "posting", None), mission.lander
    if not isinstance(posting, float | int):
        return
    key = f"mappers.{name}.posting_m"
    if issubclass(mapper.accepts, LidarScan):
        yield CheckRow(
            f"posting-pad-{name}", "maps", f"pad diameter against the posting of map '{name}'",
            float(posting), lander.pad_diameter, "m",
            "Otherwise the map averages over what lies under a pad: lower "
            f"{key}, or raise vehicle.pad_diameter_m.",
        )  # fmt: skip
    elif hasattr(mapper, "min_hazard_diameter"):
        yield CheckRow(
            f"posting-rock-{name}", "maps", f"smallest rock of map '{name}' against its posting",
            float(posting), float(mapper.min_hazard_diameter), "m",
            f"Otherwise rocks fall between the cells: lower {key}.",
        )  # fmt: skip
    yield CheckRow(
        f"posting-legs-{name}", "maps", f"half the leg radius against the posting of map '{name}'",
        float(posting), 0.5 * lander.leg_radius, "m",
        f"Otherwise the map cannot show the slope under the legs: lower {key}, or raise "
        "vehicle.leg_radius_m.", wanted_margin=0.25,
    )  # fmt: skip


def _domain_rows(mission: Mission, name: str, mapper: Any) -> Iterator[CheckRow]:
    """Yield the checks of the lander's limits against the domain of p_safe.

    A calibrated probability is valid for the landers and scans of its fits: slope limits of 4.5 to
    22 deg, noise over the roughness limit, and spacing over the radius of the legs. A calibration
    file of the scenario has its own ranges of noise and spacing.
    """
    is_dem = isinstance(mapper, GaussianDemMapperSettings) and mapper.safety == "calibrated"
    if not (is_dem or isinstance(mapper, QuadtreeMapperSettings)):
        return
    lander, remedy = mission.lander, "change vehicle.slope_limit_deg or run `lunarsim calibrate`"
    low, high = (float(np.rad2deg(v)) for v in SLOPE_LIMIT_RANGE_RAD)
    slope = float(np.rad2deg(lander.slope_limit))
    near_low = slope < 0.5 * (low + high)
    yield CheckRow(
        f"slope-domain-{name}", "maps",
        f"slope limit against the calibrated domain of map '{name}' ({low:g} to {high:g} deg)",
        low if near_low else high, slope, "deg",
        f"Otherwise p_safe of '{name}' has not been calibrated for this lander: {remedy}.",
        "at least" if near_low else "at most",
    )  # fmt: skip
    found = lidar_samples(mission, mapper)
    if found is None:
        return
    noise, spacing = found
    noise_range, spacing_range = (0.0, MAX_NOISE_RATIO), (0.0, np.inf)
    if isinstance(mapper, GaussianDemMapperSettings):
        noise_range, spacing_range = NOISE_RATIO_RANGE, SPACING_RATIO_RANGE
        refit = mapper.calibration()
        if refit is not None:
            noise_range, spacing_range = refit.domain.noise, refit.domain.spacing
    yield CheckRow(
        f"noise-domain-{name}", "maps",
        f"range noise over the roughness limit against the domain of map '{name}'",
        float(noise_range[1]), noise / lander.roughness_limit, "",
        f"Otherwise p_safe of '{name}' is outside its calibrated domain: lower the sensor's "
        "noise_ratio, measure lower, or raise vehicle.roughness_limit_m.", "at most",
    )  # fmt: skip
    if np.isfinite(spacing_range[1]):
        yield CheckRow(
            f"spacing-domain-{name}", "maps",
            f"sample spacing over the leg radius against the domain of map '{name}'",
            float(spacing_range[1]), spacing / lander.leg_radius, "",
            f"Otherwise p_safe of '{name}' is outside its calibrated domain: give the sensor more "
            "pixels, or measure lower.", "at most",
        )  # fmt: skip


def _clearance_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of the clearance under the body.

    Terrain within the roughness limit must not touch the body. The smallest generated rock must be
    lower than the clearance, or rocks that touch the body are missing in the world.
    """
    lander, rocks = mission.lander, mission.scenario.rocks.make()
    yield CheckRow(
        "belly-clearance", "maps", "clearance under the body against the roughness limit",
        lander.roughness_limit, lander.belly_clearance, "m",
        "Otherwise rocks that count as safe touch the body: raise vehicle.belly_clearance_m, or "
        "lower vehicle.roughness_limit_m.",
    )  # fmt: skip
    if rocks.cover > 0.0 and mission.scenario.terrain.kind != "hazard-field":
        ratio = _HEIGHT_RATIOS.get(rocks.shape, rocks.height_ratio[0])
        yield CheckRow(
            "smallest-rock", "maps", "height of the smallest generated rock against the clearance",
            lander.belly_clearance, rocks.min_diameter * ratio, "m",
            "Otherwise the world has no rocks of a size that the lander cannot clear, and too "
            "many landings succeed: lower rocks.min_diameter_m.", "at most",
        )  # fmt: skip
