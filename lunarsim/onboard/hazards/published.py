"""What mappers publish besides their maps: evidence, from which maps of several are made.

Probabilities cannot be multiplied up without knowing what they stand for: a rock that two eyes see
would count twice, and one that neither saw once for each. Evidence can: how the ground lies, how
many rocks may stand there unseen, and which rocks are known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.hazard_map import HazardMap, Surface
from lunarsim.safety.calibration import Evidence
from lunarsim.safety.refit import ScenarioCalibration

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RockTracks:
    """Rocks that an eye has seen, each by itself.

    Attributes
    ----------
    xy
        Centres (n, 2), local frame, m.
    sigma
        Of the centres, an axis, relative to the lander (n,), m.
    radius, radius_variance
        m (n,), m^2.
    existence
        Probability that each is a rock (n,).

    Raises
    ------
    InputError
        If they are not of as many rocks, or not finite.
    """

    xy: Array
    sigma: Array
    radius: Array
    radius_variance: Array
    existence: Array

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            wanted = (len(self.radius), 2) if f.name == "xy" else (len(self.radius),)
            if np.shape(value) != wanted:
                raise InputError(f"rocks.{f.name}", np.shape(value), f"an array {wanted}")
            if not np.isfinite(value).all():
                raise InputError(f"rocks.{f.name}", value[~np.isfinite(value)][0], "finite numbers")


@dataclass(frozen=True)
class ReliefEvidence:
    """What a mapper of elevations knows of the ground.

    Attributes
    ----------
    surface
        How it lies: the mapper's own map, or what that is to be made of.
    judged
        What its probability follows from; None: it does not tell.
    refit
        Last stage of its calibration; None: that of the package.
    rises
        How far the samples of each cell stand above the ground about them (rows, cols), m; NaN
        where there are none. None: it does not tell.
    draw
        Gives the mapper's own map; None: `surface` is it.

    Raises
    ------
    InputError
        If the rises are not on the map's cells, or there is neither a map nor what gives it.
    """

    surface: Surface
    judged: Evidence | None = None
    refit: ScenarioCalibration | None = None
    rises: NDArray[np.float32] | None = None
    draw: Callable[[], HazardMap] | None = None

    def __post_init__(self) -> None:
        if self.draw is None and not isinstance(self.surface, HazardMap):
            raise InputError("evidence.surface", type(self.surface), "a hazard map, or draw")
        wanted = self.surface.grid.shape
        if self.rises is not None and self.rises.shape != wanted:
            raise InputError("evidence.rises", self.rises.shape, f"a raster {wanted}")

    @cached_property
    def drawn(self) -> HazardMap:
        """The mapper's own map."""
        if self.draw is not None:
            return self.draw()
        assert isinstance(self.surface, HazardMap)
        return self.surface


@dataclass(frozen=True)
class RockEvidence:
    """What a mapper of rocks knows of them.

    Attributes
    ----------
    drawn
        Its own map.
    diameter
        Least one of each class of sizes (sizes,), rising, m.
    ratio
        Of each class, the rocks that are not tracked and may be at a place over those expected
        there before any look (sizes, rows, cols), on the cells of the map; 1 where nothing was
        seen.
    tracks
        Rocks that are tracked, or may be.
    clear
        Gives the probability that none of such rocks reaches into the footprint (rows, cols).
    unseen
        Probability that a rock that is not tracked reaches in (rows, cols); None: it does not tell.
    expected
        How many rocks that matter should have been found.

    Raises
    ------
    InputError
        If the ratio or `unseen` is not on the map's cells, `unseen` is no probability, or the ratio
        not of as many classes.
    """

    drawn: HazardMap
    diameter: Array
    ratio: NDArray[np.float32]
    tracks: RockTracks
    clear: Callable[[RockTracks], Array]
    unseen: NDArray[np.float32] | None = None
    expected: float = 0.0

    def __post_init__(self) -> None:
        if self.unseen is not None and self.unseen.shape != self.drawn.grid.shape:
            wanted_here = f"a raster {self.drawn.grid.shape}"
            raise InputError("evidence.unseen", self.unseen.shape, wanted_here)
        if self.unseen is not None:
            none = self.unseen[~((self.unseen >= 0.0) & (self.unseen <= 1.0))]
            if none.size:
                raise InputError("evidence.unseen", float(none[0]), "probabilities")
        wanted = (len(self.diameter), *self.drawn.grid.shape)
        if self.ratio.shape != wanted:
            raise InputError("evidence.ratio", self.ratio.shape, f"a raster {wanted}")


Published = ReliefEvidence | RockEvidence
