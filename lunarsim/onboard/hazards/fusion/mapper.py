"""Mapper that fuses the evidence of other mappers into a `HazardMap`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar

import numpy as np

from lunarsim.errors import InputError, suggestion
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.calibration.fused import FusedCalibration
from lunarsim.onboard.hazards.fusion.fuse import fuse_evidence
from lunarsim.onboard.hazards.fusion.priors import FusionPriors
from lunarsim.onboard.hazards.fusion.resampling import resample_to_grid
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface, lookup_elevation
from lunarsim.onboard.hazards.map_evidence import RockEvidence, TerrainEvidence
from lunarsim.onboard.hazards.map_update_timer import MapUpdateTimer
from lunarsim.onboard.hazards.mapper import HazardMapper, calibration_path_error
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array

_EVIDENCE_NAMES = {TerrainEvidence: "elevations", RockEvidence: "rocks"}


@dataclass(frozen=True)
class FusedMapperSettings:
    """Settings of a mapper that fuses an elevation mapper and a rock mapper.

    The mapper has no sensor. Its map has the cells of the elevation map, or of the rock map while
    there are no elevations.

    Attributes
    ----------
    inputs
        Names of the fused mappers: one elevation mapper, one rock mapper, or both. Default: all
        other mappers.
    terrain_prior
        Probability that slope and roughness of unmeasured terrain are within the limits of the
        lander.
    calibration_path
        File of a `FusedCalibration`, which is applied last to the fused probability; None: it is
        not recalibrated.
    calibration_mapper
        Name of another elevation mapper, whose probability is an input of the calibration; empty:
        none.
    interval
        Minimum time between two updates of the map, s.
    """

    inputs: tuple[str, ...] = quantity(
        (), help="names of the mappers whose maps are combined; omitted: all other mappers"
    )
    terrain_prior: float = quantity(
        0.9,
        ge=0,
        lt=1,
        help="probability that slope and roughness of unmeasured terrain are within the lander's "
        "limits",
    )

    calibration_path: Path | None = quantity(
        None,
        help="file of the calibration that is applied to the fused map, relative to the scenario "
        "file; omitted: no calibration",
    )
    calibration_mapper: str = quantity(
        "",
        help="name of a second elevation mapper, whose p_safe (probability of safe terrain) the "
        "calibration uses as an additional input; empty: none",
    )
    interval: float = quantity(
        1.0, "s", ge=0, le=10, help="minimum time between two updates of the map"
    )

    accepts: ClassVar[type] = NoneType
    sensor: ClassVar[str] = ""

    def __post_init__(self) -> None:
        check_bounds(self, "mappers")
        found = self.calibration()
        if self.calibration_mapper and found is None:
            raise InputError(
                "calibration_mapper",
                self.calibration_mapper,
                "must be omitted if calibration_path is omitted",
            )
        if found is not None and found.other > 0.0 and not self.calibration_mapper:
            raise InputError(
                "calibration_path", str(self.calibration_path),
                "must be a calibration for one map if calibration_mapper is omitted",
                "Set calibration_mapper, which provides the second map.",
            )  # fmt: skip

    def calibration(self) -> FusedCalibration | None:
        """Read the calibration in `calibration_path`; None if the path is omitted.

        Raises
        ------
        InputError
            If the file is missing or is not a valid calibration.
        """
        if self.calibration_path is None:
            return None
        try:
            return FusedCalibration.load(self.calibration_path)
        except InputError as error:
            raise calibration_path_error(self.calibration_path, error) from None

    def fused_mappers(self, parts: Mapping[str, Any]) -> dict[str, type]:
        """Return the names of the fused mappers with the types of their fusion data.

        Parameters
        ----------
        parts
            Settings of all mappers by name, including these settings.

        Raises
        ------
        InputError
            If a mapper is unknown, provides no data for fusion, is named twice, or provides the
            same kind of data as another, or if there is no mapper.
        """
        others = {n: p for n, p in parts.items() if not isinstance(p, FusedMapperSettings)}
        names = self.inputs or tuple(n for n in others if n != self.calibration_mapper)
        if not names:
            raise InputError(
                "inputs", self.inputs,
                "needs other mappers whose maps are combined, and the scenario has none",
                "Add a table [mappers.NAME] for each.", show_value=False,
            )  # fmt: skip
        found: dict[str, type] = {}
        for name in names:
            if name not in parts:
                raise InputError(
                    "inputs", name, "must name a mapper of the scenario", suggestion(name, others)
                )
            published = getattr(parts[name], "publishes", None)
            if published not in _EVIDENCE_NAMES:
                raise InputError(
                    "inputs", name, "must name mappers that provide elevations or rocks"
                )
            if name in found:
                raise InputError("inputs", names, "must name each mapper once")
            if published in found.values():
                raise InputError(
                    "inputs", names,
                    f"must name only one mapper that provides {_EVIDENCE_NAMES[published]}",
                    "Two maps of the same data are not independent.",
                )  # fmt: skip
            found[name] = published
        self._check_calibration_mapper(parts, found)
        return found

    def _check_calibration_mapper(
        self, parts: Mapping[str, Any], fused: Mapping[str, type]
    ) -> None:
        """Raise InputError if `calibration_mapper` is not another elevation mapper.

        An empty name is valid. `parts` are the settings of all mappers by name; `fused` are the
        types of the fusion data of the fused mappers by name.
        """
        if not self.calibration_mapper:
            return
        if self.calibration_mapper not in parts:
            others = {n: p for n, p in parts.items() if n not in fused}
            raise InputError(
                "calibration_mapper",
                self.calibration_mapper,
                "must name a mapper of the scenario",
                suggestion(self.calibration_mapper, others),
            )
        published = getattr(parts[self.calibration_mapper], "publishes", None)
        if self.calibration_mapper in fused:
            raise InputError(
                "calibration_mapper", self.calibration_mapper,
                "must not name a mapper that is fused", "Remove the name from inputs.",
            )  # fmt: skip
        if published is not TerrainEvidence:
            raise InputError(
                "calibration_mapper", self.calibration_mapper,
                "must name a mapper that provides elevations",
            )  # fmt: skip

    def build(
        self,
        briefing: Briefing,
        navigation: Navigation,
        mappers: Mapping[str, HazardMapper] | None = None,
    ) -> FusedMapper:
        """Build the fused mapper of one flight.

        Parameters
        ----------
        briefing, navigation
            Data known before the flight, and the navigation filter.
        mappers
            Mappers that were built before, by name; the fused ones must be among them.
        """
        chosen = self.fused_mappers(briefing.software.mappers)
        priors = FusionPriors(briefing.lander, briefing.rocks, self.terrain_prior)
        built = mappers or {}
        return FusedMapper(
            {name: built[name] for name in chosen}, priors, self.calibration(),
            {n: built[n] for n in (self.calibration_mapper,) if n} or None,
            interval=self.interval,
        )  # fmt: skip


class FusedMapper(HazardMapper):
    """Hazard mapper that fuses the maps of other mappers when one of them changes.

    Parameters
    ----------
    mappers
        Fused mappers by name; their owner passes the measurements to them.
    priors
        Lander, expected rocks and terrain prior, known before any observation.
    calibration
        Calibration that is applied last to the fused probability; None: no calibration.
    calibration_mapper
        Another elevation mapper whose probability is an input of the calibration, as a mapping from
        its name; None: no such mapper.
    interval
        Minimum time between two updates of the map, s. Before `refresh` has set a time, each update
        of a fused mapper causes an update. If a mapper withdraws its observations, the map is
        updated immediately.

    Raises
    ------
    InputError
        If `mappers` is empty, or if `interval` is negative or not finite.
    """

    def __init__(
        self,
        mappers: Mapping[str, HazardMapper],
        priors: FusionPriors,
        calibration: FusedCalibration | None = None,
        calibration_mapper: Mapping[str, HazardMapper] | None = None,
        *,
        interval: float = 0.0,
    ) -> None:
        if not mappers:
            raise InputError("mappers", mappers, "must not be empty", show_value=False)
        self._mappers = dict(mappers)
        self._calibration_mapper = dict(calibration_mapper or {})
        self.priors = priors
        self.calibration = calibration
        self._map: HazardMap | None = None
        self._source_surfaces: tuple[TerrainSurface, ...] = ()
        self._timer = MapUpdateTimer(interval)

    @property
    def source_mappers(self) -> frozenset[str]:
        """Names of the fused mappers and of the elevation mapper used for calibration."""
        return frozenset((*self._mappers, *self._calibration_mapper))

    @property
    def displacement(self) -> Array:
        """Sum of all shifts (3,) of mapped terrain, m, by the first mapper that moves."""
        found = (mapper.displacement for mapper in self._mappers.values())
        return next((by for by in found if by.any()), np.zeros(3))

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
            type(measurement),
            "must not be given to a fused mapper",
            "A fused mapper has no sensor.",
        )

    def hazard_map(self) -> HazardMap:
        """Update the fused map if an update is due, and return it.

        An update is due if the map of a fused mapper has changed and the update interval has
        passed. It is due immediately if a fused mapper has withdrawn its observations or has moved
        its grid.
        """
        sources = (*self._mappers.values(), *self._calibration_mapper.values())
        surfaces = tuple(mapper.terrain_surface() for mapper in sources)
        if self._map is None or self._is_update_due(surfaces):
            self._map = self._compute(surfaces[0].grid)
            self._source_surfaces = surfaces
            if self.is_empty:
                # An empty map is updated as soon as there is an observation.
                self._timer.force_update()
            else:
                self._timer.mark_updated()
        return self._map

    def _is_update_due(self, surfaces: tuple[TerrainSurface, ...]) -> bool:
        """Return whether the map must be recomputed for the current source surfaces.

        After the update interval, any surface that differs from that of the last update requires
        this; before, only one whose grid has moved or whose observations were withdrawn.
        """
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
        """Return the fused and calibrated map; without data, an empty map on `grid`."""
        published = [mapper.evidence() for mapper in self._mappers.values()]
        elevations = next((e for e in published if isinstance(e, TerrainEvidence)), None)
        rocks = next((e for e in published if isinstance(e, RockEvidence)), None)
        if elevations is None and rocks is None:
            return HazardMap.unobserved(grid)
        fused = fuse_evidence(elevations, rocks, self.priors)
        if self.calibration is None:
            return fused
        second = next((mapper.hazard_map() for mapper in self._calibration_mapper.values()), None)
        return self._calibrated(fused, second)

    def _calibrated(self, fused: HazardMap, second: HazardMap | None) -> HazardMap:
        """Return the fused map with calibrated p_safe.

        `second` is the second elevation map, whose p_safe is an input of the calibration; None if
        there is none.
        """
        assert self.calibration is not None
        p_second, is_second_observed = np.zeros_like(fused.p_safe), np.zeros_like(fused.observed)
        if second is not None:
            p_second = resample_to_grid(
                second.p_safe, second.grid, fused.grid, np.float32(0.0), "minimum"
            )
            is_second_observed = resample_to_grid(
                second.observed, second.grid, fused.grid, False, "minimum"
            )
        return replace(
            fused, p_safe=self.calibration.probability(fused.p_safe, p_second, is_second_observed)
        )

    def terrain_height(self, xy: Array) -> float | None:
        """Return the terrain height at a point (2,), local frame, m; None if unknown.

        A measured elevation is preferred to the height that a rock mapper assumes.
        """
        for mapper in self._mappers.values():
            height = lookup_elevation(mapper.terrain_surface(), xy)
            if mapper.terrain_height(xy) is None and not mapper.is_empty and np.isfinite(height):
                return height
        known = [m.terrain_height(xy) for m in self._mappers.values() if not m.is_empty]
        return next((height for height in known if height is not None), None)

    @property
    def is_empty(self) -> bool:
        """Whether none of the fused mappers has mapped anything yet."""
        return all(mapper.is_empty for mapper in self._mappers.values())


def _is_same_update(new: TerrainSurface, old: TerrainSurface) -> bool:
    """Return whether two surfaces were computed in the same map update.

    Their heights may still differ. A hazard map is identified by its array of p_safe, another
    surface by the object.
    """
    if isinstance(new, HazardMap) and isinstance(old, HazardMap):
        return new.p_safe is old.p_safe
    return new is old
