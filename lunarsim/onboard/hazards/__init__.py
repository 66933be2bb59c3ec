"""Landing hazard maps: the common `HazardMap` product and the mappers that produce it."""

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper

__all__ = ["HazardMap", "HazardMapper"]
