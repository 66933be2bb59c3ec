"""What sites cost, and what a policy is shown of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.hazards.mapper import HazardMapper, asked_map
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim.onboard.policies.contract import Observation
from lunarsim.onboard.policies.expected_miss import Aim
from lunarsim.onboard.policies.reach import Reach

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """Where the lander is, and what it is flying to.

    Attributes
    ----------
    time
        s.
    mass
        Of the lander by its account of the tanks, kg.
    estimate
        As navigation has it now.
    site
        Local frame (3,), m.
    time_to_go
        Until the end of the approach is to be reached, s.
    """

    time: float
    mass: float
    estimate: Estimate
    site: Array
    time_to_go: float


class Outlook:
    """Where a lander could go, by the map that decides and the paths of its guidance.

    Parameters
    ----------
    briefing
        Of the flight.
    navigation
        Tells whether the lander drifts over what it maps.
    mappers
        By name.
    """

    def __init__(
        self, briefing: Briefing, navigation: Navigation, mappers: Mapping[str, HazardMapper]
    ) -> None:
        software = briefing.software
        self.briefing, self.lander = briefing, briefing.lander
        self.approach, self.decisions = software.approach, software.decisions
        self._navigation, self._mappers = navigation, mappers
        descent = self.approach.vertical_altitude / self.approach.rate
        self._aim = Aim(self.decisions.touchdown_sigma, descent)

    @property
    def decisions_map(self) -> str:
        """Name of the mapper whose map decides; empty for a lander without one.

        If the scenario names none: the first that is made of others, else the first.
        """
        joined = (name for name, mapper in self._mappers.items() if mapper.sources)
        return str(self.decisions.map or next(joined, next(iter(self._mappers), "")))

    @property
    def mapper(self) -> HazardMapper | None:
        """The mapper whose map decides; None for a lander without one."""
        return self._mappers.get(self.decisions_map)

    def mapped(self, names: set[str], time: float) -> None:
        """Note which maps have taken something in, and when, s."""
        if self.decisions_map in names:
            self._aim.mapped_at = time

    def cost_of(
        self, sites: Array, estimate: Estimate, times: Array | None = None
    ) -> DivertCost:  # fmt: skip
        """Return what it costs to fly from an estimate to each of the sites (n, 3), local frame.

        With `times` (n,), s, that of the path that takes so long, else of the cheapest.
        """
        cost: DivertCost = self.briefing.software.guidance.cost(
            estimate,
            self.approach.end(sites, self.lander),
            self.lander,
            self.briefing.weight,
            self.approach.limits,
            # A law that knows of no times is not asked for them.
            *(() if times is None else (times,)),
        )
        return cost

    def time_to(
        self, site: Array, estimate: Estimate, stretch: float | None = None
    ) -> tuple[float, str]:
        """Return the time-to-go to a site (3,), s, and why it is not that of a stretch.

        That of the cheapest path within all limits, NaN without any; with a stretch so many times
        it, if that keeps them too.
        """
        one = np.asarray(site, dtype=np.float64)[None]
        cheapest = self.cost_of(one, estimate).time_to_go
        if stretch is None:
            return float(cheapest[0]), ""
        if not np.isfinite(cheapest[0]):
            return float("nan"), "out of reach"
        if not self.cost_of(one, estimate, stretch * cheapest).feasible[0]:
            return float(cheapest[0]), "beyond the limits"
        return stretch * float(cheapest[0]), ""

    def in_sight(self, site: Array, estimate: Estimate) -> bool:
        """Tell whether a site (3,) is seen through the window, where the scenario has one."""
        window = self.briefing.software.window
        return window is None or bool(window.sees(estimate, site))

    def _designable(self, sites: Array, estimate: Estimate) -> DivertCost:
        """Return what sites cost (n, 3); those that are not seen through a window are out of reach.

        A look angle is taken only where the scenario has a window.
        """
        cost, window = self.cost_of(sites, estimate), self.briefing.software.window
        if window is None:
            return cost
        seen = window.sees(estimate, sites)
        return replace(
            cost,
            propellant=np.where(seen, cost.propellant, np.inf),
            time_to_go=np.where(seen, cost.time_to_go, np.nan),
        )

    def observe(self, course: Course) -> Observation:
        """Return what a policy is shown on a course.

        Raises
        ------
        RuntimeError
            If there is no map.
        """
        mapper = self.mapper
        if mapper is None:
            raise RuntimeError("this lander has no mapper: there is nothing to decide on")
        site, estimate = course.site, course.estimate
        part = self.briefing.software.mappers[self.decisions_map]
        hazard_map = asked_map(self.decisions_map, part, mapper, course.time)
        miss = float(self._miss_of(np.array([course.time_to_go]), course)[0])
        aim = self._aim.spread(hazard_map, miss)
        scoreboard = mapper.scoreboard(site)
        designable = partial(self._designable, estimate=estimate)
        reach = Reach.under(hazard_map, site, designable)
        candidates = candidate_sites(
            hazard_map,
            aim,
            site,
            designable,
            count=self.decisions.candidates,
            separation=self.decisions.separation,
            miss_of=partial(self._miss_of, course=course) if self._navigation.adrift else None,
            mapper=self.decisions_map,
            scoreboard=scoreboard,
            reach=reach,
        )
        row, col = (int(v) for v in hazard_map.grid.cell(site[:2]))
        inside = bool(hazard_map.grid.contains(site[:2]))
        seen = inside and bool(hazard_map.observed[row, col])
        return Observation(
            time=course.time,
            estimate=estimate,
            hazard_map=hazard_map,
            candidates=candidates,
            site=site,
            site_p_safe=float(aim[row, col]) if seen else float("nan"),
            site_propellant=float(self.cost_of(site[None, :], estimate).propellant[0]),
            time_to_go=course.time_to_go,
            propellant=course.mass - self.lander.dry_mass,
            site_eligible=bool(hazard_map.eligible_at(site[:2])),
            site_value=float(hazard_map.value_at(site[:2])),
            scoreboard=scoreboard,
            expected_miss=miss,
            reach=reach,
        )

    def _miss_of(self, time_to_go: Array, course: Course) -> Array:
        """Return the expected miss of sites that take so long to reach (n,), s, an axis, m."""
        until = np.where(np.isfinite(time_to_go), time_to_go, course.time_to_go)
        return self._aim.misses(course.estimate, self._navigation.adrift, until)
