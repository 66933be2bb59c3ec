"""Guidance: where to fly, and the thrust that gets there."""

from lunarsim.guidance.apollo import ApolloGuidance, PolynomialTrajectory, terminal_polynomial
from lunarsim.guidance.attitude import thrust_to_command
from lunarsim.guidance.divert import DivertCost, DivertLimits, divert_cost
from lunarsim.guidance.law import GuidanceLaw, Target
from lunarsim.guidance.vertical import VerticalDescent

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
    "thrust_to_command",
]
