"""Search for the worst case: the admissible values with the lowest score.

The package is independent of what is scored. `lunarsim.studies.worst_case` runs it as a study.
"""

from lunarsim.search.optimisers import Evaluation, differential_evolution_search, random_search
from lunarsim.search.shrinking import shrink
from lunarsim.search.space import ChoiceRange, ContinuousRange, IntegerRange, SearchSpace
from lunarsim.search.worst_case import Finding, Trial, WorstCaseSearch

__all__ = [
    "ChoiceRange",
    "ContinuousRange",
    "Evaluation",
    "Finding",
    "IntegerRange",
    "SearchSpace",
    "Trial",
    "WorstCaseSearch",
    "differential_evolution_search",
    "random_search",
    "shrink",
]
