"""Prior knowledge for the fusion."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.rocks.population import RockExpectation


@dataclass(frozen=True)
class FusionPriors:
    """Data known before any observation that the fusion of hazard maps uses.

    Attributes
    ----------
    lander, rocks
        Geometry and limits of the lander; rock population expected by the mission.
    terrain_prior
        Probability that slope and roughness of unmeasured terrain are within the limits of the
        lander.

    Raises
    ------
    InputError
        If the prior is not in [0, 1); 1 is excluded because unmeasured terrain is never certain.
    """

    lander: Lander
    rocks: RockExpectation
    terrain_prior: float = 0.9

    def __post_init__(self) -> None:
        if not 0.0 <= self.terrain_prior < 1.0:
            raise InputError(
                "terrain_prior", self.terrain_prior, "must be at least 0 and less than 1"
            )

    @property
    def height_ratio(self) -> float:
        """Ratio of height to diameter of the expected rocks."""
        fixed = {"hemisphere": 0.5, "cube": 1.0}
        return fixed.get(self.rocks.shape, self.rocks.height_ratio[0])
