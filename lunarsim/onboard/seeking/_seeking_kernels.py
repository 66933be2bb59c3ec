"""Compiled score of many paths: what would be known of the ground in reach, and what they take."""

from __future__ import annotations

import numpy as np

from lunarsim._jit import kernel
from lunarsim.onboard.guidance._kernels import GRAVITY, HIGH, LOW, SHARE, measure

# Columns of a node of the ground, and of an eye's figures.
EAST, NORTH, UP, WEIGHT, KNOWN, NEEDS = 0, 1, 2, 3, 4, 5
PIXEL, SHARPEST, FIELD, GIMBAL, LONGEST, HIGHEST, LOWEST, SUN_EAST, SUN_NORTH = range(9)


@kernel(inline=True)
def _told(sharp, open_, astray, told, eye, pixel, cosine, sine, distance):
    """Return the share of the uncertainty that a look takes away; see `eyes.Eye`."""
    last = sharp.shape[1] - 1
    u, v = 0.5 * last * (cosine + 1.0), last * sine
    i, j = min(max(int(u), 0), last - 1), min(max(int(v), 0), last - 1)
    u, v = u - i, v - j
    a, b, c, d = (1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v
    unit = (
        a * sharp[eye, i, j] + b * sharp[eye, i + 1, j]
        + c * sharp[eye, i, j + 1] + d * sharp[eye, i + 1, j + 1]
    )  # fmt: skip
    free = (
        a * open_[eye, i, j] + b * open_[eye, i + 1, j]
        + c * open_[eye, i, j + 1] + d * open_[eye, i + 1, j + 1]
    )  # fmt: skip
    off = (
        a * astray[eye, i, j] + b * astray[eye, i + 1, j]
        + c * astray[eye, i, j + 1] + d * astray[eye, i + 1, j + 1]
    )  # fmt: skip
    free *= np.exp(-off * distance * distance)
    most = told.shape[1] - 1
    at = unit / (distance * pixel) * most
    if at >= most:
        return free * told[eye, most]
    k = int(at)
    return free * (told[eye, k] + (at - k) * (told[eye, k + 1] - told[eye, k]))


@kernel(inner=True)
def look(place, pull, left, site, nodes, eye, sharp, open_, astray, told, figures, best):
    """Raise what is known of each node (g,) by a look from a place (3,) at the site (3,).

    `pull` (3,): direction in which the lander's axis points. Ground counts that could still be
    flown to with `left` seconds left.
    """
    bx, by, bz = site[0] - place[0], site[1] - place[1], site[2] - place[2]
    size = np.sqrt(bx * bx + by * by + bz * bz)
    if size == 0.0:
        return
    bx, by, bz = bx / size, by / size, bz / size
    axis = np.sqrt(pull[0] ** 2 + pull[1] ** 2 + pull[2] ** 2)
    if -(bx * pull[0] + by * pull[1] + bz * pull[2]) < figures[eye, GIMBAL] * axis:
        return
    pixel = figures[eye, PIXEL] * figures[eye, SHARPEST]
    for g in range(nodes.shape[0]):
        if left < nodes[g, NEEDS] or nodes[g, WEIGHT] <= 0.0:
            continue
        x, y, z = place[0] - nodes[g, EAST], place[1] - nodes[g, NORTH], place[2] - nodes[g, UP]
        level = np.sqrt(x * x + y * y)
        distance = np.sqrt(level * level + z * z)
        if z <= 0.0 or distance > figures[eye, LONGEST]:
            continue
        if -(x * bx + y * by + z * bz) < figures[eye, FIELD] * distance:
            continue
        cosine = 0.0
        if level > 0.0:
            cosine = (x * figures[eye, SUN_EAST] + y * figures[eye, SUN_NORTH]) / level
        share = _told(sharp, open_, astray, told, eye, pixel, cosine, z / distance, distance)
        best[g] = max(best[g], share)


@kernel(inner=True)
def along(target, asked, total, table, s, powers, x, gravity, place, pull):
    """Write place and thrust acceleration (3,) at sample s of a path; see `measure`."""
    low, high = table[s, LOW], table[s, HIGH]
    left = table[s, SHARE] * total
    f, g = low / (powers[0] + 2.0), high / (powers[1] + 2.0)
    d, e = (powers[0] + 1.0) * low, (powers[1] + 1.0) * high
    for k in range(3):
        half = 0.5 * asked[1, k] + x[0, k] * f + x[1, k] * g
        place[k] = target[k] + left * (left * half - asked[0, k])
        pull[k] = asked[1, k] + d * x[0, k] + e * x[1, k]
    pull[2] += gravity


@kernel(inner=True)
def seen(
    target, asked, total, table, powers, x, gravity, end_tilt, ground, nodes, sharp, open_, astray,
    told, figures, stations, at, best,
):  # fmt: skip
    """Raise what is known of each node (g,) by all looks along a path.

    Returns False where the thrust leans by more than `end_tilt` (a tangent) once looks no longer
    count.

    `ground` (5,): the site, the height of the centre of mass of a lander that stands there, and the
    altitude below which looks no longer count. `stations` (eyes, k): altitudes of single looks of
    each eye, NaN for none; without any it looks at every sample. `at` (4, 3) is scratch.
    """
    level, least = ground[3], ground[4]
    lowest = np.inf
    for s in range(table.shape[0]):
        along(target, asked, total, table, s, powers, x, gravity, at[0], at[1])
        altitude = at[0, 2] - level
        if altitude < least:
            lean = np.sqrt(at[1, 0] ** 2 + at[1, 1] ** 2)
            if lean > end_tilt * at[1, 2]:
                return False
        left = table[s, SHARE] * total
        for eye in range(figures.shape[0]):
            if not np.isnan(stations[eye, 0]):
                for k in range(stations.shape[1]):
                    h = stations[eye, k]
                    if s == 0 or not (lowest > h >= altitude) or h < least:
                        continue
                    # Where the path passes the altitude, between the last sample and this one.
                    part = (at[2, 2] - level - h) / max(at[2, 2] - at[0, 2], 1e-9)
                    part = min(max(part, 0.0), 1.0)
                    for i in range(3):
                        at[3, i] = at[2, i] + part * (at[0, i] - at[2, i])
                    look(
                        at[3], at[1], left, ground, nodes, eye, sharp, open_, astray, told,
                        figures, best,
                    )  # fmt: skip
            elif max(figures[eye, LOWEST], least) <= altitude <= figures[eye, HIGHEST]:
                look(
                    at[0], at[1], left, ground, nodes, eye, sharp, open_, astray, told, figures,
                    best,
                )  # fmt: skip
        lowest = min(lowest, altitude)
        at[2] = at[0]
    return True


@kernel(shared=True)
def score(
    share, state, target, speed, plans, fine, coarse, powers, vehicle, end_tilt, ground, nodes,
    sharp, open_, astray, told, figures, stations, out,
):  # fmt: skip
    """Write what paths would let the lander know, and what they take (n, 2).

    Parameters
    ----------
    state, target, speed
        Position and velocity now (2, 3); position (3,) and velocity (3,) at the end.
    plans
        Time-to-go and acceleration at the end of each path (n, 4).
    fine, coarse
        Tables of samples by which limits are checked, and from which looks are taken.
    powers, vehicle
        See `measure`.
    end_tilt
        Tangent of the greatest lean of the thrust once looks no longer count, and at the end.
    ground, stations
        See `seen`.
    nodes
        Of the ground (g, 6): place (m), weight, share known already, and least time-to-go with
        which a lander on its way to the site can still fly there, s.
    sharp, open_, astray, told, figures
        Of the eyes, see `eyes.Eye`.
    out
        Mean share known of the nodes, by weight, and increment, m/s: inf where a limit is broken.
    """
    total = 0.0
    for g in range(nodes.shape[0]):
        total += nodes[g, WEIGHT]
    asked, x, found = np.empty((2, 3)), np.empty((2, 3)), np.empty(4)
    at, best = np.empty((4, 3)), np.empty(nodes.shape[0])
    for n in range(share[0], plans.shape[0], share[1]):
        for k in range(3):
            asked[0, k], asked[1, k] = speed[k], plans[n, 1 + k]
        out[n, 0], out[n, 1] = 0.0, np.inf
        lift = asked[1, 2] + vehicle[GRAVITY]
        lean = np.sqrt(asked[1, 0] ** 2 + asked[1, 1] ** 2)
        if lift <= 0.0 or lean > end_tilt * lift or not plans[n, 0] > 0.0:
            continue
        if not measure(state, target, asked, plans[n, 0], fine, powers, vehicle, x, found):
            continue
        for g in range(nodes.shape[0]):
            best[g] = nodes[g, KNOWN]
        if not seen(
            target, asked, plans[n, 0], coarse, powers, x, vehicle[GRAVITY], end_tilt, ground,
            nodes, sharp, open_, astray, told, figures, stations, at, best,
        ):  # fmt: skip
            continue
        out[n, 1] = found[0]
        mean = 0.0
        for g in range(nodes.shape[0]):
            mean += nodes[g, WEIGHT] * best[g]
        out[n, 0] = mean / total if total > 0.0 else 0.0
