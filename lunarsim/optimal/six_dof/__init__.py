"""Descents of least propellant of a rigid body, by the simulator's own equations, in two ways.

`shoot` solves by direct multiple shooting and IPOPT, `Successive` by a row of quadratic programs.
Both hold thrust and torques over intervals, so that what they find is flown as it is
(`lunarsim.evaluation.open_loop`).
"""

from lunarsim.optimal.six_dof.guess import Guess, carried_on
from lunarsim.optimal.six_dof.path import Kept, RigidPath, kept
from lunarsim.optimal.six_dof.problem import RigidDescent, Sight
from lunarsim.optimal.six_dof.shooting import shoot
from lunarsim.optimal.six_dof.successive import Successive

__all__ = [
    "Guess",
    "Kept",
    "RigidDescent",
    "RigidPath",
    "Sight",
    "Successive",
    "carried_on",
    "kept",
    "shoot",
]
