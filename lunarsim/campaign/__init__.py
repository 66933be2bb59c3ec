"""Campaigns: many flights, their execution, results and statistics."""

from lunarsim.campaign.compare import CompareResult, compare
from lunarsim.campaign.evaluate import evaluate
from lunarsim.campaign.statistics import Proportion, summarise

__all__ = ["CompareResult", "Proportion", "compare", "evaluate", "summarise"]
