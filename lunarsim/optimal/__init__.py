"""Minimum-propellant descents: benchmark of laws, planner of the optimal law.

`docs/explanation/theory/optimal.md` has the equations. A problem is a `Descent`; a `Planner` keeps
compiled programs; `minimize_propellant` and `minimize_landing_error` search the final time.
"""

from lunarsim.optimal.errors import InfeasibleError, RelaxationError, SolverError
from lunarsim.optimal.final_time import minimize_landing_error, minimize_propellant
from lunarsim.optimal.path import OptimalPath
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Cone, Descent

__all__ = [
    "Cone",
    "Descent",
    "InfeasibleError",
    "OptimalPath",
    "Planner",
    "RelaxationError",
    "SolverError",
    "minimize_landing_error",
    "minimize_propellant",
]
