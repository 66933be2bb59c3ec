# mypy: allow-untyped-defs, no-check-untyped-defs
"""Compiled score of many paths: information gained about the terrain, and delta-v."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import GRAVITY, HIGH, LOW, SHARE, evaluate_path

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
    pixel,
    cos_azimuth,
    sin_depression,
    distance,
):
    """Return the fraction of hazard uncertainty that one observation removes.

    `sharpness`, `visible`, `displacement` (sensors, 33, 33) and `reduction` (sensors, 129) are the
    tables of `SensorCoverageModel`. `sensor` is the index of the sensor and `pixel` the angle of a
    pixel, rad, times its maximum sharpness. `cos_azimuth` is the cosine of the azimuth from the
    Sun, `sin_depression` the sine of the depression of the line of sight, and `distance` the range,
    m.
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
    bin_position = sharpness_at_1_m / (distance * pixel) * last_bin
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
    known,
):
    """Update what is known at each terrain node with one observation of the site.

    `known` (g,) is the fraction of hazard uncertainty removed at each node and receives the
    maximum. `position` (3,) is that of the sensor, m, and `thrust` (3,) gives the direction of the
    vehicle axis. Only nodes count to which the lander can still divert with `time_left` seconds
    left. `sensor` is the index of the sensor, which points at `site`. The other arguments are those
    of `score`.
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
    pixel = sensor_params[sensor, PIXEL] * sensor_params[sensor, MAX_SHARPNESS]
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
            pixel,
            cos_azimuth,
            z / distance,
            distance,
        )
        known[g] = max(known[g], fraction)


@kernel(inner=True)
def path_state(target, end_state, total, table, s, powers, x, gravity, position, thrust):
    """Compute position and thrust acceleration (3,) at a sample of a polynomial path.

    `s` is the index of the sample. `target` (3,) and `end_state` (2, 3) are the final position,
    velocity and acceleration, `total` is the time-to-go of the path, s. `table` holds the fraction
    of time left and its powers at the samples, `powers` (2,) the powers of time-to-go, and `x` (2,
    3) the coefficients of the path. `position`, m, and `thrust`, m/s^2, receive the results.
    """
    low, high = table[s, LOW], table[s, HIGH]
    time_left = table[s, SHARE] * total
    f, g = low / (powers[0] + 2.0), high / (powers[1] + 2.0)
    d, e = (powers[0] + 1.0) * low, (powers[1] + 1.0) * high
    for k in range(3):
        half = 0.5 * end_state[1, k] + x[0, k] * f + x[1, k] * g
        position[k] = target[k] + time_left * (time_left * half - end_state[0, k])
        thrust[k] = end_state[1, k] + d * x[0, k] + e * x[1, k]
    thrust[2] += gravity


@kernel(inner=True)
def observe_along_path(
    target, end_state, total, table, powers, x, gravity, max_final_tilt, site, nodes, sharpness,
    visible, displacement, reduction, sensor_params, single_altitudes, samples, known,
):  # fmt: skip
    """Update what is known at each terrain node with all observations along a path.

    `known` (g,) is the fraction of hazard uncertainty removed at each node. The function returns
    False if the thrust tilts by more than `max_final_tilt` (a tangent) below the altitude at which
    observations cease to count. The path is defined as for `path_state`; the sensors as for
    `score`.

    Parameters
    ----------
    site
        Site (3,), height of the centre of mass of a landed vehicle, and altitude below which
        observations do not count, m; together (5,).
    single_altitudes
        Altitudes of single observations of each sensor, m (sensors, k); NaN for none. A sensor
        without any observes at every sample.
    samples
        Scratch array (4, 3).
    """
    standing_height, min_altitude = site[3], site[4]
    lowest_altitude = np.inf
    for s in range(table.shape[0]):
        path_state(target, end_state, total, table, s, powers, x, gravity, samples[0], samples[1])
        altitude = samples[0, 2] - standing_height
        if altitude < min_altitude:
            lateral_thrust = np.sqrt(samples[1, 0] ** 2 + samples[1, 1] ** 2)
            if lateral_thrust > max_final_tilt * samples[1, 2]:
                return False
        time_left = table[s, SHARE] * total
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
                        visible, displacement, reduction, sensor_params, known,
                    )  # fmt: skip
            elif (
                max(sensor_params[sensor, MIN_ALTITUDE], min_altitude)
                <= altitude
                <= sensor_params[sensor, MAX_ALTITUDE]
            ):
                observe_nodes(
                    samples[0], samples[1], time_left, site, nodes, sensor, sharpness, visible,
                    displacement, reduction, sensor_params, known,
                )  # fmt: skip
        lowest_altitude = min(lowest_altitude, altitude)
        samples[2] = samples[0]
    return True


@kernel(shared=True)
def score(
    share, state, target, speed, plans, fine, coarse, powers, vehicle, max_final_tilt, site, nodes,
    sharpness, visible, displacement, reduction, sensor_params, single_altitudes, out,
):  # fmt: skip
    """Compute the information gained along each candidate path, and its delta-v.

    Parameters
    ----------
    share
        Index of the first path of this thread, and number of threads.
    state, target, speed
        Current position and velocity (2, 3), m and m/s; position (3,) and velocity (3,) at the end.
    plans
        Time-to-go, s, and acceleration at the end of each path, m/s^2 (n, 4).
    fine, coarse
        Tables of the path samples at which limits are checked, and at which sensors observe.
    powers, vehicle
        Powers of time-to-go of the paths (2,); parameters of the vehicle and limits (7,), as for
        `evaluate_path`.
    max_final_tilt
        Tangent of the maximum tilt of the thrust at the end, and below the minimum altitude of
        observations.
    site, single_altitudes
        Site and altitudes (5,), and altitudes of single observations (sensors, k), m, as for
        `observe_along_path`.
    nodes
        Terrain nodes (g, 6): position (m), weight, fraction of uncertainty already removed, and
        minimum time-to-go with which a lander on its way to the site can still divert there, s.
    sharpness, visible, displacement, reduction, sensor_params
        Tables and parameters of the sensors, from `SensorCoverageModel`.
    out
        Receives the results (n, 2): weighted mean over the nodes of the fraction of uncertainty
        removed, and delta-v, m/s; inf if a limit is violated.
    """
    total = 0.0
    for g in range(nodes.shape[0]):
        total += nodes[g, WEIGHT]
    end_state, x, found = np.empty((2, 3)), np.empty((2, 3)), np.empty(4)
    samples, known = np.empty((4, 3)), np.empty(nodes.shape[0])
    for n in range(share[0], plans.shape[0], share[1]):
        for k in range(3):
            end_state[0, k], end_state[1, k] = speed[k], plans[n, 1 + k]
        out[n, 0], out[n, 1] = 0.0, np.inf
        vertical_thrust = end_state[1, 2] + vehicle[GRAVITY]
        lateral_thrust = np.sqrt(end_state[1, 0] ** 2 + end_state[1, 1] ** 2)
        if (
            vertical_thrust <= 0.0
            or lateral_thrust > max_final_tilt * vertical_thrust
            or not plans[n, 0] > 0.0
        ):
            continue
        if not evaluate_path(
            state, target, end_state, plans[n, 0], fine, powers, vehicle, x, found
        ):
            continue
        for g in range(nodes.shape[0]):
            known[g] = nodes[g, KNOWN_FRACTION]
        if not observe_along_path(
            target,
            end_state,
            plans[n, 0],
            coarse,
            powers,
            x,
            vehicle[GRAVITY],
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
            known,
        ):
            continue
        out[n, 1] = found[0]
        mean = 0.0
        for g in range(nodes.shape[0]):
            mean += nodes[g, WEIGHT] * known[g]
        out[n, 0] = mean / total if total > 0.0 else 0.0
