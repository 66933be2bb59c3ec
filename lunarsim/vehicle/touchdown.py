"""Touchdown: pad contacts on the true terrain, and the landing outcome."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import quat_rotate, quat_to_matrix
from lunarsim.models.jet_lander import centre_of_mass
from lunarsim.models.lander import Lander
from lunarsim.typing import Array, BoolArray
from lunarsim.vehicle.state import State

# Spacing of terrain samples under pads and belly, m.
TERRAIN_SAMPLE_SPACING_M = 0.04


class ElevationModel(Protocol):
    """Interface of a terrain that returns elevations."""

    def elevation(self, xy: ArrayLike) -> Array:
        """Return the elevation (...,), m, at points (..., 2), m; NaN where unknown."""
        ...


@dataclass(frozen=True)
class Touchdown:
    """Motion of the lander and terrain under its legs at the first pad contact.

    Attributes
    ----------
    position
        Centre of mass, ENU (3,), m.
    heading
        Azimuth of body x, rad.
    vertical_speed, horizontal_speed
        Downward and horizontal speed, m/s.
    tilt, rate
        Tilt (rad) and angular rate (rad/s) of the body.
    slope
        Slope of the steepest plane on which the lander can stand, rad.
    roughness
        Maximum height of the terrain above such a plane, inside the polygon of the legs, m.
    tip_margin
        1 - (energy of rotation over the downhill legs) / (energy needed to tip over); negative if
        the lander tips over.
    """

    position: Array
    heading: float
    vertical_speed: float
    horizontal_speed: float
    tilt: float
    rate: float
    slope: float
    roughness: float
    tip_margin: float


# Landing outcome of an aborted flight, which is neither a landing nor a crash.
ABORTED = "aborted"


@dataclass(frozen=True)
class LandingOutcome:
    """Landing outcome: safe or not, and the violated limits.

    Attributes
    ----------
    safe
        Whether no limit is violated.
    failure_causes
        Names of the violated limits, in the order of the checks.
    touchdown
        Touchdown, or None if there was none (time or propellant ran out).
    """

    safe: bool
    failure_causes: tuple[str, ...]
    touchdown: Touchdown | None


def support_planes(legs: Array) -> list[Array]:
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


def pad_disc(radius: float) -> Array:
    """Return sample points (n, 2), m, of a landing pad, including centre and rim.

    `radius` is the radius of the pad, m.
    """
    n = int(np.ceil(radius / TERRAIN_SAMPLE_SPACING_M))
    axis = np.linspace(-radius, radius, 2 * n + 1)
    xy = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    angle = np.linspace(0.0, 2.0 * np.pi, max(8, 4 * n), endpoint=False)
    rim = radius * np.column_stack((np.cos(angle), np.sin(angle)))
    return np.concatenate((xy[np.hypot(xy[:, 0], xy[:, 1]) < radius], rim))


def pad_contacts(lander: Lander, state: State, terrain: ElevationModel) -> Array:
    """Return the contact points of the pads (legs, 3), ENU, m.

    Each contact point has the position of the pad's centre and the height of the highest terrain
    under the pad.
    """
    pads = lander.pads - centre_of_mass(lander, state.mass)
    centres = state.position + quat_rotate(state.attitude, pads)
    spots = centres[:, None, :2] + pad_disc(0.5 * lander.pad_diameter)
    return np.column_stack((centres[:, :2], terrain.elevation(spots).max(axis=1)))


def _inside_polygon(points: Array, polygon: Array) -> BoolArray:
    """Return which points (n, 2) lie in a convex counter-clockwise polygon (k, 2)."""
    inside = np.ones(len(points), dtype=np.bool_)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        cross = (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0])
        inside &= cross >= 0.0
    return inside


def fit_terrain_plane(lander: Lander, legs: Array, terrain: ElevationModel) -> tuple[float, float]:
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


def tip_margin(lander: Lander, state: State, legs: Array, slope: float, gravity: float) -> float:
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


def min_touchdown_margin(lander: Lander, touchdown: Touchdown) -> float:
    """Return the minimum of 1 - value / limit over all limits of a touchdown.

    1: at rest on flat terrain; 0: at a limit; negative: `evaluate_touchdown` reports a violation;
    NaN: unknown terrain.
    """
    t = touchdown
    margins = (
        1.0 - t.vertical_speed / lander.vertical_speed_limit,
        1.0 - t.horizontal_speed / lander.horizontal_speed_limit,
        1.0 - t.tilt / lander.tilt_limit,
        1.0 - t.rate / lander.rate_limit,
        1.0 - t.slope / lander.slope_limit,
        1.0 - t.roughness / min(lander.roughness_limit, lander.belly_clearance),
        t.tip_margin,
    )
    return float(np.min(margins))  # NaN if one is


def evaluate_touchdown(
    lander: Lander, state: State, terrain: ElevationModel, gravity: float
) -> LandingOutcome:
    """Determine the landing outcome from the state at touchdown and the true terrain.

    Limits are checked in this order: ``off-map`` (unknown terrain), ``vertical-speed``,
    ``horizontal-speed``, ``tilt``, ``rate``, ``slope``, ``roughness``, ``belly`` (terrain above the
    belly clearance), ``tip-over``.
    """
    legs = pad_contacts(lander, state, terrain)
    up = quat_to_matrix(state.attitude)[2, 2]
    known = bool(np.isfinite(legs).all())
    slope, roughness = fit_terrain_plane(lander, legs, terrain) if known else (np.nan, np.nan)
    forward = quat_rotate(state.attitude, [1.0, 0.0, 0.0])
    known = known and bool(np.isfinite(roughness))
    touchdown = Touchdown(
        position=state.position,
        heading=float(np.arctan2(forward[0], forward[1])),
        vertical_speed=float(-state.velocity[2]),
        horizontal_speed=float(np.hypot(*state.velocity[:2])),
        tilt=float(np.arccos(np.clip(up, -1.0, 1.0))),
        rate=float(np.linalg.norm(state.rate)),
        slope=slope,
        roughness=roughness,
        tip_margin=tip_margin(lander, state, legs, slope, gravity) if known else np.nan,
    )
    checks = {
        "off-map": not known,
        "vertical-speed": touchdown.vertical_speed > lander.vertical_speed_limit,
        "horizontal-speed": touchdown.horizontal_speed > lander.horizontal_speed_limit,
        "tilt": touchdown.tilt > lander.tilt_limit,
        "rate": touchdown.rate > lander.rate_limit,
        "slope": slope >= lander.slope_limit,
        "roughness": roughness >= lander.roughness_limit,
        "belly": roughness >= lander.belly_clearance,
        "tip-over": touchdown.tip_margin < 0.0,
    }
    failed = tuple(name for name, bad in checks.items() if bad)
    return LandingOutcome(not failed, failed, touchdown)
