"""Legs that take up the energy of a touchdown, until the lander rests or has tipped.

A leg is a spring and a damper in series with a honeycomb that crushes at a constant force. Its pad
meets the highest ground under it, along the ground's normal there, and holds on to the point where
it touched until friction gives way. The ground does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.frames import quat_rotate, quat_to_matrix
from lunarsim.models.jet_lander import com_of
from lunarsim.models.lander import Lander
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.vehicle import _leg_kernels as k
from lunarsim.vehicle.dynamics import PLAIN_RIG, Dynamics
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import Ground, Verdict, judge_touchdown

Array = NDArray[np.float64]

# Step of the contact, s; steps between two looks at the lander; posting of the ground, m; how far
# the lander may slide on the ground that is looked up, m.
_STEP, _STEPS, _POSTING, _ROOM = 5e-4, 40, 0.05, 4.0
# At rest: slower than this (m/s and rad/s) for so long (s).
_SLOW, _SLOW_TURN, _REST = 0.01, 0.01, 0.4
# Beyond the angle at which the centre of mass stands over an edge, plus this, it has tipped, rad.
_TIPPED = np.deg2rad(20.0)


@dataclass(frozen=True)
class Legs:
    """Legs of spring, damper and crushing honeycomb; with them the motion gives the verdict.

    Attributes
    ----------
    stiffness, damping
        Of a leg along the ground's normal, and of a pad that holds on to the ground, N/m, N s/m.
    crush_force
        At which the honeycomb gives way, N.
    stroke
        Length that the honeycomb can crush before it is spent, m.
    friction
        Coefficient between pad and ground.
    max_time
        A lander that has neither come to rest nor tipped by then is unsettled, s.
    """

    stiffness: float = quantity(2e5, "N/m", gt=0, help="of a leg, and of a pad on the ground")
    damping: float = quantity(5e3, "N s/m", gt=0, help="of a leg, and of a pad on the ground")
    crush_force: float = quantity(1.2e4, "N", gt=0, help="at which the honeycomb gives way")
    stroke: float = quantity(0.2, "m", gt=0, help="by which the honeycomb can crush")
    friction: float = quantity(0.7, gt=0, le=3, help="between pad and ground")
    max_time: float = quantity(
        40.0, "s", gt=0, help="neither at rest nor tipped by then: unsettled"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "legs")


@dataclass(frozen=True)
class Rest:
    """What became of a lander on its legs.

    Attributes
    ----------
    state
        At the end.
    time
        From the touchdown on, s.
    tipped, settled
        Whether it fell over; whether it came to rest.
    tilt
        Of the body at the end, rad.
    strokes
        By which each leg gave way at most (legs,), m.
    crushed
        Of these what stays (legs,), m.
    energy
        That the legs took up, what their springs hold at the end included, J.
    clearance
        Least height of the belly above the ground at any look, m; NaN over unknown ground.
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

    def told(self) -> dict[str, object]:
        """Return plain figures for a record."""
        return {
            "rest_time_s": self.time, "rest_tilt_deg": float(np.rad2deg(self.tilt)),
            "leg_strokes_m": self.strokes, "leg_crushed_m": self.crushed,
            "leg_energy_j": self.energy, "belly_clearance_m": self.clearance,
        }  # fmt: skip


@dataclass
class Patch:
    """The ground about a touchdown: as it is, and the highest under a pad.

    Attributes
    ----------
    bare, padded
        Heights (rows, cols), m; NaN where unknown.
    frame
        East and north of post (0, 0) and the posting (3,), m.
    """

    bare: Array
    padded: Array
    frame: Array = field(repr=False)

    @classmethod
    def of(cls, lander: Lander, state: State, ground: Ground) -> Patch:
        """Look the ground up about where a lander touches down."""
        half = lander.leg_radius + lander.pad_diameter + lander.com_height + _ROOM
        n = int(np.ceil(half / _POSTING))
        axis = _POSTING * np.arange(-n, n + 1)
        x, y = state.position[0] + axis, state.position[1] + axis
        bare = np.asarray(ground.elevation(np.stack(np.meshgrid(x, y), axis=-1)), dtype=np.float64)
        # 0.15 over 0.05 is a little less than three.
        reach = int(np.floor(0.5 * lander.pad_diameter / _POSTING + 1e-9))
        disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach + 1e-9
        # Unknown ground stays unknown: it must not be taken for low.
        filled = np.where(np.isfinite(bare), bare, np.inf)
        padded = ndimage.maximum_filter(filled, footprint=disc, mode="nearest")
        padded[~np.isfinite(padded)] = np.nan
        return cls(bare, padded, np.array([x[0], y[0], _POSTING]))


def _clearance(lander: Lander, state: State, patch: Patch, shift: Array) -> float:
    """Return the least height of the belly's plane above the ground inside the legs (m)."""
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
    u, v = (x - patch.frame[0]) / _POSTING, (y - patch.frame[1]) / _POSTING
    ground = ndimage.map_coordinates(patch.bare, [v, u], order=1, cval=np.nan)
    plane = middle[2] - (lift[0] * (x - middle[0]) + lift[1] * (y - middle[1])) / lift[2]
    return float(np.min((plane - ground) * lift[2]) + lander.belly_clearance)


def settle(legs: Legs, dynamics: Dynamics, state: State, ground: Ground) -> Rest:
    """Return what becomes of a lander from its touchdown on, the engine off."""
    lander = dynamics.lander
    patch = Patch.of(lander, state, ground)
    shift = com_of(lander, state.mass)
    pads = np.ascontiguousarray(lander.pads - shift)
    law = np.array(
        [
            legs.stiffness, legs.damping, legs.crush_force, legs.friction,
            0.5 * lander.pad_diameter, legs.stroke,
        ]
    )  # fmt: skip
    y = state.as_vector()
    y[14] = 0.0
    held = np.zeros((lander.legs, 5))
    held[:, 2:] = np.nan
    edge = np.arctan2(lander.leg_radius * np.cos(np.pi / lander.legs), lander.com_height)
    time = energy = slow = 0.0
    strokes, clearance, tipped = np.zeros(lander.legs), np.inf, False
    rig, figures, inertia = PLAIN_RIG.copy(), dynamics.figures, dynamics.inertia
    while time < legs.max_time and slow < _REST and not tipped:
        energy += k.settle(
            y, _STEPS, _STEP, pads, held, law, patch.padded, patch.frame, figures, inertia, rig
        )
        time += _STEPS * _STEP
        now = State.from_vector(y)
        strokes = np.maximum(strokes, held[:, 0] + held[:, 1])
        clearance = min(clearance, _clearance(lander, now, patch, shift))
        quiet = np.linalg.norm(now.velocity) < _SLOW and np.linalg.norm(now.rate) < _SLOW_TURN
        standing = np.isfinite(held[:, 2]).sum() >= 3
        slow = slow + _STEPS * _STEP if quiet and standing else 0.0
        tipped = _tilt(now) > edge + _TIPPED
        if not np.isfinite(y).all() or y[2] < np.nanmin(patch.bare) - lander.com_height:
            break  # it has slid off the ground that is known
    end = State.from_vector(y)
    return Rest(
        end, time, tipped, slow >= _REST, _tilt(end), strokes, held[:, 0].copy(), energy, clearance
    )


def _tilt(state: State) -> float:
    return float(np.arccos(np.clip(quat_to_matrix(state.attitude)[2, 2], -1.0, 1.0)))


def judge_motion(
    legs: Legs, dynamics: Dynamics, state: State, ground: Ground
) -> tuple[Verdict, Rest | None]:
    """Judge a touchdown by what becomes of the lander.

    Limits are checked in this order: ``off-map``, ``tip-over``, ``unsettled``, ``legs`` (a leg's
    stroke is spent), ``belly`` (ground touched it), ``slope`` (it stands more tilted than the
    lander's slope limit). The touchdown's own figures are those of the static judgement.
    """
    lander = dynamics.lander
    static = judge_touchdown(lander, state, ground, dynamics.gravity)
    if "off-map" in static.failed:
        return static, None
    rest = settle(legs, dynamics, state, ground)
    checks = {
        "off-map": not np.isfinite(rest.clearance) and not rest.tipped,
        "tip-over": rest.tipped,
        "unsettled": not rest.settled and not rest.tipped,
        "legs": bool((rest.crushed >= legs.stroke).any()),
        "belly": rest.clearance <= 0.0,
        "slope": not rest.tipped and rest.tilt >= lander.slope_limit,
    }
    failed = tuple(name for name, bad in checks.items() if bad)
    return Verdict(not failed, failed, static.touchdown), rest
