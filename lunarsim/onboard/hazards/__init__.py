"""Where it is safe to land: the map that all mappers share, and the mappers."""

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper

__all__ = ["HazardMap", "HazardMapper"]
