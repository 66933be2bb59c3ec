"""Landing hazard maps: the `HazardMap` product and the interface of mappers."""

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper

__all__ = ["HazardMap", "HazardMapper"]
