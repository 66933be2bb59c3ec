"""The fused mapper: evidence of other mappers in, `HazardMap` out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, suggestion
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.hazards.drawing_times import DrawingTimes
from lunarsim.onboard.hazards.fusion.calibration import FusedCalibration
from lunarsim.onboard.hazards.fusion.fuse import fused_map
from lunarsim.onboard.hazards.fusion.resampling import on_grid
from lunarsim.onboard.hazards.fusion.terms import FusionTerms
from lunarsim.onboard.hazards.hazard_map import HazardMap, Surface, elevation_under
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
    calibration_path
        Last stage of the probability, see `FusedCalibration.load`; None: it stays as it is.
    feature
        Name of a second mapper of elevations that the calibration looks at; empty: none.
    interval
        See `FusedMapper`, s.
    """

    of: tuple[str, ...] = quantity((), help="names of the mappers it is made of; left out: all")
    relief_prior: float = quantity(
        0.9, ge=0, lt=1, help="probability that ground of which no elevation was measured is level"
    )

    calibration_path: Path | None = quantity(
        None, help="last stage of the probability, relative to the scenario file"
    )
    feature: str = quantity("", help="second mapper of elevations, a feature of the calibration")
    interval: float = quantity(
        1.0, "s", ge=0, le=10, help="least time between two drawings of the map"
    )

    takes: ClassVar[type] = NoneType
    sensor: ClassVar[str] = ""

    def __post_init__(self) -> None:
        check_bounds(self, "mappers")
        found = self.calibration()
        if self.feature and found is None:
            raise InputError(
                "feature", self.feature, "left out, or calibration_path that gives its weight"
            )
        if found is not None and found.other > 0.0 and not self.feature:
            raise InputError(
                "calibration_path", str(self.calibration_path),
                f"one without a weight of a second map ({found.other:g}), or its name as feature",
            )  # fmt: skip

    def calibration(self) -> FusedCalibration | None:
        """Return what the file at `calibration_path` holds, None without one."""
        if self.calibration_path is None:
            return None
        try:
            return FusedCalibration.load(self.calibration_path)
        except InputError as error:
            raise InputError(
                "calibration_path", str(self.calibration_path), f"a calibration ({error})"
            ) from None

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
        names = self.of or tuple(n for n in others if n != self.feature)
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
        self._check_feature(parts, found)
        return found

    def _check_feature(self, parts: Mapping[str, Any], of: Mapping[str, type]) -> None:
        """Refuse a feature that is no second mapper of elevations."""
        if not self.feature:
            return
        if self.feature not in parts:
            others = {n: p for n, p in parts.items() if n not in of}
            raise InputError("feature", self.feature, suggestion(self.feature, others))
        published = getattr(parts[self.feature], "publishes", None)
        if self.feature in of or published is not ReliefEvidence:
            raise InputError(
                "feature", self.feature,
                "a mapper of elevations beside those that the map is made of",
            )  # fmt: skip

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
        return FusedMapper(
            {name: built[name] for name in chosen}, terms, self.calibration(),
            {self.feature: built[self.feature]} if self.feature else None,
            interval=self.interval,
        )  # fmt: skip


class FusedMapper(HazardMapper):
    """Maps what other mappers know, when one of them has drawn anew.

    Parameters
    ----------
    mappers
        The others, by name; they are fed by whoever built them.
    terms
        What is known beforehand.
    calibration
        Last stage of the probability; left out: it stays as it is.
    feature
        By its name, a second mapper that the calibration looks at.
    interval
        Least time between two drawings of the map, s; where nobody tells the time it is drawn
        whenever another has drawn anew. What others take back is not waited with.

    Raises
    ------
    InputError
        If there are none, or the interval is negative or not finite.
    """

    def __init__(
        self,
        mappers: Mapping[str, HazardMapper],
        terms: FusionTerms,
        calibration: FusedCalibration | None = None,
        feature: Mapping[str, HazardMapper] | None = None,
        *,
        interval: float = 0.0,
    ) -> None:
        if not mappers:
            raise InputError("of", (), "at least one other mapper")
        self._mappers = dict(mappers)
        self._feature = dict(feature or {})
        self.terms = terms
        self.calibration = calibration
        self._drawn: HazardMap | None = None
        self._from: tuple[Surface, ...] = ()
        self._times = DrawingTimes(interval)

    @property
    def sources(self) -> frozenset[str]:
        """Names of the mappers that it is made of."""
        return frozenset((*self._mappers, *self._feature))

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
        """Return the map of what the others know as they have last drawn it, if it is due.

        Where one of them has taken back what it had seen, or was laid elsewhere, it is due at once.
        """
        asked = (*self._mappers.values(), *self._feature.values())
        grounds = tuple(mapper.surface() for mapper in asked)
        if self._drawn is None or self._must_draw(grounds):
            self._drawn = self._draw(grounds[0].grid)
            self._from = grounds
            if self.blank:
                # It is drawn again as soon as there is something.
                self._times.at_once()
            else:
                self._times.drawn()
        return self._drawn

    def _must_draw(self, grounds: tuple[Surface, ...]) -> bool:
        anew = [(n, o) for n, o in zip(grounds, self._from, strict=True) if not _same(n, o)]
        if self._times.due:
            return bool(anew)
        return any(
            new.grid != old.grid or (old.observed.any() and not new.observed.any())
            for new, old in anew
        )

    def refresh(self, time: float) -> None:
        """Note the time (s)."""
        self._times.tell(time)

    def _draw(self, grid: Grid) -> HazardMap:
        """Return the map, on the given cells while nothing is known."""
        published = [mapper.evidence() for mapper in self._mappers.values()]
        relief = next((e for e in published if isinstance(e, ReliefEvidence)), None)
        rocks = next((e for e in published if isinstance(e, RockEvidence)), None)
        if relief is None and rocks is None:
            return HazardMap.unobserved(grid)
        drawn = fused_map(relief, rocks, self.terms)
        if self.calibration is None:
            return drawn
        second = next((mapper.hazard_map() for mapper in self._feature.values()), None)
        return self._calibrated(drawn, second)

    def _calibrated(self, drawn: HazardMap, second: HazardMap | None) -> HazardMap:
        """Return the map through C, which looks at a second map's probability."""
        assert self.calibration is not None
        other, seen = np.zeros_like(drawn.p_safe), np.zeros_like(drawn.observed)
        if second is not None:
            other = on_grid(second.p_safe, second.grid, drawn.grid, np.float32(0.0), "least")
            seen = on_grid(second.observed, second.grid, drawn.grid, False, "least")
        return replace(drawn, p_safe=self.calibration.probability(drawn.p_safe, other, seen))

    def ground_height(self, xy: Array) -> float | None:
        """Return the local height of the ground at a point (2,), m; None where none knows it.

        That which was measured there, else what a mapper of rocks takes it to be.
        """
        for mapper in self._mappers.values():
            height = elevation_under(mapper.surface(), xy)
            if mapper.ground_height(xy) is None and not mapper.blank and np.isfinite(height):
                return height
        known = [m.ground_height(xy) for m in self._mappers.values() if not m.blank]
        return next((height for height in known if height is not None), None)

    @property
    def blank(self) -> bool:
        """Whether none of the others has mapped anything yet."""
        return all(mapper.blank for mapper in self._mappers.values())


def _same(new: Surface, old: Surface) -> bool:
    """Return whether two drawings of a mapper are one; the ground under a map may yet be raised."""
    if isinstance(new, HazardMap) and isinstance(old, HazardMap):
        return new.p_safe is old.p_safe
    return new is old
