"""What is known before any eye has seen anything."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.rocks.population import RockExpectation


@dataclass(frozen=True)
class FusionTerms:
    """What is known before any evidence.

    Attributes
    ----------
    lander, rocks
        Geometry and limits; what the mission expects.
    relief_prior
        Probability that slope and relief of ground that no elevation was measured of are within
        the lander's limits.

    Raises
    ------
    InputError
        If the prior is no probability, or is 1: ground that was not measured is never certain.
    """

    lander: Lander
    rocks: RockExpectation
    relief_prior: float = 0.9

    def __post_init__(self) -> None:
        if not 0.0 <= self.relief_prior < 1.0:
            raise InputError("relief_prior", self.relief_prior, "at least 0, and less than 1")

    @property
    def height_ratio(self) -> float:
        """Height over diameter of the rocks that are expected."""
        fixed = {"hemisphere": 0.5, "cube": 1.0}
        return fixed.get(self.rocks.shape, self.rocks.height_ratio[0])
