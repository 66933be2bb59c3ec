"""Guidance: where to fly, and the thrust that gets there."""

from lunarsim.onboard.guidance.apollo import (
    ApolloGuidance,
    PolynomialTrajectory,
    terminal_polynomial,
)
from lunarsim.onboard.guidance.divert import DivertCost, DivertLimits, divert_cost
from lunarsim.onboard.guidance.law import GuidanceLaw, Target
from lunarsim.onboard.guidance.vertical import VerticalDescent

__all__ = [
    "ApolloGuidance",
    "DivertCost",
    "DivertLimits",
    "GuidanceLaw",
    "PolynomialTrajectory",
    "Target",
    "VerticalDescent",
    "divert_cost",
    "terminal_polynomial",
]
