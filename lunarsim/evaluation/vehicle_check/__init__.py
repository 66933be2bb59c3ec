"""Check a lander's design against its mission, from formulas, before any flight."""

from __future__ import annotations

from lunarsim.evaluation.vehicle_check.attitude import ATTITUDE_CHECKS
from lunarsim.evaluation.vehicle_check.descent_checks import DESCENT_CHECKS
from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import CheckRow, VehicleCheck
from lunarsim.evaluation.vehicle_check.sensor_checks import SENSOR_CHECKS
from lunarsim.scenario import Scenario

__all__ = ["CheckRow", "VehicleCheck", "check_vehicle"]

_CHECKS = (*DESCENT_CHECKS, *ATTITUDE_CHECKS, *SENSOR_CHECKS)
# Subjects whose rows are valid although no path keeps the limits of angles.
_WITHOUT_PATH = ("path", "gear", "maps")


def check_vehicle(scenario: Scenario) -> VehicleCheck:
    """Check the lander of a scenario against the mission of the scenario.

    All values follow from formulas and from the planned path; no flight is simulated. The terrain
    counts as flat.

    Parameters
    ----------
    scenario
        A valid scenario.

    Returns
    -------
    VehicleCheck
        One row per check, and sentences about what was not checked.

    Raises
    ------
    InputError
        If the vehicle is not a `Lander`, or the start is below the end of the approach.

    Examples
    --------
    >>> from lunarsim.scenario import Scenario
    >>> found = check_vehicle(Scenario.from_dict({"name": "default"}))
    >>> found.named("propellant-nominal").status
    'ok'
    """
    mission = Mission(scenario)
    suitable = [
        c for c in _CHECKS if mission.path.is_within_limits or c.subject in _WITHOUT_PATH
    ]  # fmt: skip
    rows = [row for check in suitable for row in check.rows(mission)]
    return VehicleCheck(scenario.name, tuple(rows), mission.notes)
