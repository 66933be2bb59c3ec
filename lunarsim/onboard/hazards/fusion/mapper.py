"""Mapper that fuses the evidence of other mappers into a `HazardMap`."""

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
from lunarsim.onboard.hazards.fusion.calibration import FusedCalibration
from lunarsim.onboard.hazards.fusion.fuse import fuse_evidence
from lunarsim.onboard.hazards.fusion.priors import FusionPriors
from lunarsim.onboard.hazards.fusion.resampling import resample_to_grid
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface, lookup_elevation
from lunarsim.onboard.hazards.map_evidence import RockEvidence, TerrainEvidence
from lunarsim.onboard.hazards.map_update_timer import MapUpdateTimer
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]

_EVIDENCE_NAMES = {TerrainEvidence: "elevations", RockEvidence: "rocks"}


@dataclass(frozen=True)
class FusedMapperSettings:
    """Settings of a mapper that fuses the evidence of other mappers.

    It has no sensor. Its cells are those of the mapper of elevations.

    Attributes
    ----------
    of
        Names of the fused mappers: one of elevations, one of rocks, or both. Default: all mappers.
    relief_prior
        Terrain prior, as in `FusionPriors`.
    calibration_path
        File of a `FusedCalibration`, the last stage of the probability; None: no such stage.
    feature
        Name of a second mapper of elevations, used as a feature of the calibration; empty: none.
    interval
        Minimum time between two updates of the map, s.
    """

    of: tuple[str, ...] = quantity((), help="names of the fused mappers; omitted: all")
    relief_prior: float = quantity(
        0.9, ge=0, lt=1, help="probability that unmeasured terrain is within the limits"
    )

    calibration_path: Path | None = quantity(
        None, help="calibration file of the fused map, relative to the scenario file"
    )
    feature: str = quantity("", help="second mapper of elevations for the calibration")
    interval: float = quantity(
        1.0, "s", ge=0, le=10, help="minimum time between two updates of the map"
    )

    takes: ClassVar[type] = NoneType
    sensor: ClassVar[str] = ""

    def __post_init__(self) -> None:
        check_bounds(self, "mappers")
        found = self.calibration()
        if self.feature and found is None:
            raise InputError("feature", self.feature, "must be omitted without calibration_path")
        if found is not None and found.other > 0.0 and not self.feature:
            raise InputError(
                "calibration_path", str(self.calibration_path),
                f"must not weight a second map ({found.other:g}) without feature", "Set feature.",
            )  # fmt: skip

    def calibration(self) -> FusedCalibration | None:
        """Return the calibration in `calibration_path`; None without a file."""
        if self.calibration_path is None:
            return None
        try:
            return FusedCalibration.load(self.calibration_path)
        except InputError as error:
            raise InputError(
                "calibration_path",
                str(self.calibration_path),
                f"must be a valid calibration ({error})",
            ) from None

    def chosen(self, parts: Mapping[str, Any]) -> dict[str, type]:
        """Return the fused mappers by name with the types of their evidence.

        Parameters
        ----------
        parts
            Settings of all mappers by name, including this one.

        Raises
        ------
        InputError
            If a mapper is unknown, provides no evidence (as a fused one), is named twice, or
            provides the same evidence as another, or if there is none.
        """
        others = {n: p for n, p in parts.items() if not isinstance(p, FusedMapperSettings)}
        names = self.of or tuple(n for n in others if n != self.feature)
        if not names:
            raise InputError(
                "of", self.of, "must name at least one other mapper", "Add a table [mappers.NAME]."
            )
        found: dict[str, type] = {}
        for name in names:
            if name not in parts:
                raise InputError("of", name, "is unknown", suggestion(name, others))
            published = getattr(parts[name], "publishes", None)
            if published not in _EVIDENCE_NAMES:
                raise InputError("of", name, "must be a mapper that publishes evidence")
            if name in found:
                raise InputError("of", names, f"must name each mapper once, not {name!r} twice")
            if published in found.values():
                raise InputError(
                    "of", names,
                    f"must name one mapper of {_EVIDENCE_NAMES[published]} only, "
                    "because two maps of the same returns are not independent",
                )  # fmt: skip
            found[name] = published
        self._check_feature(parts, found)
        return found

    def _check_feature(self, parts: Mapping[str, Any], of: Mapping[str, type]) -> None:
        """Reject a feature that is not a second mapper of elevations."""
        if not self.feature:
            return
        if self.feature not in parts:
            others = {n: p for n, p in parts.items() if n not in of}
            raise InputError(
                "feature", self.feature, "is unknown", suggestion(self.feature, others)
            )
        published = getattr(parts[self.feature], "publishes", None)
        if self.feature in of or published is not TerrainEvidence:
            raise InputError(
                "feature", self.feature,
                "must be a mapper of elevations that is not fused",
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
            Mappers built before this one, by name.
        """
        chosen = self.chosen(briefing.software.mappers)
        terms = FusionPriors(briefing.lander, briefing.rocks, self.relief_prior)
        built = mappers or {}
        return FusedMapper(
            {name: built[name] for name in chosen}, terms, self.calibration(),
            {self.feature: built[self.feature]} if self.feature else None,
            interval=self.interval,
        )  # fmt: skip


class FusedMapper(HazardMapper):
    """Fuse the maps of other mappers whenever one of them has an update.

    Parameters
    ----------
    mappers
        Fused mappers by name; their owner passes them the measurements.
    terms
        Prior knowledge.
    calibration
        Last stage of the probability; None: no such stage.
    feature
        Second mapper used by the calibration, by its name.
    interval
        Minimum time between two updates of the map, s. Without a known time, each update of another
        mapper causes an update. Retracted observations cause an update at once.

    Raises
    ------
    InputError
        If `mappers` is empty, or if `interval` is negative or not finite.
    """

    def __init__(
        self,
        mappers: Mapping[str, HazardMapper],
        terms: FusionPriors,
        calibration: FusedCalibration | None = None,
        feature: Mapping[str, HazardMapper] | None = None,
        *,
        interval: float = 0.0,
    ) -> None:
        if not mappers:
            raise InputError("of", (), "must name at least one other mapper")
        self._mappers = dict(mappers)
        self._feature = dict(feature or {})
        self.terms = terms
        self.calibration = calibration
        self._map: HazardMap | None = None
        self._source_surfaces: tuple[TerrainSurface, ...] = ()
        self._timer = MapUpdateTimer(interval)

    @property
    def sources(self) -> frozenset[str]:
        """Names of the fused mappers and of the feature."""
        return frozenset((*self._mappers, *self._feature))

    @property
    def grid(self) -> Any:
        """Cells of the map."""
        return self.hazard_map().grid

    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Reject any measurement, since this mapper has no sensor.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(
            "measurement",
            type(measurement).__name__,
            "must not be given to a fused mapper, which has no sensor",
        )

    def hazard_map(self) -> HazardMap:
        """Return the fused map, after an update if one is due.

        An update is due at once if another mapper has retracted its observations or has moved its
        grid.
        """
        sources = (*self._mappers.values(), *self._feature.values())
        surfaces = tuple(mapper.surface() for mapper in sources)
        if self._map is None or self._is_update_due(surfaces):
            self._map = self._compute(surfaces[0].grid)
            self._source_surfaces = surfaces
            if self.blank:
                # An empty map is updated as soon as there is an observation.
                self._timer.force_update()
            else:
                self._timer.mark_updated()
        return self._map

    def _is_update_due(self, surfaces: tuple[TerrainSurface, ...]) -> bool:
        changed = [
            (n, o)
            for n, o in zip(surfaces, self._source_surfaces, strict=True)
            if not _is_same_update(n, o)
        ]
        if self._timer.is_due:
            return bool(changed)
        return any(
            new.grid != old.grid or (old.observed.any() and not new.observed.any())
            for new, old in changed
        )

    def refresh(self, time: float) -> None:
        """Set the current time (s)."""
        self._timer.set_time(time)

    def _compute(self, grid: Grid) -> HazardMap:
        """Return the map; without evidence, an empty one on the given cells."""
        published = [mapper.evidence() for mapper in self._mappers.values()]
        relief = next((e for e in published if isinstance(e, TerrainEvidence)), None)
        rocks = next((e for e in published if isinstance(e, RockEvidence)), None)
        if relief is None and rocks is None:
            return HazardMap.unobserved(grid)
        fused = fuse_evidence(relief, rocks, self.terms)
        if self.calibration is None:
            return fused
        second = next((mapper.hazard_map() for mapper in self._feature.values()), None)
        return self._calibrated(fused, second)

    def _calibrated(self, fused: HazardMap, second: HazardMap | None) -> HazardMap:
        """Return the map after the calibration C with the second map as a feature."""
        assert self.calibration is not None
        other, seen = np.zeros_like(fused.p_safe), np.zeros_like(fused.observed)
        if second is not None:
            other = resample_to_grid(
                second.p_safe, second.grid, fused.grid, np.float32(0.0), "minimum"
            )
            seen = resample_to_grid(second.observed, second.grid, fused.grid, False, "minimum")
        return replace(fused, p_safe=self.calibration.probability(fused.p_safe, other, seen))

    def terrain_height(self, xy: Array) -> float | None:
        """Return the terrain height at a point (2,), local frame, m; None if unknown.

        A measured elevation is preferred to the assumption of a mapper of rocks.
        """
        for mapper in self._mappers.values():
            height = lookup_elevation(mapper.surface(), xy)
            if mapper.terrain_height(xy) is None and not mapper.blank and np.isfinite(height):
                return height
        known = [m.terrain_height(xy) for m in self._mappers.values() if not m.blank]
        return next((height for height in known if height is not None), None)

    @property
    def blank(self) -> bool:
        """Whether none of the other mappers has mapped anything yet."""
        return all(mapper.blank for mapper in self._mappers.values())


def _is_same_update(new: TerrainSurface, old: TerrainSurface) -> bool:
    """Return whether two surfaces belong to one update; heights may still differ."""
    if isinstance(new, HazardMap) and isinstance(old, HazardMap):
        return new.p_safe is old.p_safe
    return new is old
