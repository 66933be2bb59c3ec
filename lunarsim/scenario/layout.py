"""The tables of a scenario file: which there are, what each sets, and what there is if left out.

Nothing of a table is written here but its name: keys, bounds and defaults stand in the part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lunarsim.models.gravity import RoundMoon
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.braking import Braking
from lunarsim.onboard.policies.decisions import Decisions
from lunarsim.onboard.policies.window import Window
from lunarsim.rocks.population import RockExpectation, RockPopulation
from lunarsim.scenario.mission import Clock, MissionTarget, Start, StartKnowledge
from lunarsim.scenario.rewards import DescentReward, SiteReward
from lunarsim.vehicle.faults import Faults
from lunarsim.vehicle.legs import Legs
from lunarsim.vehicle.variation import Variation
from lunarsim.world.light import Light
from lunarsim.world.surroundings import Surroundings
from lunarsim.world.survey import PriorSurvey

# One table each, of one class.
FIXED: dict[str, type] = {
    "rocks": RockPopulation,
    "sun": Light,
    "start": Start,
    "target": MissionTarget,
    "expected_rocks": RockExpectation,
    "approach": Approach,
    "decisions": Decisions,
    "simulation": Clock,
}
# Likewise, but only where they are given.
OPTIONAL: dict[str, type] = {
    "moon": RoundMoon,
    "surroundings": Surroundings,
    "start_knowledge": StartKnowledge,
    "prior_map": PriorSurvey,
    "faults": Faults,
    "legs": Legs,
    "variation": Variation,
    "braking": Braking,
    "window": Window,
    "site_reward": SiteReward,
    "descent_reward": DescentReward,
}
# One table each, of a part chosen by `kind`, but only where they are given: contract.
OPTIONAL_CHOSEN: dict[str, str] = {"descent": "descent"}
# One table each, of a part chosen by `kind`: contract and kind if left out.
CHOSEN: dict[str, tuple[str, str]] = {
    "terrain": ("terrain", "fractal"),
    "vehicle": ("vehicle", "lander"),
    "navigation": ("navigation", "inertial"),
    "policy": ("policy", "safest"),
    "guidance": ("guidance", "apollo"),
    "control": ("control", "pd"),
}
# Any number of tables, each with a name and a `kind`: contract, and what there is if left out.
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
    "tasking": ("tasking", {"flash": {"kind": "at-altitudes"}}),
    "mappers": ("mapper", {"dem": {"kind": "gaussian-dem"}}),
}
# Keys of the world and of the vehicle in it.
WORLD = (
    "name", "description", "gravity_m_s2", "moon", "surroundings", "terrain", "rocks", "sun",
    "vehicle", "legs", "target",
)  # fmt: skip
# Tables of earlier versions, and where their keys are now.
MOVED: dict[str, str] = {
    "lander": "[vehicle]",
    "lidar": "[sensors.NAME] with kind = 'flash-lidar' and [tasking.NAME]",
    "camera": "[sensors.NAME] with kind = 'camera' and [tasking.NAME]",
    "mapper": "[mappers.NAME] and [expected_rocks]",
    "sweep": "[tasking.NAME] with kind = 'sweep'",
    "prior": "[prior_map]",
    "sites": "[mappers.NAME.sites] with kind = 'quadtree'",
}
# Keys of earlier versions whose table still exists, by table.
MOVED_KEYS: dict[str, str] = {
    "guidance": "paths and where they end are in [approach], the attitude in [control]",
    "navigation": "error budgets are in [sensors.NAME] with kind = 'navigation-fix', and in "
    "[start_knowledge]",
}


def kind_left_out(table: str, data: Mapping[str, Any]) -> str:
    """Return the kind of a part of `CHOSEN` that a scenario does not name.

    Navigation goes by what else is given: a map of shadows maps with the filter that tracks rocks,
    a lander with fixes of another system takes those.
    """
    if table == "navigation":
        if "shadow" in _kinds(data, "mappers"):
            return "rocks"
        if "navigation-fix" in _kinds(data, "sensors"):
            return "fixes"
    return CHOSEN[table][1]


def _kinds(data: Mapping[str, Any], table: str) -> set[Any]:
    """Return the kinds of named parts that are given; what is no table is told of elsewhere."""
    parts = data.get(table, {})
    named = parts.values() if isinstance(parts, Mapping) else ()
    kinds = [part.get("kind") for part in named if isinstance(part, Mapping)]
    return {kind for kind in kinds if isinstance(kind, str)}
