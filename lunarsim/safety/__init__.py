"""Landing safety from elevation: exact, conservative and stochastic tests.

Every test evaluates a lander centred on a cell, at every heading.
"""

from lunarsim.safety.alhat import alhat_safety
from lunarsim.safety.bounded import bounded_safety
from lunarsim.safety.conservative import (
    StochasticSafety,
    conservative_safety,
    stochastic_safety,
)
from lunarsim.safety.exact import SafetyMap, exact_safety, safe_sites
from lunarsim.safety.footprint import Footprint, footprint_of
from lunarsim.safety.planes import plane_stochastic_safety

__all__ = [
    "Footprint",
    "SafetyMap",
    "StochasticSafety",
    "alhat_safety",
    "bounded_safety",
    "conservative_safety",
    "exact_safety",
    "footprint_of",
    "plane_stochastic_safety",
    "safe_sites",
    "stochastic_safety",
]
