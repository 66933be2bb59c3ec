"""Fusion of the evidence of several mappers into one hazard map."""

from lunarsim.onboard.hazards.fusion.fuse import fuse_evidence
from lunarsim.onboard.hazards.fusion.mapper import FusedMapper, FusedMapperSettings
from lunarsim.onboard.hazards.fusion.priors import FusionPriors

__all__ = ["FusedMapper", "FusedMapperSettings", "FusionPriors", "fuse_evidence"]
