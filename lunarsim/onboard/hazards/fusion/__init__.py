"""Fusion of the evidence of several mappers into one hazard map."""

from lunarsim.onboard.hazards.fusion.fuse import fused_map
from lunarsim.onboard.hazards.fusion.mapper import FusedMapper, FusedMapping
from lunarsim.onboard.hazards.fusion.terms import FusionTerms

__all__ = ["FusedMapper", "FusedMapping", "FusionTerms", "fused_map"]
