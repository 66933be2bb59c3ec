"""The contract of mappers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_side
from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.hazard_map import HazardMap, Surface
from lunarsim.onboard.hazards.published import Published
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.named_errors import named_in
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.part_results import wrong_result

Array = NDArray[np.float64]

# A tilt known so well (1 sigma) need not be made good any more, rad: at 50 m it is 4 cm of height.
SURE_TILT = float(np.deg2rad(0.05))
# Along a side of a map.
_MOST_CELLS = 8000


class HazardMapper(ABC):
    """Anything that draws a `HazardMap` from measurements."""

    @abstractmethod
    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Take in one measurement made at the estimated pose."""

    def take(self, sensor: str, measurement: Any, estimate: Estimate) -> None:
        """Take in one measurement of a named sensor made at the estimated pose.

        A mapper of several sensors overrides this; for others all are of the same one.
        """
        self.update(measurement, estimate)

    @abstractmethod
    def hazard_map(self) -> HazardMap:
        """Return the map as it stands."""

    @property
    @abstractmethod
    def blank(self) -> bool:
        """Whether nothing has been mapped yet."""

    def surface(self) -> Surface:
        """Return how the ground lies in the map as it stands.

        A mapper that can tell that before it has judged the ground overrides this. As long as
        nothing is drawn anew it is the same object, or one with the same map in it.
        """
        return self.hazard_map()

    def recentre(self, centre: Array) -> None:  # noqa: B027
        """Lay the map about another point (3,), local frame, m, if it lies too far aside for that.

        Called whenever navigation has learnt that the target lies elsewhere. What has been mapped
        stays where it is; what lies off the new map may be dropped.
        """

    def level(self, turn: Array, pivot: Array, tilt_sigma: float) -> None:  # noqa: B027
        """Turn ground that was mapped while the lander's tilt was not known.

        Called whenever navigation has learnt of a tilt. What was mapped with a tilt known to
        `SURE_TILT` stays.

        Parameters
        ----------
        turn, pivot
            Rotation (3, 3) about a point (3,), local frame, m.
        tilt_sigma
            To which the tilt is known now, rad.
        """

    def ground_height(self, xy: Array) -> float | None:
        """Return the local height of the ground at a point (2,), m, where the map does not say.

        None where it does: what is mapped in the local frame stays there.
        """
        return None

    def refresh(self, time: float) -> None:  # noqa: B027
        """Do what is due at `time` (s); called once a cycle, after measurements."""

    def scoreboard(self, site: Array) -> Scoreboard | None:
        """Return the sites that the mapper has ranked itself; None if it ranks none.

        Parameters
        ----------
        site
            The site flown to now (3,), local frame, m.
        """
        return None

    def evidence(self) -> Published | None:
        """Return what the map was made of, for maps of several mappers; None while it is nothing.

        A mapper whose part says what it `publishes` overrides this.
        """
        return None

    @property
    def sources(self) -> frozenset[str]:
        """Names of the mappers whose evidence it maps; empty: it maps measurements."""
        return frozenset()

    def tables(self) -> dict[str, dict[str, Array]]:
        """Return what else is worth a record: name to columns (n,), local frame."""
        return {}


class MapperPart(Protocol):
    """What the registry knows of a mapper: a frozen dataclass of its settings.

    Attributes
    ----------
    takes
        Type of measurements that it maps.
    navigation
        May be left out: part of navigation that it cannot work without.
    publishes
        May be left out: type of the evidence that it gives to maps of several mappers.
    sensor
        Name of the sensor whose measurements it maps.
    sensors
        May be left out: names of several, in place of `sensor`; see `sensors_of`.
    """

    takes: ClassVar[type]

    @property
    def sensor(self) -> str:
        """Name of the sensor whose measurements it maps."""
        ...

    def build(self, briefing: Briefing, navigation: Navigation) -> HazardMapper:
        """Return the mapper of one flight, its map about the target.

        Raises
        ------
        InputError
            If the map is smaller than the lander's footprint or its posting is too coarse.
        """
        ...


def sensors_of(part: Any) -> tuple[str, ...]:
    """Return the names of the sensors whose measurements a mapper's part takes; none: no sensor's.

    Parameters
    ----------
    part
        See `MapperPart`.
    """
    several = getattr(part, "sensors", ())
    if several:
        return tuple(several)
    return (part.sensor,) if part.sensor else ()


def is_aside(grid: Grid, centre: Array) -> bool:
    """Tell whether a point (2,) or (3,) lies too far off a map's middle to leave the map there.

    Farther than an eighth of its side.
    """
    west, east, south, north = grid.extent
    far = np.abs(np.asarray(centre)[:2] - grid.centre)
    return bool((far > 0.125 * min(east - west, north - south)).any())


def check_map(size: float, posting: float, lander: Lander) -> None:
    """Refuse a map that is smaller than the lander's footprint, too coarse, or too large.

    Parameters
    ----------
    size, posting
        Side of the square and of a cell, m.
    lander
        That is to land on it.

    Raises
    ------
    InputError
        Naming ``size_m`` or ``posting_m``.
    """
    if posting > 0.5 * lander.leg_radius:
        raise InputError("posting_m", posting, f"at most {0.5 * lander.leg_radius} m")
    if size < 4.0 * lander.leg_radius + 1.0:
        raise InputError("size_m", size, f"at least {4.0 * lander.leg_radius + 1.0:.1f} m")
    check_side("size_m", size, posting, _MOST_CELLS)


def map_grid(centre: Array, size: float, posting: float, lander: Lander) -> Grid:
    """Return the cells of a hazard map about a point.

    Raises
    ------
    InputError
        See `check_map`.
    """
    check_map(size, posting, lander)
    return Grid.centred(centre, size, posting)


def asked_map(name: str, part: object, mapper: HazardMapper, time: float) -> HazardMap:
    """Return the hazard map of a mapper, of a name and a part, at a time (s).

    Raises
    ------
    InputError
        If it returns something else, or a map whose arrays are wrong; the mapper is named.
    """
    table = f"mappers.{name}"
    with named_in(table):
        found: Any = mapper.hazard_map()
    if not isinstance(found, HazardMap):
        raise wrong_result(table, part, "hazard_map", found, "a HazardMap", time)
    return found
