"""One map of what several mappers know: their evidence is joined, not their probabilities."""

from lunarsim.onboard.hazards.fusion.fuse import fused_map
from lunarsim.onboard.hazards.fusion.mapper import FusedMapper, FusedMapping
from lunarsim.onboard.hazards.fusion.terms import FusionTerms

__all__ = ["FusedMapper", "FusedMapping", "FusionTerms", "fused_map"]
