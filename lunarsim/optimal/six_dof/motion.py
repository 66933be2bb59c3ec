"""Simulator's equations of motion over one control interval, for CasADi.

The equations are those of `lunarsim.vehicle.dynamics.Dynamics`, without thruster forces and round
Moon, in scaled units (`Units`), so that one compiled program serves every lander and descent.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi
import numpy as np

from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.units import Units
from lunarsim.typing import Array

STATES, CONTROLS = 15, 4
# Fractions of an interval for its integration steps: the engine responds within the first ones.
SHARES = (0.06, 0.10, 0.17, 0.27, 0.40)
_LEAST_LAG = 1e-6  # s; the lag is a divisor


def state_units(units: Units) -> Array:
    """Return the scales by which the 15 variables of a state vector are divided."""
    u = units
    return np.array(
        [u.length] * 3 + [u.speed] * 3 + [1.0] * 4 + [1.0 / u.time] * 3 + [u.mass, u.force]
    )


def control_units(units: Units) -> Array:
    """Return the scales by which thrust and torques are divided (4,)."""
    return np.array([units.force] + [units.force * units.length] * 3)


def vehicle_parameters(descent: RigidDescent, units: Units) -> Array:
    """Return the vehicle parameters of the equations of motion (11,), without units.

    They are gravity, exhaust velocity, time constant of the engine, dry and initial mass, and the
    three principal moments of inertia with empty and with full tanks, divided by `units`.
    """
    v = descent.lander
    moment = units.mass * units.length**2
    return np.concatenate(
        (
            [
                descent.gravity * units.time**2 / units.length,
                v.exhaust_velocity / units.speed,
                max(v.thrust_lag, _LEAST_LAG) / units.time,
                v.dry_mass / units.mass,
                v.wet_mass / units.mass,
            ],
            np.asarray(v.inertia_dry) / moment,
            np.asarray(v.inertia_full) / moment,
        )
    )


def _rates(y: Any, thrust: Any, torque: Any, p: Any) -> Any:
    """Return d/dt of position, velocity, attitude, rate and mass (14,).

    All are scaled CasADi expressions: `y` is the state, `thrust` acts along body z, `torque` (3,)
    about the body axes, and `p` is from `vehicle_parameters`.
    """
    qx, qy, qz, qw = (y[6 + k] for k in range(4))
    w = y[10:13]
    push = thrust / y[13]
    up = casadi.vertcat(
        2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
    )
    turn = 0.5 * casadi.vertcat(
        qw * w[0] + qy * w[2] - qz * w[1],
        qw * w[1] + qz * w[0] - qx * w[2],
        qw * w[2] + qx * w[1] - qy * w[0],
        -(qx * w[0] + qy * w[1] + qz * w[2]),
    )
    full = (y[13] - p[3]) / (p[4] - p[3])
    moments = p[5:8] + full * (p[8:11] - p[5:8])
    spin = (torque - casadi.cross(w, moments * w)) / moments
    down = casadi.vertcat(0.0, 0.0, -p[0])
    return casadi.vertcat(y[3:6], push * up + down, turn, spin, -thrust / p[1])


@cache
def interval_function() -> Any:
    """Return a CasADi function that propagates a state over one control interval.

    It maps state, control, length and parameters to the states after each Runge-Kutta step (15, 5).
    The thrust of a step is the mean response of the engine's lag to the command.
    """
    x, u = casadi.SX.sym("x", STATES), casadi.SX.sym("u", CONTROLS)
    length, p = casadi.SX.sym("h"), casadi.SX.sym("p", 11)
    y, torque = x[:14], u[1:]
    elapsed, left, out = 0.0, x[14] - u[0], []
    for share in SHARES:
        h = share * length
        after = (x[14] - u[0]) * casadi.exp(-(elapsed + share) * length / p[2])
        thrust = u[0] + (left - after) * p[2] / h
        k1 = _rates(y, thrust, torque, p)
        k2 = _rates(y + 0.5 * h * k1, thrust, torque, p)
        k3 = _rates(y + 0.5 * h * k2, thrust, torque, p)
        k4 = _rates(y + h * k3, thrust, torque, p)
        y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        elapsed, left = elapsed + share, after
        out.append(casadi.vertcat(y, u[0] + after))
    return casadi.Function(
        "interval", [x, u, length, p], [casadi.horzcat(*out)], ["x", "u", "h", "p"], ["states"]
    )


@cache
def limit_function() -> Any:
    """Return a CasADi function that evaluates the path constraints at a state.

    It maps state and `limit_parameters` to four values, which are 0 or more if the constraint
    holds: tilt, rate, glideslope and sight of the site. Positions are relative to the end.
    """
    x, p = casadi.SX.sym("x", STATES), casadi.SX.sym("p", 8)
    qx, qy, qz, qw = (x[6 + k] for k in range(4))
    upright = 1.0 - 2.0 * (qx * qx + qy * qy)
    horizontal = casadi.sqrt(x[0] ** 2 + x[1] ** 2 + 1e-8)
    # From body to ENU: the columns of the direction cosine matrix.
    east = casadi.vertcat(
        1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz), 2 * (qx * qz - qw * qy)
    )
    north = casadi.vertcat(
        2 * (qx * qy - qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz + qw * qx)
    )
    up = casadi.vertcat(2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), upright)
    axis = p[4] * east + p[5] * north + p[6] * up
    distance = casadi.sqrt(casadi.sumsqr(x[:3]) + 1e-8)
    rows = casadi.vertcat(
        upright - p[0],
        1.0 - casadi.sumsqr(x[10:13]) / p[1],
        x[2] + p[3] - p[2] * horizontal,
        -casadi.dot(axis, x[:3]) / distance - p[7],
    )
    return casadi.Function("limits", [x, p], [rows], ["x", "p"], ["left"])


def limit_parameters(descent: RigidDescent, units: Units) -> Array:
    """Return the parameters of the path constraints (8,), without units.

    They are cosine of the maximum tilt, squared maximum rate, glideslope (tangent), depth of its
    apex, sensor boresight (3) and cosine of the half field of view; placeholders for limits that
    are None.
    """
    d = descent
    axis = np.array([0.0, 0.0, -1.0]) if d.sight is None else d.sight.axis
    return np.array(
        [
            -2.0 if d.max_tilt is None else np.cos(d.max_tilt),
            1e6 if d.max_rate is None else (d.max_rate * units.time) ** 2,
            0.0 if d.glideslope is None else np.tan(d.glideslope),
            d.apex_depth / units.length,
            *axis,
            -2.0 if d.sight is None else np.cos(d.sight.half_angle),
        ]
    )
