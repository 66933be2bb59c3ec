"""Descents of least propellant: the yardstick of every law, and what the optimal one flies.

`docs/theory/optimal.md` has the equations. A problem is a `Descent`; a `Planner` holds programs
that were built once; `least_propellant` and `least_error` search the final time.
"""

from lunarsim.optimal.errors import InfeasibleError, RelaxationError, SolverError
from lunarsim.optimal.final_time import least_error, least_propellant
from lunarsim.optimal.path import Path
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Cone, Descent

__all__ = [
    "Cone",
    "Descent",
    "InfeasibleError",
    "Path",
    "Planner",
    "RelaxationError",
    "SolverError",
    "least_error",
    "least_propellant",
]
