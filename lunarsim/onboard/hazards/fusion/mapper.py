"""The fused mapper: evidence of other mappers in, `HazardMap` out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import NoneType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, suggestion
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.hazards.fusion.fuse import FusionTerms, fused_map
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.hazards.published import ReliefEvidence, RockEvidence
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]

_WORDS = {ReliefEvidence: "elevations", RockEvidence: "rocks"}


@dataclass(frozen=True)
class FusedMapping:
    """One map of what other mappers know.

    It has no sensor of its own: it maps the evidence that the others publish, on the cells of the
    one of elevations.

    Attributes
    ----------
    of
        Names of the other mappers: one of elevations, one of rocks, or either. Left out: all that
        there are.
    relief_prior
        See `FusionTerms`.
    """

    of: tuple[str, ...] = quantity((), help="names of the mappers it is made of; left out: all")
    relief_prior: float = quantity(
        0.9, ge=0, lt=1, help="probability that ground of which no elevation was measured is level"
    )

    takes: ClassVar[type] = NoneType
    sensor: ClassVar[str] = ""

    def __post_init__(self) -> None:
        check_bounds(self, "mappers")

    def chosen(self, parts: Mapping[str, Any]) -> dict[str, type]:
        """Return the mappers that it is made of, by name, and what they publish.

        Parameters
        ----------
        parts
            Those of all mappers, itself among them.

        Raises
        ------
        InputError
            If there is no such mapper, one publishes no evidence, as a fused one, one is named
            twice, two publish the same kind, or there is none at all.
        """
        others = {n: p for n, p in parts.items() if not isinstance(p, FusedMapping)}
        names = self.of or tuple(others)
        if not names:
            raise InputError("of", self.of, "at least one other mapper, under [mappers.NAME]")
        found: dict[str, type] = {}
        for name in names:
            if name not in parts:
                raise InputError("of", name, suggestion(name, others))
            published = getattr(parts[name], "publishes", None)
            if published not in _WORDS:
                raise InputError("of", name, "a mapper that publishes evidence: this one does not")
            if name in found:
                raise InputError("of", names, f"each mapper once: {name!r} comes twice")
            if published in found.values():
                raise InputError(
                    "of", names,
                    f"one mapper of {_WORDS[published]}: two that map the same returns know no "
                    "more than either",
                )  # fmt: skip
            found[name] = published
        return found

    def build(
        self,
        briefing: Briefing,
        navigation: Navigation,
        mappers: Mapping[str, HazardMapper] | None = None,
    ) -> FusedMapper:
        """Return the mapper of one flight.

        Parameters
        ----------
        briefing, navigation
            As for all mappers.
        mappers
            Those that were built before.
        """
        chosen = self.chosen(briefing.software.mappers)
        terms = FusionTerms(briefing.lander, briefing.rocks, self.relief_prior)
        built = mappers or {}
        return FusedMapper({name: built[name] for name in chosen}, terms)


class FusedMapper(HazardMapper):
    """Maps what other mappers know, when one of them has drawn anew.

    Parameters
    ----------
    mappers
        The others, by name; they are fed by whoever built them.
    terms
        What is known beforehand.

    Raises
    ------
    InputError
        If there are none.
    """

    def __init__(self, mappers: Mapping[str, HazardMapper], terms: FusionTerms) -> None:
        if not mappers:
            raise InputError("of", (), "at least one other mapper")
        self._mappers = dict(mappers)
        self.terms = terms
        self._drawn: HazardMap | None = None
        self._from: tuple[HazardMap, ...] = ()

    @property
    def sources(self) -> frozenset[str]:
        """Names of the mappers that it is made of."""
        return frozenset(self._mappers)

    @property
    def grid(self) -> Any:
        """The cells of the map."""
        return self.hazard_map().grid

    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Take nothing in: it has no sensor.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError("measurement", type(measurement).__name__, "none: it maps no sensor's")

    def hazard_map(self) -> HazardMap:
        """Return the map of what the others know as they have last drawn it."""
        maps = tuple(mapper.hazard_map() for mapper in self._mappers.values())
        same = len(maps) == len(self._from) and all(
            new.p_safe is old.p_safe for new, old in zip(maps, self._from, strict=True)
        )
        if self._drawn is None or not same:
            self._drawn = self._draw(maps)
            self._from = maps
        return self._drawn

    def _draw(self, maps: tuple[HazardMap, ...]) -> HazardMap:
        published = [mapper.evidence() for mapper in self._mappers.values()]
        relief = next((e for e in published if isinstance(e, ReliefEvidence)), None)
        rocks = next((e for e in published if isinstance(e, RockEvidence)), None)
        if relief is None and rocks is None:
            return HazardMap.unobserved(maps[0].grid)
        return fused_map(relief, rocks, self.terms)

    def ground_height(self, xy: Array) -> float | None:
        """Return the local height of the ground at a point (2,), m; None where none knows it.

        That which was measured there, else what a mapper of rocks takes it to be.
        """
        for mapper in self._mappers.values():
            height = mapper.hazard_map().elevation_at(xy)
            if mapper.ground_height(xy) is None and not mapper.blank and np.isfinite(height):
                return height
        known = [m.ground_height(xy) for m in self._mappers.values() if not m.blank]
        return next((height for height in known if height is not None), None)

    @property
    def blank(self) -> bool:
        """Whether none of the others has mapped anything yet."""
        return all(mapper.blank for mapper in self._mappers.values())
