"""Touchdown evaluated with NumPy: support planes, slope, roughness, tip-over, limits."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from lunarsim.frames import quat_to_matrix
from lunarsim.vehicle.touchdown import TERRAIN_SAMPLE_SPACING_M, pad_contacts


def support_planes(legs):
    """Return the planes on which a lander can stand, each ``(z0, dz/dx, dz/dy)``.

    There is one plane for three legs, and two planes for four legs.
    A three-legged lander stands on its three pads. A rigid four-legged lander stands on the higher
    of its two diagonals and one of the other legs, which gives two planes.

    Parameters
    ----------
    legs
        Contact points of the pads in order around the lander (3 or 4, 3), m.

    Examples
    --------
    >>> feet = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.1], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.1]])
    >>> len(support_planes(feet))  # stands on the two high legs and tips to either side
    2
    """
    if len(legs) == 3:
        triples = [(0, 1, 2)]
    elif legs[0, 2] + legs[2, 2] >= legs[1, 2] + legs[3, 2]:
        triples = [(0, 1, 2), (0, 2, 3)]
    else:
        triples = [(0, 1, 3), (1, 2, 3)]
    planes = []
    for triple in triples:
        points = legs[list(triple)]
        design = np.column_stack((np.ones(3), points[:, :2]))
        planes.append(np.asarray(np.linalg.solve(design, points[:, 2]), dtype=np.float64))
    return planes


def _inside_polygon(points, polygon):
    """Return which points (n, 2) lie in a convex counter-clockwise polygon (k, 2)."""
    inside = np.ones(len(points), dtype=np.bool_)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        cross = (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0])
        inside &= cross >= 0.0
    return inside


def fit_terrain_plane(lander, legs, terrain):
    """Return slope (rad) and roughness (m) of the terrain under a standing lander.

    `legs` (n, 3) are contact points of the pads, m. The values follow Eqs. 8 and 9 of the Gaussian
    DEM paper, as maxima over the planes on which the lander can stand.
    """
    low, high = legs[:, :2].min(axis=0), legs[:, :2].max(axis=0)
    axes = [
        np.arange(a, b + TERRAIN_SAMPLE_SPACING_M, TERRAIN_SAMPLE_SPACING_M)
        for a, b in zip(low, high, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    points = points[_inside_polygon(points, legs[:, :2])]
    z = terrain.elevation(points)
    slope = roughness = 0.0
    for z0, gx, gy in support_planes(legs):
        plane_norm = np.hypot(1.0, np.hypot(gx, gy))
        slope = max(slope, float(np.arccos(1.0 / plane_norm)))
        height = (z - z0 - points @ np.array([gx, gy])) / plane_norm
        roughness = float(np.maximum(roughness, height.max(initial=0.0)))  # NaN where unknown
    return slope, roughness


def tip_margin(lander, state, legs, slope, gravity):
    """Return the tip-over margin of a touchdown; negative: the lander tips over.

    The margin is the minimum of 1 - E / E_tip over the edges between adjacent legs: the lander
    hits the edge and rotates about the edge with its angular momentum. The lander tips over if its
    kinetic energy E exceeds E_tip, which lifts the centre of mass over the edge. `legs` (n, 3) are
    contact points, m, and `slope` is that of the terrain, rad. As a worst case, the terrain
    slopes towards every edge, and the smaller lateral moment of inertia applies to every edge.
    """
    polygon = legs[:, :2] - state.position[:2]
    full = (state.mass - lander.dry_mass) / lander.propellant_mass
    inertia = np.asarray(lander.inertia_dry) + full * (
        np.asarray(lander.inertia_full) - np.asarray(lander.inertia_dry)
    )
    margin = np.inf
    for i, j in combinations(range(lander.legs), 2):
        if (j - i) % lander.legs not in (1, lander.legs - 1):
            continue  # a diagonal is not an edge
        edge = polygon[j] - polygon[i]
        normal = np.array([edge[1], -edge[0]]) / np.linalg.norm(edge)
        arm = float(normal @ polygon[i])
        if arm < 0.0:
            normal, arm = -normal, -arm
        tip_angle = np.arctan2(arm, lander.com_height) - slope
        if tip_angle <= 0.0:
            return -np.inf
        length = np.hypot(arm, lander.com_height)
        barrier = state.mass * gravity * length * (1.0 - np.cos(tip_angle))
        inertia_about_edge = min(inertia[0], inertia[1]) + state.mass * length**2
        momentum = state.mass * max(0.0, float(normal @ state.velocity[:2])) * lander.com_height
        margin = min(margin, 1.0 - 0.5 * momentum**2 / inertia_about_edge / barrier)
    return float(margin)


def touchdown_values(lander, state, terrain, gravity):
    """Return speeds, tilt, rate, slope, roughness and tip margin, and the violated limits."""
    legs = pad_contacts(lander, state, terrain)
    known = bool(np.isfinite(legs).all())
    slope, roughness = fit_terrain_plane(lander, legs, terrain) if known else (np.nan, np.nan)
    known = known and bool(np.isfinite(roughness))
    values = {
        "vertical-speed": float(-state.velocity[2]),
        "horizontal-speed": float(np.hypot(*state.velocity[:2])),
        "tilt": float(np.arccos(np.clip(quat_to_matrix(state.attitude)[2, 2], -1.0, 1.0))),
        "rate": float(np.linalg.norm(state.rate)),
    }
    limits = (
        lander.vertical_speed_limit, lander.horizontal_speed_limit, lander.tilt_limit,
        lander.rate_limit,
    )  # fmt: skip
    margin = tip_margin(lander, state, legs, slope, gravity) if known else np.nan
    checks = {"off-map": not known}
    checks |= {name: values[name] > limit for name, limit in zip(values, limits, strict=True)}
    checks |= {
        "slope": slope >= lander.slope_limit,
        "roughness": roughness >= lander.roughness_limit,
        "belly": roughness >= lander.belly_clearance,
        "tip-over": margin < 0.0,
    }
    failed = tuple(name for name, violated in checks.items() if violated)
    return (*values.values(), slope, roughness, margin), failed
