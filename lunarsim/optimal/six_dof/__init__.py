"""Minimum-propellant descents of a rigid body, with the simulator's dynamics.

`shoot` uses direct multiple shooting and IPOPT, `SuccessiveConvexification` a sequence of quadratic
programs. Both hold thrust and torques constant over intervals, so that the result can be flown open
loop (`lunarsim.evaluation.open_loop`).
"""

from lunarsim.optimal.six_dof.guess import InitialGuess, remaining_guess
from lunarsim.optimal.six_dof.path import ConstraintViolations, RigidPath, evaluate_violations
from lunarsim.optimal.six_dof.problem import RigidDescent, SiteVisibility
from lunarsim.optimal.six_dof.shooting import shoot
from lunarsim.optimal.six_dof.successive import SuccessiveConvexification

__all__ = [
    "ConstraintViolations",
    "InitialGuess",
    "RigidDescent",
    "RigidPath",
    "SiteVisibility",
    "SuccessiveConvexification",
    "evaluate_violations",
    "remaining_guess",
    "shoot",
]
