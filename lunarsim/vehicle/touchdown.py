"""Touchdown: pad contacts on the true terrain, and the landing outcome."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.core import touchdown as core
from lunarsim.frames import quat_rotate
from lunarsim.models.lander import Lander
from lunarsim.typing import Array
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


_VALUE_FIELDS = {f.name for f in fields(Touchdown)} - {"position", "heading"}
if set(core.VALUES) != _VALUE_FIELDS:
    raise TypeError(f"Touchdown must have the fields {', '.join(core.VALUES)}")

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
    pads = lander.pads - lander.com(state.mass)
    centres = state.position + quat_rotate(state.attitude, pads)
    spots = centres[:, None, :2] + pad_disc(0.5 * lander.pad_diameter)
    return np.column_stack((centres[:, :2], terrain.elevation(spots).max(axis=1)))


def min_touchdown_margin(lander: Lander, touchdown: Touchdown) -> float:
    """Return the minimum of 1 - value / limit over all limits of a touchdown.

    1: at rest on flat terrain; 0: at a limit; negative: `evaluate_touchdown` reports a violation;
    NaN: unknown terrain.
    """
    margins = [
        1.0 - getattr(touchdown, limit.value) / getattr(lander, limit.limit)
        for limit in core.LIMITS
    ]
    return float(np.min([*margins, touchdown.tip_margin]))  # NaN if one is


def evaluate_touchdown(
    lander: Lander, state: State, terrain: ElevationModel, gravity: float
) -> LandingOutcome:
    """Determine the landing outcome from the state at touchdown and the true terrain.

    Limits are checked in the order of `core.touchdown.CAUSES`: ``off-map`` is unknown terrain, and
    ``belly`` is terrain above the belly clearance.
    """
    legs = pad_contacts(lander, state, terrain)
    points, heights = np.empty((0, 2)), np.empty(0)
    if np.isfinite(legs).all():
        points = core.samples_between_legs(legs, TERRAIN_SAMPLE_SPACING_M)
        heights = np.asarray(terrain.elevation(points), dtype=np.float64)
    values = np.empty(len(core.VALUES))
    params = touchdown_params(lander, gravity)
    params = params._replace(com_height=params.com_height + float(lander.com(state.mass)[2]))
    failed = core.evaluate_touchdown(state.as_vector(), legs, points, heights, params, values)
    forward = quat_rotate(state.attitude, [1.0, 0.0, 0.0])
    heading = float(np.arctan2(forward[0], forward[1]))
    named = dict(zip(core.VALUES, map(float, values), strict=True))
    touchdown = Touchdown(state.position, heading, **named)
    return LandingOutcome(not failed, violated_limits(failed), touchdown)


def touchdown_params(lander: Lander, gravity: float) -> core.TouchdownParams:
    """Return the parameters of a lander and gravity (m/s^2) for `core.touchdown`."""
    limits = np.array([float(getattr(lander, limit.limit)) for limit in core.LIMITS])
    return core.TouchdownParams(
        limits, float(lander.com_height), float(gravity), float(lander.dry_mass),
        float(lander.wet_mass), np.array([lander.inertia_dry, lander.inertia_full]),
    )  # fmt: skip


def violated_limits(failed: int) -> tuple[str, ...]:
    """Return the names of the violated limits, the bits of `failed`.

    `failed` is the result of `core.touchdown.evaluate_touchdown`; 0 gives an empty tuple.
    """
    return tuple(name for bit, name in enumerate(core.CAUSES) if failed >> bit & 1)
