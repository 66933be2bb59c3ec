"""True vehicle: actuators, rigid-body dynamics, faults and touchdown."""

from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import (
    ElevationModel,
    LandingOutcome,
    Touchdown,
    evaluate_touchdown,
    pad_contacts,
)

__all__ = [
    "Dynamics",
    "ElevationModel",
    "LandingOutcome",
    "State",
    "Touchdown",
    "evaluate_touchdown",
    "pad_contacts",
]
