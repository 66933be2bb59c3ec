"""Fusion of the evidence of several mappers into one hazard map."""

from lunarsim.onboard.hazards.fusion.fuse import fuse_evidence
from lunarsim.onboard.hazards.fusion.mapper import FusedMapper, FusedMapping
from lunarsim.onboard.hazards.fusion.terms import FusionTerms

__all__ = ["FusedMapper", "FusedMapping", "FusionTerms", "fuse_evidence"]
