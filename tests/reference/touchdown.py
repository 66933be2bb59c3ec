"""Static touchdown criteria from their definitions, on densely sampled terrain."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from tests.reference.safety import standing_planes

SPACING = 0.01


def _grid(low, high, spacing=SPACING):
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def contacts(lander, position, attitude, terrain):
    """Return the pads (n, 3): their centres, at the height of the highest terrain under them."""
    radius = 0.5 * lander.pad_diameter
    disc = _grid([-radius, -radius], [radius, radius])
    angle = np.linspace(0.0, 2.0 * math.pi, 200)
    rim = radius * np.column_stack((np.cos(angle), np.sin(angle)))
    disc = np.vstack((disc[np.hypot(*disc.T) <= radius], rim))
    legs = []
    for leg in range(lander.legs):
        # The first of four pads is 45 deg from body x, the first of three on body x.
        angle = 2.0 * math.pi * leg / lander.legs + (math.pi / 4 if lander.legs == 4 else 0.0)
        pad = [lander.leg_radius * math.cos(angle), lander.leg_radius * math.sin(angle),
               -lander.com_height]  # fmt: skip
        centre = position + Rotation.from_quat(attitude).apply(pad)
        legs.append([centre[0], centre[1], np.max(terrain.elevation(centre[:2] + disc))])
    return np.array(legs)


def samples_between_legs(legs, spacing):
    """Return the points of a grid inside the polygon of the legs; test every point of the grid."""
    (west, south), (east, north) = legs[:, :2].min(axis=0), legs[:, :2].max(axis=0)
    rows, cols = (
        math.ceil((high + spacing - low) / spacing) for low, high in ((south, north), (west, east))
    )
    y, x = (first + np.arange(n) * spacing for first, n in ((south, rows), (west, cols)))
    x, y = (grid.ravel() for grid in np.meshgrid(x, y))
    inside = np.ones(len(x), bool)
    for a, b in zip(legs, np.roll(legs, -1, axis=0), strict=True):
        inside &= (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
    return np.column_stack((x, y))[inside]


def slope_and_roughness(legs, terrain, spacing=SPACING):
    """Return the steepest slope (rad) of a plane on the legs, and the highest point above one."""
    points = _grid(legs[:, :2].min(axis=0), legs[:, :2].max(axis=0), spacing)
    # Inside a convex polygon the edges are seen under angles that add up to a full turn.
    turn = np.zeros(len(points))
    for k in range(len(legs)):
        a, b = legs[k - 1, :2] - points, legs[k, :2] - points
        turn += np.arctan2(
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]
        )
    points = points[np.abs(turn) > math.pi]
    z = terrain.elevation(points)
    slope = roughness = 0.0
    for z0, gx, gy in standing_planes(legs):
        normal = np.array([-gx, -gy, 1.0]) / np.linalg.norm([gx, gy, 1.0])
        slope = max(slope, math.atan(math.hypot(gx, gy)))
        above = np.column_stack((points, z - z0)) @ normal
        roughness = max(roughness, np.max(above)) if np.isfinite(above).all() else math.nan
    return slope, roughness


def tip_margin(lander, position, velocity, mass, legs, slope, gravity):
    """Return 1 - (energy of rotation about an edge / energy to lift the mass over it), least.

    The terrain slopes towards the edge. The lander keeps its angular momentum about the edge.
    """
    full = (mass - lander.dry_mass) / lander.propellant_mass
    inertia = min(
        (1.0 - full) * lander.inertia_dry[k] + full * lander.inertia_full[k] for k in (0, 1)
    )
    margins = []
    for k in range(len(legs)):
        a, b = legs[k - 1, :2] - position[:2], legs[k, :2] - position[:2]
        along = (b - a) / np.linalg.norm(b - a)
        to_edge = a - (a @ along) * along
        arm, height = np.linalg.norm(to_edge), lander.com_height
        # The centre of mass relative to the edge, in the vertical plane, turned by the slope.
        centre = Rotation.from_euler("z", -slope).apply([-arm, height, 0.0])
        if centre[0] >= 0.0:
            return -math.inf
        lift = math.hypot(arm, height) - centre[1]
        speed = max(0.0, velocity[:2] @ to_edge / arm)
        about_edge = inertia + mass * (arm**2 + height**2)
        rate = mass * speed * height / about_edge
        margins.append(1.0 - 0.5 * about_edge * rate**2 / (mass * gravity * lift))
    return min(margins)


def motion(state):
    """Return speeds, tilt and rate at contact by name."""
    up = Rotation.from_quat(state.attitude).apply([0.0, 0.0, 1.0])
    return {
        "vertical_speed": -state.velocity[2],
        "horizontal_speed": math.hypot(state.velocity[0], state.velocity[1]),
        "tilt": math.atan2(math.hypot(up[0], up[1]), up[2]),
        "rate": np.linalg.norm(state.rate),
    }


def values(lander, state, terrain, gravity):
    """Return all values that the criteria use, by name; NaN where the terrain is unknown."""
    legs = contacts(lander, state.position, state.attitude, terrain)
    slope = roughness = margin = math.nan
    if np.isfinite(legs).all():
        slope, roughness = slope_and_roughness(legs, terrain)
    if math.isfinite(roughness):
        margin = tip_margin(
            lander, state.position, state.velocity, state.mass, legs, slope, gravity
        )
    terms = {"slope": slope, "roughness": roughness, "tip_margin": margin}
    return motion(state) | terms


def causes(lander, found):
    """Return the violated limits for values of a touchdown, in the order of the documentation."""
    broken = {
        "off-map": not math.isfinite(found["roughness"]),
        "vertical-speed": found["vertical_speed"] > lander.vertical_speed_limit,
        "horizontal-speed": found["horizontal_speed"] > lander.horizontal_speed_limit,
        "tilt": found["tilt"] > lander.tilt_limit,
        "rate": found["rate"] > lander.rate_limit,
        "slope": found["slope"] >= lander.slope_limit,
        "roughness": found["roughness"] >= lander.roughness_limit,
        "belly": found["roughness"] >= lander.belly_clearance,
        "tip-over": found["tip_margin"] < 0.0,
    }
    return tuple(cause for cause, is_broken in broken.items() if is_broken)
