"""Touchdown dynamics on legs, until the lander rests or tips over.

A leg is a spring and a damper in series with a honeycomb that crushes at a constant force. Its pad
contacts the highest terrain under it, along the local terrain normal. It sticks to its contact
point until friction is exceeded. The terrain is rigid.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from lunarsim.frames import quat_rotate, quat_to_matrix
from lunarsim.models.lander import Lander
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.vehicle import _leg_kernels as k
from lunarsim.vehicle.dynamics import PLAIN_RIG, Dynamics
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import ElevationModel, LandingOutcome, evaluate_touchdown

# Contact step, s; steps between evaluations of the lander; terrain posting, m; margin of the
# terrain patch for sliding, m.
_STEP_S, _STEPS_PER_CHECK, _POSTING_M, _SLIDE_MARGIN_M = 5e-4, 40, 0.05, 4.0
# Maximum speed (m/s) and rate (rad/s) at rest, and their minimum duration (s).
_REST_SPEED_M_S, _REST_RATE_RAD_S, _REST_TIME_S = 0.01, 0.01, 0.4
# Margin on the tilt at which the centre of mass is over an edge, to declare a tip-over, rad.
_TIP_OVER_MARGIN_RAD = np.deg2rad(20.0)


@dataclass(frozen=True)
class Legs:
    """Settings of landing legs: spring, damper and crushable honeycomb.

    Attributes
    ----------
    stiffness, damping
        Stiffness and damping of each leg along the terrain normal, N/m, N s/m. A sticking pad has
        the same values parallel to the terrain.
    crush_force
        Crush force of the honeycomb, N.
    stroke
        Maximum crush length of the honeycomb, m.
    friction
        Friction coefficient of pad and terrain.
    max_time
        Time limit, s, for coming to rest or tipping over; later the lander counts as unsettled.
    """

    stiffness: float = quantity(
        2e5,
        "N/m",
        gt=0,
        help="stiffness of each leg along the terrain normal; its pad has the same stiffness "
        "along the terrain surface until it slides",
    )
    damping: float = quantity(
        5e3,
        "N s/m",
        gt=0,
        help="damping of each leg along the terrain normal; its pad has the same damping along the "
        "terrain surface until it slides",
    )
    crush_force: float = quantity(
        1.2e4, "N", gt=0, help="force at which the honeycomb of a leg is crushed"
    )
    stroke: float = quantity(
        0.2, "m", gt=0, help="maximum length by which the honeycomb of a leg can be crushed"
    )
    friction: float = quantity(
        0.7, gt=0, le=3, help="friction coefficient between pads and terrain"
    )
    max_time: float = quantity(
        40.0,
        "s",
        gt=0,
        help="time after first contact within which the lander must come to rest or tip over; "
        "otherwise it counts as unsettled",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "legs")


@dataclass(frozen=True)
class RestState:
    """Final state and leg loads of a lander after touchdown.

    Attributes
    ----------
    state
        Final state.
    time
        Time since touchdown, s.
    tipped, settled
        Whether the lander tipped over; whether the lander came to rest.
    tilt
        Final tilt of the body, rad.
    strokes
        Maximum compression of each leg (legs,), m.
    crushed
        Permanent part of the compression (legs,), m.
    energy
        Energy absorbed by the legs, including final spring energy, J.
    clearance
        Minimum height of the belly above the terrain, m; NaN over unknown terrain.
    """

    state: State
    time: float
    tipped: bool
    settled: bool
    tilt: float
    strokes: Array
    crushed: Array
    energy: float
    clearance: float

    def record_values(self) -> dict[str, object]:
        """Return the values to store in the record of a flight, by column name."""
        return {
            "rest_time_s": self.time, "rest_tilt_deg": float(np.rad2deg(self.tilt)),
            "leg_strokes_m": self.strokes, "leg_crushed_m": self.crushed,
            "leg_energy_j": self.energy, "belly_clearance_m": self.clearance,
        }  # fmt: skip


@dataclass
class TerrainPatch:
    """Terrain raster around a touchdown, with the maximum height under a pad.

    Attributes
    ----------
    heights, pad_heights
        Terrain heights, and their maximum over the disc of a pad (rows, cols), m; NaN if unknown.
    frame
        East and north of grid point (0, 0), and the grid spacing (3,), m.
    """

    heights: Array
    pad_heights: Array
    frame: Array = field(repr=False)

    @classmethod
    def of(cls, lander: Lander, state: State, terrain: ElevationModel) -> TerrainPatch:
        """Sample the terrain around a lander at touchdown."""
        half = lander.leg_radius + lander.pad_diameter + lander.com_height + _SLIDE_MARGIN_M
        n = int(np.ceil(half / _POSTING_M))
        axis = _POSTING_M * np.arange(-n, n + 1)
        x, y = state.position[0] + axis, state.position[1] + axis
        heights = np.asarray(
            terrain.elevation(np.stack(np.meshgrid(x, y), axis=-1)), dtype=np.float64
        )
        # Floating point: 0.15 / 0.05 is slightly less than 3.
        reach = int(np.floor(0.5 * lander.pad_diameter / _POSTING_M + 1e-9))
        disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach + 1e-9
        # Unknown terrain stays unknown; it must not count as low.
        filled = np.where(np.isfinite(heights), heights, np.inf)
        pad_heights = ndimage.maximum_filter(filled, footprint=disc, mode="nearest")
        pad_heights[~np.isfinite(pad_heights)] = np.nan
        return cls(heights, pad_heights, np.array([x[0], y[0], _POSTING_M]))


def _belly_clearance(lander: Lander, state: State, patch: TerrainPatch, shift: Array) -> float:
    """Return the minimum height, m, of the lander's underside above the terrain.

    `patch` is the terrain, and `shift` (3,) the centre of mass from the body's origin, m. NaN for a
    strongly tilted lander or unknown terrain.
    """
    pads = state.position + quat_rotate(state.attitude, lander.pads - shift)
    lift = quat_to_matrix(state.attitude)[:, 2]
    if lift[2] < 0.3:
        return float("nan")
    rows = np.linspace(pads[:, 1].min(), pads[:, 1].max(), 13)
    cols = np.linspace(pads[:, 0].min(), pads[:, 0].max(), 13)
    x, y = (v.ravel() for v in np.meshgrid(cols, rows))
    middle = pads.mean(axis=0)
    inside = np.hypot(x - middle[0], y - middle[1]) <= lander.leg_radius * np.cos(
        np.pi / lander.legs
    )
    x, y = x[inside], y[inside]
    u, v = (x - patch.frame[0]) / _POSTING_M, (y - patch.frame[1]) / _POSTING_M
    terrain = ndimage.map_coordinates(patch.heights, [v, u], order=1, cval=np.nan)
    plane = middle[2] - (lift[0] * (x - middle[0]) + lift[1] * (y - middle[1])) / lift[2]
    return float(np.min((plane - terrain) * lift[2]) + lander.belly_clearance)


def settle(legs: Legs, dynamics: Dynamics, state: State, terrain: ElevationModel) -> RestState:
    """Simulate a lander on its legs from touchdown to rest or tip-over, engine off.

    `state` is the state at touchdown. The simulation also ends after `legs.max_time` and beyond the
    known terrain. Returns the final state and the loads of the legs.
    """
    lander = dynamics.lander
    patch = TerrainPatch.of(lander, state, terrain)
    shift = lander.com(state.mass)
    pads = np.ascontiguousarray(lander.pads - shift)
    law = np.array(
        [
            legs.stiffness, legs.damping, legs.crush_force, legs.friction,
            0.5 * lander.pad_diameter, legs.stroke,
        ]
    )  # fmt: skip
    y = state.as_vector()
    y[14] = 0.0
    leg_states = np.zeros((lander.legs, 5))
    leg_states[:, 2:] = np.nan
    arm = lander.leg_radius * np.cos(np.pi / lander.legs) + float(np.hypot(*shift[:2]))
    edge = np.arctan2(arm, lander.com_height + shift[2])
    time = energy = slow = 0.0
    strokes, clearance, tipped = np.zeros(lander.legs), np.inf, False
    rig, figures, inertia = PLAIN_RIG.copy(), dynamics.params, dynamics.inertia
    while time < legs.max_time and slow < _REST_TIME_S and not tipped:
        energy += k.settle(
            y,
            _STEPS_PER_CHECK,
            _STEP_S,
            pads,
            leg_states,
            law,
            patch.pad_heights,
            patch.frame,
            figures,
            inertia,
            rig,
        )
        time += _STEPS_PER_CHECK * _STEP_S
        now = State.from_vector(y)
        strokes = np.maximum(strokes, leg_states[:, 0] + leg_states[:, 1])
        clearance = min(clearance, _belly_clearance(lander, now, patch, shift))
        is_slow = (
            np.linalg.norm(now.velocity) < _REST_SPEED_M_S
            and np.linalg.norm(now.rate) < _REST_RATE_RAD_S
        )
        is_standing = np.isfinite(leg_states[:, 2]).sum() >= 3
        slow = slow + _STEPS_PER_CHECK * _STEP_S if is_slow and is_standing else 0.0
        tipped = _tilt(now) > edge + _TIP_OVER_MARGIN_RAD
        if not np.isfinite(y).all() or y[2] < np.nanmin(patch.heights) - lander.com_height:
            break  # the lander has left the known terrain
    end = State.from_vector(y)
    return RestState(
        end,
        time,
        tipped,
        slow >= _REST_TIME_S,
        _tilt(end),
        strokes,
        leg_states[:, 0].copy(),
        energy,
        clearance,
    )


def _tilt(state: State) -> float:
    """Return the angle between body z and the vertical, rad."""
    return float(np.arccos(np.clip(quat_to_matrix(state.attitude)[2, 2], -1.0, 1.0)))


def evaluate_motion(
    legs: Legs, dynamics: Dynamics, state: State, terrain: ElevationModel
) -> tuple[LandingOutcome, RestState | None]:
    """Determine the landing outcome by simulating the motion after touchdown.

    Limits are checked in this order: ``off-map``, ``tip-over``, ``unsettled``, ``legs`` (a leg's
    stroke is used up), ``belly`` (the underside touched the terrain), ``slope`` (the final tilt
    exceeds the lander's slope limit). The values at touchdown are those of `evaluate_touchdown`.
    Returns the outcome, and the final state with the loads of the legs, which is None if the
    terrain at touchdown is unknown.
    """
    lander = dynamics.lander
    static = evaluate_touchdown(lander, state, terrain, dynamics.gravity)
    if "off-map" in static.failure_causes:
        return static, None
    rest = settle(legs, dynamics, state, terrain)
    checks = {
        "off-map": not np.isfinite(rest.clearance) and not rest.tipped,
        "tip-over": rest.tipped,
        "unsettled": not rest.settled and not rest.tipped,
        "legs": bool((rest.crushed >= legs.stroke).any()),
        "belly": rest.clearance <= 0.0,
        "slope": not rest.tipped and rest.tilt >= lander.slope_limit,
    }
    failed = tuple(name for name, bad in checks.items() if bad)
    return LandingOutcome(not failed, failed, static.touchdown), rest
