# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled score of many paths: information gained about the terrain, and delta-v."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.core.path_cost import GRAVITY, HIGH, LOW, TIME_FRACTION, evaluate_path

# Columns of a terrain node, and of the parameters of a sensor.
EAST, NORTH, UP, WEIGHT, KNOWN_FRACTION, MIN_TIME_TO_GO = 0, 1, 2, 3, 4, 5
(
    PIXEL,
    MAX_SHARPNESS,
    COS_HALF_FIELD,
    COS_GIMBAL_LIMIT,
    MAX_RANGE,
    MAX_ALTITUDE,
    MIN_ALTITUDE,
    SUN_EAST,
    SUN_NORTH,
) = range(9)


@kernel(inline=True)
def _removed_uncertainty(
    sharpness,
    visible,
    displacement,
    reduction,
    sensor,
    pixel_sharpness,
    cos_azimuth,
    sin_depression,
    distance,
):
    """Return the fraction of hazard uncertainty that one observation removes.

    `sharpness`, `visible`, `displacement` (sensors, 33, 33) and `reduction` (sensors, 129) are the
    tables of `SensorCoverageModel`. `sensor` is the index of the sensor, and `pixel_sharpness` its
    angle of a pixel, rad, times its `max_sharpness`. `cos_azimuth` is the cosine of the camera's
    azimuth from the Sun, `sin_depression` the sine of the depression of the line of sight, and
    `distance` the range, m.
    """
    last = sharpness.shape[1] - 1
    u, v = 0.5 * last * (cos_azimuth + 1.0), last * sin_depression
    i, j = min(max(int(u), 0), last - 1), min(max(int(v), 0), last - 1)
    u, v = u - i, v - j
    a, b, c, d = (1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v
    sharpness_at_1_m = (
        a * sharpness[sensor, i, j] + b * sharpness[sensor, i + 1, j]
        + c * sharpness[sensor, i, j + 1] + d * sharpness[sensor, i + 1, j + 1]
    )  # fmt: skip
    visible_fraction = (
        a * visible[sensor, i, j] + b * visible[sensor, i + 1, j]
        + c * visible[sensor, i, j + 1] + d * visible[sensor, i + 1, j + 1]
    )  # fmt: skip
    displacement_at_1_m = (
        a * displacement[sensor, i, j] + b * displacement[sensor, i + 1, j]
        + c * displacement[sensor, i, j + 1] + d * displacement[sensor, i + 1, j + 1]
    )  # fmt: skip
    visible_fraction *= np.exp(-displacement_at_1_m * distance * distance)
    last_bin = reduction.shape[1] - 1
    bin_position = sharpness_at_1_m / (distance * pixel_sharpness) * last_bin
    if bin_position >= last_bin:
        return visible_fraction * reduction[sensor, last_bin]
    k = int(bin_position)
    return visible_fraction * (
        reduction[sensor, k]
        + (bin_position - k) * (reduction[sensor, k + 1] - reduction[sensor, k])
    )


@kernel(inner=True)
def observe_nodes(
    position,
    thrust,
    time_left,
    site,
    nodes,
    sensor,
    sharpness,
    visible,
    displacement,
    reduction,
    sensor_params,
    known_fraction,
):
    """Update the removed hazard uncertainty at terrain nodes with one observation.

    `known_fraction` (g,), the fraction removed at each of the g nodes, is changed in place: a
    value rises to that of this observation if the latter is larger, and if the lander can still
    divert to the node with `time_left` seconds left. Nodes outside the field of view or the range
    of the sensor do not change; no node does if the gimbal limit is exceeded. `sensor` is the
    index of a sensor at `position` (3,), m, that points at `site`; `thrust` (3,) gives the
    direction of the vehicle axis. The other arguments are those of `score_paths`.
    """
    bx, by, bz = site[0] - position[0], site[1] - position[1], site[2] - position[2]
    size = np.sqrt(bx * bx + by * by + bz * bz)
    if size == 0.0:
        return
    bx, by, bz = bx / size, by / size, bz / size
    axis = np.sqrt(thrust[0] ** 2 + thrust[1] ** 2 + thrust[2] ** 2)
    if (
        -(bx * thrust[0] + by * thrust[1] + bz * thrust[2])
        < sensor_params[sensor, COS_GIMBAL_LIMIT] * axis
    ):
        return
    pixel_sharpness = sensor_params[sensor, PIXEL] * sensor_params[sensor, MAX_SHARPNESS]
    for g in range(nodes.shape[0]):
        if time_left < nodes[g, MIN_TIME_TO_GO] or nodes[g, WEIGHT] <= 0.0:
            continue
        x, y, z = (
            position[0] - nodes[g, EAST],
            position[1] - nodes[g, NORTH],
            position[2] - nodes[g, UP],
        )
        horizontal = np.sqrt(x * x + y * y)
        distance = np.sqrt(horizontal * horizontal + z * z)
        if z <= 0.0 or distance > sensor_params[sensor, MAX_RANGE]:
            continue
        if -(x * bx + y * by + z * bz) < sensor_params[sensor, COS_HALF_FIELD] * distance:
            continue
        cos_azimuth = 0.0
        if horizontal > 0.0:
            cos_azimuth = (
                x * sensor_params[sensor, SUN_EAST] + y * sensor_params[sensor, SUN_NORTH]
            ) / horizontal
        fraction = _removed_uncertainty(
            sharpness,
            visible,
            displacement,
            reduction,
            sensor,
            pixel_sharpness,
            cos_azimuth,
            z / distance,
            distance,
        )
        known_fraction[g] = max(known_fraction[g], fraction)


@kernel(inner=True)
def path_state(
    target, end_state, time_to_go, table, sample, powers, terms, gravity, position, thrust
):
    """Compute position and thrust acceleration (3,) at a sample of a polynomial path.

    `position`, m, and `thrust`, m/s^2, receive the results. `sample` is a row of `table` (samples,
    3), which contains the fraction of time left and its two `powers`. `time_to_go` is the duration
    of the path, s. `target` (3,) is the final position, m, `end_state` (2, 3) final velocity and
    acceleration, `terms` the result of `power_terms`, and `gravity`, m/s^2, acts downward.
    """
    low, high = table[sample, LOW], table[sample, HIGH]
    time_left = table[sample, TIME_FRACTION] * time_to_go
    f, g = low / (powers[0] + 2.0), high / (powers[1] + 2.0)
    d, e = (powers[0] + 1.0) * low, (powers[1] + 1.0) * high
    for k in range(3):
        half = 0.5 * end_state[1, k] + terms[0, k] * f + terms[1, k] * g
        position[k] = target[k] + time_left * (time_left * half - end_state[0, k])
        thrust[k] = end_state[1, k] + d * terms[0, k] + e * terms[1, k]
    thrust[2] += gravity


@kernel(inner=True)
def observe_along_path(
    target, end_state, time_to_go, table, powers, terms, gravity, max_final_tilt, site, nodes,
    sharpness, visible, displacement, reduction, sensor_params, single_altitudes, samples,
    known_fraction,
):  # fmt: skip
    """Update the removed hazard uncertainty at terrain nodes along a path.

    `known_fraction` (g,), the fraction of hazard uncertainty removed at each node, is raised in
    place by all observations of all sensors. The function returns False if the thrust tilts by
    more than `max_final_tilt` (a tangent) below the altitude at which observations cease to count,
    otherwise True. `samples` (4, 3) is scratch. The path is defined as for `path_state`; the other
    arguments are those of `score_paths`.
    """
    standing_height, min_altitude = site[3], site[4]
    lowest_altitude = np.inf
    for s in range(table.shape[0]):
        path_state(
            target, end_state, time_to_go, table, s, powers, terms, gravity, samples[0], samples[1]
        )
        altitude = samples[0, 2] - standing_height
        if altitude < min_altitude:
            lateral_thrust = np.sqrt(samples[1, 0] ** 2 + samples[1, 1] ** 2)
            if lateral_thrust > max_final_tilt * samples[1, 2]:
                return False
        time_left = table[s, TIME_FRACTION] * time_to_go
        for sensor in range(sensor_params.shape[0]):
            if not np.isnan(single_altitudes[sensor, 0]):
                for k in range(single_altitudes.shape[1]):
                    h = single_altitudes[sensor, k]
                    if s == 0 or not (lowest_altitude > h >= altitude) or h < min_altitude:
                        continue
                    # Interpolate the position at this altitude between the last two samples.
                    part = (samples[2, 2] - standing_height - h) / max(
                        samples[2, 2] - samples[0, 2], 1e-9
                    )
                    part = min(max(part, 0.0), 1.0)
                    for i in range(3):
                        samples[3, i] = samples[2, i] + part * (samples[0, i] - samples[2, i])
                    observe_nodes(
                        samples[3], samples[1], time_left, site, nodes, sensor, sharpness,
                        visible, displacement, reduction, sensor_params, known_fraction,
                    )  # fmt: skip
            elif (
                max(sensor_params[sensor, MIN_ALTITUDE], min_altitude)
                <= altitude
                <= sensor_params[sensor, MAX_ALTITUDE]
            ):
                observe_nodes(
                    samples[0], samples[1], time_left, site, nodes, sensor, sharpness, visible,
                    displacement, reduction, sensor_params, known_fraction,
                )  # fmt: skip
        lowest_altitude = min(lowest_altitude, altitude)
        samples[2] = samples[0]
    return True


@kernel(shared=True)
def score_paths(
    thread_slice, state, target, end_velocity, paths, limit_table, observation_table, powers,
    vehicle_params, max_final_tilt, site, nodes, sharpness, visible, displacement, reduction,
    sensor_params, single_altitudes, out,
):  # fmt: skip
    """Compute the information gained along each of n candidate paths, and its delta-v.

    `out` (n, 2) receives the fraction of hazard uncertainty removed, a weighted mean over the
    terrain `nodes` of `PlanningProblem`, and the delta-v, m/s, which is inf if a limit is violated.
    Each of `paths` (n, 4) is time-to-go, s, and acceleration at the end, m/s^2. They lead from
    `state` (2, 3), position and velocity, to `target` (3,) with `end_velocity` (3,).

    Limits are checked at the samples of `limit_table`, and sensors observe at those of
    `observation_table`; tables, `powers` and `vehicle_params` are as for `evaluate_path`.
    `max_final_tilt` is a tangent and applies at the end and where observations no longer count.
    `site` (5,) is the position of the site (3), the height of the centre of mass of a landed
    vehicle, and the altitude below which observations do not count, m. `single_altitudes`
    (sensors, k), m, are the altitudes of single observations; a sensor with NaN observes at every
    sample. The arguments from `sharpness` to `sensor_params` describe the sensors
    (`SensorCoverageModel`). `thread_slice` is (thread, number of threads).
    """
    total = 0.0
    for g in range(nodes.shape[0]):
        total += nodes[g, WEIGHT]
    end_state, terms, path_cost = np.empty((2, 3)), np.empty((2, 3)), np.empty(4)
    samples, known_fraction = np.empty((4, 3)), np.empty(nodes.shape[0])
    for n in range(thread_slice[0], paths.shape[0], thread_slice[1]):
        for k in range(3):
            end_state[0, k], end_state[1, k] = end_velocity[k], paths[n, 1 + k]
        out[n, 0], out[n, 1] = 0.0, np.inf
        vertical_thrust = end_state[1, 2] + vehicle_params[GRAVITY]
        lateral_thrust = np.sqrt(end_state[1, 0] ** 2 + end_state[1, 1] ** 2)
        if (
            vertical_thrust <= 0.0
            or lateral_thrust > max_final_tilt * vertical_thrust
            or not paths[n, 0] > 0.0
        ):
            continue
        if not evaluate_path(
            state, target, end_state, paths[n, 0], limit_table, powers, vehicle_params, terms,
            path_cost,
        ):  # fmt: skip
            continue
        for g in range(nodes.shape[0]):
            known_fraction[g] = nodes[g, KNOWN_FRACTION]
        if not observe_along_path(
            target,
            end_state,
            paths[n, 0],
            observation_table,
            powers,
            terms,
            vehicle_params[GRAVITY],
            max_final_tilt,
            site,
            nodes,
            sharpness,
            visible,
            displacement,
            reduction,
            sensor_params,
            single_altitudes,
            samples,
            known_fraction,
        ):
            continue
        out[n, 1] = path_cost[0]
        mean = 0.0
        for g in range(nodes.shape[0]):
            mean += nodes[g, WEIGHT] * known_fraction[g]
        out[n, 0] = mean / total if total > 0.0 else 0.0
