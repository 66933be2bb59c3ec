"""Campaigns: many flights, their execution, results and statistics."""

from lunarsim.campaign.compare import CompareResult, compare

__all__ = ["CompareResult", "compare"]
