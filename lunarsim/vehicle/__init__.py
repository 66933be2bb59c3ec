"""The lander: geometry and masses, propulsion, rigid-body motion, touchdown."""

from lunarsim.vehicle.dynamics import AttitudeMode, Command, Dynamics
from lunarsim.vehicle.lander import Lander
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import (
    Ground,
    Touchdown,
    Verdict,
    judge_touchdown,
    pad_contacts,
    support_planes,
)

__all__ = [
    "AttitudeMode",
    "Command",
    "Dynamics",
    "Ground",
    "Lander",
    "State",
    "Touchdown",
    "Verdict",
    "judge_touchdown",
    "pad_contacts",
    "support_planes",
]
