"""Define the tables of a scenario file: names, classes or contracts, and defaults.

The classes of the components define keys, bounds and default values. A contract is the interface of
all components of one type, for instance "sensor"; `kind` selects one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lunarsim.models.gravity import RoundMoon
from lunarsim.models.site import LandingSite
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.braking import Braking
from lunarsim.onboard.policies.decisions import DecisionSettings
from lunarsim.onboard.policies.window import CrewWindow
from lunarsim.rocks.population import RockExpectation, RockPopulation
from lunarsim.scenario.mission import (
    CommandDelay,
    InitialUncertainty,
    PlannedSite,
    RecordSettings,
    SimulationClock,
    Start,
)
from lunarsim.scenario.rewards import DescentReward, SiteReward
from lunarsim.vehicle.domain_randomization import DomainRandomization
from lunarsim.vehicle.faults import Faults
from lunarsim.vehicle.legs import Legs
from lunarsim.vehicle.true_vehicle import Truth
from lunarsim.world.dust import Dust
from lunarsim.world.far_terrain import FarTerrainSettings
from lunarsim.world.light import Light
from lunarsim.world.survey import PriorMapSurvey

# Tables that always exist, each with one class.
FIXED: dict[str, type] = {
    "rocks": RockPopulation,
    "sun": Light,
    "truth": Truth,
    "start": Start,
    "target": PlannedSite,
    "expected_rocks": RockExpectation,
    "approach": Approach,
    "decisions": DecisionSettings,
    "simulation": SimulationClock,
}
# Optional tables, each with one class.
OPTIONAL: dict[str, type] = {
    "site": LandingSite,
    "moon": RoundMoon,
    "far_terrain": FarTerrainSettings,
    "dust": Dust,
    "initial_uncertainty": InitialUncertainty,
    "prior_map": PriorMapSurvey,
    "faults": Faults,
    "legs": Legs,
    "domain_randomization": DomainRandomization,
    "braking": Braking,
    "window": CrewWindow,
    "command_delay": CommandDelay,
    "record": RecordSettings,
    "site_reward": SiteReward,
    "descent_reward": DescentReward,
}
# Optional tables of a part selected by `kind`: contract.
OPTIONAL_SELECTED: dict[str, str] = {
    "terminal_descent": "terminal-descent",
    "computer": "computer",
}
# Tables of a part selected by `kind`: contract and default kind.
SELECTED: dict[str, tuple[str, str]] = {
    "terrain": ("terrain", "fractal"),
    "vehicle": ("vehicle", "lander"),
    "navigation": ("navigation", "inertial"),
    "policy": ("policy", "safest"),
    "guidance": ("guidance", "apollo"),
    "control": ("control", "pd"),
}
# Groups of named tables, each with a `kind`: contract and default tables.
NAMED: dict[str, tuple[str, dict[str, dict[str, Any]]]] = {
    "sensors": (
        "sensor",
        {
            "imu": {"kind": "imu"},
            "altimeter": {"kind": "radar-altimeter"},
            "velocimeter": {"kind": "velocimeter"},
            "stars": {"kind": "star-tracker"},
            "flash": {"kind": "flash-lidar"},
        },
    ),
    "sensor_faults": ("sensor-fault", {}),
    "tasking": ("tasking", {"flash": {"kind": "at-altitudes"}}),
    "mappers": ("mapper", {"dem": {"kind": "gaussian-dem"}}),
}
# Keys that define the world and the vehicle.
WORLD_KEYS = (
    "name", "description", "gravity_m_s2", "site", "moon", "far_terrain", "dust", "terrain",
    "rocks", "sun", "vehicle", "truth", "legs", "target",
)  # fmt: skip
# Tables of earlier versions, and the tables that replace them.
MOVED_TABLES: dict[str, str] = {
    "lander": "[vehicle]",
    "lidar": "[sensors.NAME] with kind = 'flash-lidar' and [tasking.NAME]",
    "camera": "[sensors.NAME] with kind = 'camera' and [tasking.NAME]",
    "mapper": "[mappers.NAME] and [expected_rocks]",
    "sweep": "[tasking.NAME] with kind = 'sweep'",
    "prior": "[prior_map]",
    "sites": "[mappers.NAME.sites] with kind = 'quadtree'",
}


def default_kind(table: str, data: Mapping[str, Any]) -> str:
    """Return the `kind` of a scenario table that does not state one.

    `table` is a name in `SELECTED`, and `data` are all tables of the scenario. The default kind of
    navigation depends on the other tables: "rocks" with a shadow mapper, which uses the filter that
    tracks rocks; "fixes" with a navigation-fix sensor; otherwise "inertial".
    """
    if table == "navigation":
        if "shadow" in _kinds(data, "mappers"):
            return "rocks"
        if "navigation-fix" in _kinds(data, "sensors"):
            return "fixes"
    return SELECTED[table][1]


def _kinds(data: Mapping[str, Any], table: str) -> set[Any]:
    """Return the kinds in a group of named tables, for instance of all sensors.

    `table` is the name of the group in the scenario `data`. Values of a wrong type are ignored
    here, because other checks report them.
    """
    parts = data.get(table, {})
    named = parts.values() if isinstance(parts, Mapping) else ()
    kinds = [part.get("kind") for part in named if isinstance(part, Mapping)]
    return {kind for kind in kinds if isinstance(kind, str)}
