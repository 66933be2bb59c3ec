"""Contracts and helpers for custom parts.

The parts are policies, guidance laws, sensors, mappers, navigation filters and terrain.

A part is a frozen dataclass whose fields are declared with `quantity`; CONTRIBUTING.md has an
example of each. Names are imported at first use.
"""

from __future__ import annotations

from lunarsim._lazy import lazy_names

# Module of each name; `api.pyi` has them for type checkers.
_MODULES = {
    "SiteToLocal": "lunarsim.frames",
    "quat_rotate": "lunarsim.frames",
    "Grid": "lunarsim.grid",
    "SensorTask": "lunarsim.messages.commands",
    "AltimeterReading": "lunarsim.messages.measurements",
    "InertialSamples": "lunarsim.messages.measurements",
    "LidarScan": "lunarsim.messages.measurements",
    "gimbal_mount": "lunarsim.models.gimbal",
    "AltimeterInstrument": "lunarsim.models.instruments",
    "Lander": "lunarsim.models.lander",
    "AttitudeControl": "lunarsim.onboard.control.contract",
    "GuidanceLaw": "lunarsim.onboard.guidance.contract",
    "GuidancePart": "lunarsim.onboard.guidance.path_law",
    "PathLaw": "lunarsim.onboard.guidance.path_law",
    "PathShape": "lunarsim.onboard.guidance.paths",
    "HazardMap": "lunarsim.onboard.hazards.hazard_map",
    "HazardMapper": "lunarsim.onboard.hazards.mapper",
    "MapperPart": "lunarsim.onboard.hazards.mapper",
    "map_grid": "lunarsim.onboard.hazards.mapper",
    "Estimate": "lunarsim.onboard.navigation.estimate",
    "Navigation": "lunarsim.onboard.navigation.estimate",
    "NavigationPart": "lunarsim.onboard.navigation.estimate",
    "StrapdownState": "lunarsim.onboard.navigation.inertial",
    "Candidates": "lunarsim.onboard.policies.contract",
    "Decision": "lunarsim.onboard.policies.contract",
    "Observation": "lunarsim.onboard.policies.contract",
    "RetargetingPolicy": "lunarsim.onboard.policies.contract",
    "Tasking": "lunarsim.onboard.tasking.contract",
    "TaskingPart": "lunarsim.onboard.tasking.contract",
    "hidden": "lunarsim.parts.quantity",
    "quantity": "lunarsim.parts.quantity",
    "RandomStreams": "lunarsim.rng",
    "Sensor": "lunarsim.sensors.interface",
    "SensorPart": "lunarsim.sensors.interface",
    "State": "lunarsim.vehicle.state",
    "Heightfield": "lunarsim.world.terrain.heightfield",
    "TerrainModel": "lunarsim.world.terrain_models.interface",
    "add_rocks": "lunarsim.world.terrain_models.interface",
}
__all__ = sorted(_MODULES)  # noqa: PLE0605
__getattr__, __dir__ = lazy_names(__name__, _MODULES, globals())
