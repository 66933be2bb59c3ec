"""What turns measurements into a `HazardMap`: the one product that every mapper gives."""

from lunarsim.onboard.hazards.hazard_map import HazardMap, HazardMapper

__all__ = ["HazardMap", "HazardMapper"]
