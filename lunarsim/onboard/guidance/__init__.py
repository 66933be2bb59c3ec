"""Guidance: guidance laws, ends of phases, and divert costs."""

from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd

__all__ = ["GuidanceLaw", "PhaseEnd"]
