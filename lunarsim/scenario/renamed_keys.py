"""Names of scenario keys in earlier versions, and the keys that replace them."""

from __future__ import annotations

# Path of the key, with its tables as they are named now ("*" is the name of a part): new name.
RENAMED: dict[str, str] = {
    "surroundings": "far_terrain",
    "start_knowledge": "initial_uncertainty",
    "variation": "domain_randomization",
    "descent": "terminal_descent",
    "rocks.clustered": "cluster_fraction",
    "rocks.block_crater_m": "min_block_crater_diameter_m",
    "rocks.fillet": "fillet_height_ratio",
    "sun.scattered": "scattered_light",
    "sun.mottle": "albedo_variation",
    "sun.mottle_length_m": "albedo_correlation_length_m",
    "sun.boulder_mottle": "boulder_albedo_variation",
    "approach.ends_at_s": "end_time_to_go_s",
    "initial_uncertainty.ground_m": "target_elevation_m",
    "prior_map.stale_share": "outdated_fraction",
    "prior_map.stale_side_m": "outdated_patch_side_m",
    "prior_map.stale_sigma_m": "outdated_height_sigma_m",
    "prior_map.void_share": "void_fraction",
    "faults.jets_shut": "jets_stuck_shut",
    "faults.jets_open": "jets_stuck_open",
    "faults.jets_from_s": "jets_stuck_from_s",
    "domain_randomization.load_kg": "payload_kg",
    "domain_randomization.thrust": "thrust_scale",
    "domain_randomization.weakest": "min_remaining_fraction",
    "domain_randomization.failure_by_s": "latest_failure_s",
    "braking.ends_at_s": "end_time_to_go_s",
    "braking.direction_first": "keeps_thrust_direction",
    "braking.trim_s": "min_thrust_time_s",
    "window.forward_deg": "azimuth_deg",
    "window.highest_deg": "upper_edge_deg",
    "window.lowest_deg": "lower_edge_deg",
    "terrain.crater_saturation_m": "crater_equilibrium_diameter_m",
    "terrain.crater_ageing": "crater_degradation",
    "terrain.mirrored_to_m": "mirrored_size_m",
    "terrain.field_turn_deg": "field_rotation_deg",
    "vehicle.thrusters.minimum_on_s": "min_on_time_s",
    "vehicle.engine.gap_from_n": "gap_lower_n",
    "vehicle.engine.gap_to_n": "gap_upper_n",
    "vehicle.slosh.shares": "propellant_fractions",
    "navigation.relief_deg": "terrain_slope_deg",
    "navigation.thrust_error": "thrust_sigma",
    "policy.worth": "value_weight",
    "policy.gain": "hysteresis",
    "policy.least": "p_safe_min",
    "policy.altitude_m": "abort_altitude_m",
    "policy.enough": "p_safe_min",
    "policy.price": "propellant_weight",
    "policy.weight_fuel": "propellant_weight",
    "policy.room_m": "min_clearance_m",
    "guidance.least_time_to_go_s": "min_time_to_go_s",
    "guidance.end_tilt_deg": "max_final_tilt_deg",
    "guidance.thrust_slack": "thrust_tolerance",
    "guidance.tilt_slack_deg": "tilt_tolerance_deg",
    "guidance.squares": "nodes_per_side",
    "guidance.allowance_kg": "propellant_allowance_kg",
    "guidance.price": "propellant_weight",
    "guidance.least_diameter_m": "min_rock_diameter_m",
    "terminal_descent.fastest_m_s": "max_rate_m_s",
    "terminal_descent.look_interval_s": "check_interval_s",
    "terminal_descent.speed_time_s": "velocity_time_s",
    "terminal_descent.still_height_m": "zero_speed_height_m",
    "terminal_descent.lean_time_s": "correction_time_s",
    "terminal_descent.max_lean_deg": "max_tilt_deg",
    "terminal_descent.hold_speed_m_s": "hold_height_speed_m_s",
    "terminal_descent.beyond_m": "overshoot_m",
    "terminal_descent.last_speed_m_s": "final_speed_m_s",
    "sensors.*.speed_wander_m_s": "speed_random_walk_m_s",
    "sensors.*.across_deg": "cross_boresight_noise_deg",
    "sensors.*.about_deg": "roll_noise_deg",
    "sensors.*.max_rate_deg_s": "max_angular_rate_deg_s",
    "sensors.*.ground_angle_deg": "min_elevation_deg",
    "sensors.*.sun_angle_deg": "sun_exclusion_angle_deg",
    "sensors.*.half_width": "half_fov_tangent",
    "sensors.*.spacing": "pixel_spacing",
    "sensors.*.boresight_off_deg": "boresight_bias_deg",
    "sensors.*.late_s": "latency_bias_s",
    "sensors.*.exposure_shortest_s": "exposure_min_s",
    "sensors.*.exposure_longest_s": "exposure_max_s",
    "mappers.*.hazard_diameter_m": "min_hazard_diameter_m",
    "mappers.*.look_interval_s": "clear_terrain_interval_s",
    "mappers.*.ground": "terrain_mapper",
    "mappers.*.form": "cover_model",
    "mappers.*.least_m": "min_cell_size_m",
    "mappers.*.sites.density_per_m2": "min_density_per_m2",
    "mappers.*.sites.zone_m": "zone_half_side_m",
    "mappers.*.sites.weight_interest": "interest_weight",
    "mappers.*.sites.weight_slope": "slope_weight",
    "mappers.*.sites.weight_roughness": "roughness_weight",
    "mappers.*.of": "inputs",
    "mappers.*.relief_prior": "terrain_prior",
    "mappers.*.feature": "calibration_mapper",
}
# Path of a key as it is named now, value of earlier versions: value that replaces it.
RENAMED_VALUES: dict[tuple[str, str], str] = {
    ("mappers.*.shapes", "told"): "expected",
    ("terrain.crater_degradation", "even"): "uniform",
}
# Names of supplied scenarios in earlier versions, and the names that replace them.
RENAMED_SCENARIOS: dict[str, str] = {
    "all_eyes": "all_sensors",
    "all_eyes_hard": "all_sensors_hard",
    "two_eyes": "camera_and_lidar",
}
# Tables of named parts: their second step is a name and never a key.
_NAMED = ("sensors", "sensor_faults", "tasking", "mappers")


def current_path(path: str) -> str:
    """Translate a scenario key of an earlier version to its current dotted path.

    A key that was not renamed is returned unchanged.

    Examples
    --------
    >>> current_path("variation.load_kg")
    'domain_randomization.payload_kg'
    """
    return ".".join(current_steps(path.split(".")))


def current_steps(path: list[str]) -> list[str]:
    """Translate the path of a scenario key of an earlier version, as a list of names.

    Names that were not changed remain in the result.

    Examples
    --------
    >>> current_steps(["sensors", "my.camera", "late_s"])
    ['sensors', 'my.camera', 'latency_bias_s']
    """
    out: list[str] = []
    for step in path:
        out.append(step if "." in step else RENAMED.get(pattern_of([*out, step]), step))
    return out


def first_path(path: str) -> str:
    """Translate a current scenario key to the dotted path of the first version.

    A key that was not renamed is returned unchanged. Labels of random streams use these names, so
    that renaming a key changes no random number.

    Examples
    --------
    >>> first_path("initial_uncertainty.position_m")
    'start_knowledge.position_m'
    """
    current, first = [], []
    for step in path.split("."):
        current.append(step)
        first.append(_FIRST.get(pattern_of(current), step))
    return ".".join(first)


def pattern_of(path: list[str]) -> str:
    """Return a dotted path, with "*" for the name of a sensor or other part.

    The result is a key of `RENAMED`, which does not depend on names that the user chooses.

    Examples
    --------
    >>> pattern_of(["sensors", "flash", "late_s"])
    'sensors.*.late_s'
    """
    named = len(path) > 2 and path[0] in _NAMED
    return ".".join([path[0], "*", *path[2:]] if named else path)


# Of two keys that have one name now, the first in `RENAMED` counts.
_FIRST = {
    ".".join([*path.split(".")[:-1], new]): path.rpartition(".")[2]
    for path, new in reversed(RENAMED.items())
}
