"""What navigation knows of the ground's height before it has measured any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing

# The block of what the ground lies above or below the target, and how it grows: heights of relief
# differ by its slope times this length after as many metres, m.
GROUND = "ground"
_CORRELATION = 10.0
# Heights of the ground so far apart differ by its slope over a metre times this power of the way:
# lunar mare up to a kilometre (Rosenburg et al. 2011; highland is rougher yet, 0.95).
_HURST = 0.76
# Ground is never known better than this, m.
_LEAST_GROUND = 0.1


@dataclass(frozen=True)
class LevelGround:
    """What is known of the height of the ground, to make something of ranges.

    Attributes
    ----------
    elevation
        m.
    sigma
        Of that elevation under the lander at the start, m; None: it is taken to be so everywhere.
    relief
        Tangent of the slope by which it rises and falls from there.
    """

    elevation: float = 0.0
    sigma: float | None = 10.0
    relief: float = float(np.tan(np.deg2rad(5.0)))

    def __post_init__(self) -> None:
        for name, value in (("sigma", self.sigma), ("relief", self.relief)):
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise InputError(
                    f"navigation.ground_{name}", value, "a number that is not negative"
                )
        if not np.isfinite(self.elevation):
            raise InputError("navigation.ground_elevation", self.elevation, "a finite height")

    @classmethod
    def of(cls, briefing: Briefing, relief: float) -> LevelGround:
        """Return what a mission knows of the ground under the start.

        That is the target's elevation, off by what the mission says of it and by how much relief,
        whose slope over a metre has this tangent, lies higher or lower so far away.
        """
        away = float(np.linalg.norm((briefing.start.position - briefing.target)[:2]))
        rise = relief * away**_HURST
        sigma = float(np.hypot(briefing.start.ground_sigma, rise))
        return cls(float(briefing.target[2]), max(sigma, _LEAST_GROUND), relief)

    @property
    def growth(self) -> float:
        """By how much the variance of the difference of two heights grows with a metre, m^2/m."""
        return self.relief**2 * _CORRELATION
