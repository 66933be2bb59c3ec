"""What turns measurements into a `HazardMap`: the one product that every mapper gives."""

from lunarsim.hazards.hazard_map import HazardMap, HazardMapper

__all__ = ["HazardMap", "HazardMapper"]
