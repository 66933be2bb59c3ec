"""From a scenario's tables to the objects that fly."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.divert import DivertLimits
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.rng import Streams
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.laws import sample_diameters
from lunarsim.scenario import Scenario, TerrainSection
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.sensors.navigation_fix import ErrorBudget
from lunarsim.vehicle import Dynamics
from lunarsim.world import World
from lunarsim.world.light import Light
from lunarsim.world.terrain import (
    CraterLaw,
    Heightfield,
    Terrain,
    add_craters,
    add_detail,
    fractal_relief,
    hazard_field,
    place_rocks,
)
from lunarsim.world.terrain.dtm import load_dtm

# Procedural relief is the same ground for all flights of a scenario; only rocks are redrawn.
_RELIEF_SEED = 20260101


def lander_of(scenario: Scenario) -> Lander:
    """Return the scenario's lander.

    Raises
    ------
    InputError
        If it cannot hover or its figures contradict each other.
    """
    s = scenario.lander
    lander = Lander(
        dry_mass=s.dry_mass_kg,
        propellant_mass=s.propellant_kg,
        inertia_dry=s.inertia_dry_kg_m2,
        inertia_full=s.inertia_full_kg_m2,
        thrust_min=s.thrust_min_n,
        thrust_max=s.thrust_max_n,
        specific_impulse=s.specific_impulse_s,
        thrust_lag=s.thrust_lag_s,
        torque_max=s.torque_max_n_m,
        legs=s.legs,
        leg_radius=s.leg_radius_m,
        pad_diameter=s.pad_diameter_m,
        com_height=s.com_height_m,
        belly_clearance=s.belly_clearance_m,
        slope_limit=np.deg2rad(s.slope_limit_deg),
        roughness_limit=s.roughness_limit_m,
        vertical_speed_limit=s.vertical_speed_limit_m_s,
        horizontal_speed_limit=s.horizontal_speed_limit_m_s,
        tilt_limit=np.deg2rad(s.tilt_limit_deg),
        rate_limit=np.deg2rad(s.rate_limit_deg_s),
    )
    lander.check_hover(scenario.gravity_m_s2)
    return lander


@lru_cache(maxsize=4)
def relief_of(section: TerrainSection) -> Heightfield:
    """Return the relief of a scenario, at its working posting."""
    if section.kind == "fractal":
        return _procedural(Grid.centred((0.0, 0.0), section.size_m, section.posting_m), section)
    assert section.path is not None
    measured = load_dtm(section.path, posting=section.dtm_posting_m, window=section.dtm_window)
    if section.height_step_m is not None:
        measured = measured.dequantised(section.height_step_m)
    measured = measured.scaled(section.relief_scale)
    fine = measured.refined(section.posting_m)
    if not section.detail:
        return fine
    # Craters that the posts could show are in the measurement already.
    largest = 2.0 * measured.grid.posting
    return add_detail(measured, _procedural(fine.grid, section, largest))


def _procedural(grid: Grid, section: TerrainSection, largest: float | None = None) -> Heightfield:
    """Return fractal relief, with craters (the largest as given, m) if any are asked for."""
    rng = np.random.default_rng(_RELIEF_SEED)
    relief = fractal_relief(
        grid, rng, hurst=section.hurst, rms_slope=np.deg2rad(section.rms_slope_deg)
    )
    if section.crater_density == 0.0:
        return relief
    law = CraterLaw(section.crater_density, section.crater_saturation_m)
    return add_craters(relief, rng, minimum=section.crater_min_diameter_m, maximum=largest, law=law)


def build_world(scenario: Scenario, streams: Streams) -> World:
    """Return the true world of one flight: the scenario's relief with rocks drawn for it.

    Raises
    ------
    InputError
        If the terrain cannot be loaded or is smaller than the lander's footprint.
    """
    if scenario.terrain.kind == "hazard-field":
        return World(_field_of(scenario, streams), scenario.gravity_m_s2, light_of(scenario))
    relief = relief_of(scenario.terrain)
    west, east, south, north = relief.bounds
    diameter = 2.0 * scenario.lander.leg_radius_m + scenario.lander.pad_diameter_m
    if min(east - west, north - south) < 2.0 * diameter:
        raise InputError(
            "terrain",
            f"{east - west:.1f} x {north - south:.1f} m",
            f"at least twice the footprint of {diameter:.1f} m",
        )
    rocks = RockField.empty()
    if scenario.rocks.cover > 0.0:
        rng = streams.get("rocks")
        diameters = sample_diameters(
            (east - west) * (north - south),
            scenario.rocks.cover,
            scenario.rocks.min_diameter_m,
            scenario.rocks.max_diameter_m,
            rng,
        )
        r = scenario.rocks
        model = RockModel(r.shape, r.height_ratio, r.burial, r.axis_ratio)
        rocks = place_rocks(relief, diameters, rng, model=model)
    return World(Terrain(relief, rocks), scenario.gravity_m_s2, light_of(scenario))


def _field_of(scenario: Scenario, streams: Streams) -> Terrain:
    """Return a made hazard field, drawn anew for every flight."""
    s = scenario.terrain
    return hazard_field(
        streams.get("rocks"),
        size=s.field_m,
        surround=s.size_m,
        posting=s.posting_m,
        turn=np.deg2rad(s.field_turn_deg),
        boulders=s.boulders,
        craters=s.craters,
    )


def light_of(scenario: Scenario) -> Light:
    """Return the Sun and the ground's photometry."""
    s = scenario.sun
    return Light(
        np.deg2rad(s.azimuth_deg), np.deg2rad(s.elevation_deg), s.albedo, s.ambient, s.photometry
    )


def dynamics_of(scenario: Scenario, lander: Lander) -> Dynamics:
    """Return the equations of motion."""
    return Dynamics(
        lander,
        scenario.gravity_m_s2,
        step=scenario.simulation.step_s,
        attitude_mode=scenario.guidance.attitude,
        rate_limit=np.deg2rad(scenario.guidance.slew_limit_deg_s),
    )


def lidar_of(scenario: Scenario) -> FlashLidar:
    """Return the LiDAR."""
    s = scenario.lidar
    return FlashLidar(
        s.pixels[0],
        s.pixels[1],
        s.half_width,
        s.noise_3sigma_m / 3.0 / 500.0,
        s.max_range_m,
        s.spacing,
        np.deg2rad(s.max_incidence_deg),
        np.inf if s.photons is None else s.photons,
        1e-3 * s.divergence_mrad,
    )


def camera_of(scenario: Scenario) -> Camera:
    """Return the camera."""
    s = scenario.camera
    return Camera.with_field_of_view(
        s.pixels[1],
        s.pixels[0],
        s.field_of_view_deg,
        distortion=s.distortion,
        exposure=s.exposure_s,
        sensitivity=s.sensitivity,
        blur_sigma=s.blur_sigma_px,
        motion_blur=s.motion_blur,
        shot_noise=s.shot_noise,
        read_noise=s.read_noise_electrons,
        full_well=s.full_well_electrons,
        bits=s.bits,
    )


def mapper_of(scenario: Scenario, lander: Lander, centre: np.ndarray) -> GaussianDemMapper:
    """Return the hazard mapper, its grid centred on the target.

    Raises
    ------
    InputError
        If the map is smaller than the lander's footprint or its posting is too coarse.
    """
    s = scenario.mapper
    return GaussianDemMapper(
        map_grid(scenario, lander, centre),
        lander,
        sigma_f=s.sigma_f_m,
        length_scale=s.length_scale_m,
        safety=s.safety,
    )


def map_grid(scenario: Scenario, lander: Lander, centre: np.ndarray) -> Grid:
    """Return the cells of the hazard map.

    Raises
    ------
    InputError
        If the map is smaller than the lander's footprint or its posting is too coarse.
    """
    s = scenario.mapper
    if s.posting_m > 0.5 * lander.leg_radius:
        raise InputError("mapper.posting_m", s.posting_m, f"at most {0.5 * lander.leg_radius} m")
    if s.size_m < 4.0 * lander.leg_radius + 1.0:
        raise InputError(
            "mapper.size_m", s.size_m, f"at least {4.0 * lander.leg_radius + 1.0:.1f} m"
        )
    return Grid.centred(centre, s.size_m, s.posting_m)


def budget_of(scenario: Scenario) -> ErrorBudget:
    """Return navigation's error budget."""
    s = scenario.navigation
    return ErrorBudget(
        s.position_bias_m,
        s.position_drift_m,
        s.drift_time_s,
        s.velocity_m_s,
        np.deg2rad(s.attitude_deg),
    )


def limits_of(scenario: Scenario) -> DivertLimits:
    """Return what trajectories must respect."""
    s = scenario.guidance
    return DivertLimits(np.deg2rad(s.max_tilt_deg), np.deg2rad(s.glideslope_deg), s.reserve_kg)
