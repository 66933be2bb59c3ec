"""Check a lander's design against its mission, from formulas, before any flight."""

from __future__ import annotations

import numpy as np

from lunarsim.evaluation.vehicle_check.attitude import attitude_rows
from lunarsim.evaluation.vehicle_check.disturbance import disturbance_rows
from lunarsim.evaluation.vehicle_check.gear import gear_rows
from lunarsim.evaluation.vehicle_check.mapping import mapping_rows
from lunarsim.evaluation.vehicle_check.mission import Mission, plan_mission
from lunarsim.evaluation.vehicle_check.propellant import propellant_rows
from lunarsim.evaluation.vehicle_check.rows import CheckRow, VehicleCheck
from lunarsim.evaluation.vehicle_check.sensing import sensor_rows
from lunarsim.evaluation.vehicle_check.throttle import throttle_rows
from lunarsim.scenario import Scenario

__all__ = ["CheckRow", "VehicleCheck", "check_vehicle"]

_SUBJECTS = (
    attitude_rows,
    disturbance_rows,
    throttle_rows,
    propellant_rows,
    sensor_rows,
    mapping_rows,
    gear_rows,
)


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
    mission = plan_mission(scenario)
    rows = [*_path_rows(mission), *(row for one in _SUBJECTS for row in one(mission))]
    return VehicleCheck(scenario.name, tuple(rows), mission.notes)


def _path_rows(mission: Mission) -> list[CheckRow]:
    """Return the row of the planned path, if no path keeps the limits of angles.

    Limits of propellant and thrust have separate rows.
    """
    angles = mission.software.approach.limits
    missing = {"tilt and glideslope", "time"} & set(mission.approach.exceeds)
    if not missing:
        return []
    tilt = np.arccos(np.clip(mission.approach.path.direction[:, 2], -1.0, 1.0)).max()
    return [
        CheckRow(
            "approach-path", "attitude", "maximum tilt against the path from the start",
            float(np.rad2deg(tilt)), float(np.rad2deg(angles.max_tilt)), "deg",
            "Otherwise no path leads from the start to the target: raise approach.max_tilt_deg, "
            "lower approach.glideslope_deg, or change start.position_m.",
        )
    ]  # fmt: skip
