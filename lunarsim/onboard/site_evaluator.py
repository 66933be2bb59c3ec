"""Evaluate landing sites, and prepare the observation of the policy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits
from lunarsim.onboard.guidance.rotation import RotationLimits
from lunarsim.onboard.guidance.vertical import TerminalDescentLaw, VerticalDescent
from lunarsim.onboard.hazards.mapper import HazardMapper, checked_hazard_map
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim.onboard.policies.contract import Observation
from lunarsim.onboard.policies.expected_miss import LandingDispersion
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim.typing import Array


@dataclass(frozen=True)
class DescentStatus:
    """State of the descent at one time, from which landing sites are evaluated.

    Attributes
    ----------
    time
        Time, s.
    mass
        Estimated mass of the lander, kg.
    estimate
        Current navigation estimate.
    site
        Landing site that the lander flies to, local frame (3,), m.
    altitude
        Estimated height of the pads above the site, m.
    time_to_go
        Time until the planned end of braking or of the approach, s.
    """

    time: float
    mass: float
    estimate: Estimate
    site: Array
    altitude: float
    time_to_go: float


class SiteEvaluator:
    """Evaluates the safety and the divert cost of landing sites.

    Safety comes from the hazard map selected for decisions. The cost comes from the paths of the
    guidance law.

    Parameters
    ----------
    briefing
        Data known before the flight, including the software configuration.
    navigation
        Navigation filter; it reports whether the lander drifts relative to its map.
    mappers
        Hazard mappers by name.
    terminal
        Guidance law of the terminal descent, which limits the tilt at the end of the approach if it
        is a `VerticalDescent`.

    Attributes
    ----------
    rotation_limits
        Limits of rotation, which every path must leave time for.
    path_limits
        Limits of thrust, tilt, glideslope and propellant of every path.
    """

    def __init__(
        self,
        briefing: Briefing,
        navigation: Navigation,
        mappers: Mapping[str, HazardMapper],
        terminal: TerminalDescentLaw | None = None,
    ) -> None:
        software = briefing.software
        self.briefing, self.lander = briefing, briefing.lander
        self.approach, self.decisions = software.approach, software.decisions
        self._navigation, self._mappers = navigation, mappers
        descent = self.approach.vertical_altitude / self.approach.vertical_descent_speed
        self.rotation_limits = RotationLimits.of(self.lander, software.control)
        self.path_limits = self._path_limits(terminal)
        self._dispersion = LandingDispersion(self.decisions.touchdown_sigma, descent)

    def _path_limits(self, terminal: TerminalDescentLaw | None) -> PathLimits:
        """Return the limits of every path.

        The tilt at the end of the approach shifts the touchdown at most by the expected landing
        error, unless the scenario sets an arrival acceleration with more tilt.
        """
        approach = self.approach
        limits: PathLimits = approach.limits
        if not isinstance(terminal, VerticalDescent):
            return limits
        shift = self.decisions.touchdown_sigma
        tilt = terminal.max_final_tilt(self.lander.wet_mass, approach.max_tilt, shift)
        east, north, up = approach.arrival_acceleration
        planned = float(np.arctan2(np.hypot(east, north), up + self.briefing.surface_gravity))
        return replace(limits, max_final_tilt=max(tilt, planned))

    @property
    def decision_map_name(self) -> str:
        """Name of the mapper whose map is used for decisions; empty without a mapper.

        If the scenario does not name a mapper, this is the first mapper that combines other maps.
        If no mapper combines maps, it is the first mapper.
        """
        combining = (name for name, mapper in self._mappers.items() if mapper.source_mappers)
        return str(self.decisions.map or next(combining, next(iter(self._mappers), "")))

    @property
    def mapper(self) -> HazardMapper | None:
        """Mapper whose map is used for decisions; None for a lander without one."""
        return self._mappers.get(self.decision_map_name)

    def record_update(self, updated_mappers: set[str], time: float) -> None:
        """Record the time of a measurement if it changed the map used for decisions.

        `updated_mappers` are the names of the mappers whose maps changed at `time`, s.
        """
        if self.decision_map_name in updated_mappers:
            self._dispersion.last_scan_time = time

    def cost_of(
        self, sites: Array, estimate: Estimate, times: Array | None = None
    ) -> DivertCost:  # fmt: skip
        """Return the propellant and time-to-go of flying from an estimate to each site.

        Sites are (n, 3), local frame, m. The result also states which sites are within the limits.
        With `times` (n,), s, the cost is that of the path with this time-to-go, otherwise that of
        the minimum-propellant path. Every path leaves time for the rotation with which it begins
        (`RotationLimits`), so its time-to-go may be longer.
        """
        law, end = self.briefing.software.guidance, self.approach.end(sites, self.lander)
        gravity, limits = self.briefing.surface_gravity, self.path_limits
        # Guidance laws need not accept times.
        given = () if times is None else (times,)
        cost: DivertCost = law.cost(estimate, end, self.lander, gravity, limits, *given)
        return self.rotation_limits.limit(cost, law, estimate, end, gravity, limits)

    def time_to(
        self, site: Array, estimate: Estimate, time_scale: float | None = None
    ) -> tuple[float, str]:
        """Return the time-to-go to a site (3,), s, and why a time scale was refused.

        Without `time_scale`, this is the time-to-go of the minimum-propellant path within all
        limits, or NaN if no such path exists. `time_scale` is a factor on it, which is refused if
        the resulting path does not keep the limits. The reason is an empty text if nothing was
        refused. The site is in the local frame, m.
        """
        one = np.asarray(site, dtype=np.float64)[None]
        cheapest = self.cost_of(one, estimate).time_to_go
        if time_scale is None:
            return float(cheapest[0]), ""
        if not np.isfinite(cheapest[0]):
            return float("nan"), "out of reach"
        scaled = time_scale * cheapest
        # The path is longer if this time is too short for the first rotation.
        if self.cost_of(one, estimate, scaled).time_to_go[0] != scaled[0]:
            return float(cheapest[0]), "beyond the limits"
        return float(scaled[0]), ""

    def max_tilt(self, time_to_go: float, mass: float) -> float:
        """Return the maximum tilt (rad) at a time-to-go (s) of the approach.

        From this tilt, the lander can still rotate to the maximum tilt at the end of the approach.
        `mass` is in kg.
        """
        limits = self.path_limits
        turn = self.rotation_limits.angle(time_to_go, mass)
        return min(limits.max_final_tilt + turn, limits.max_tilt)

    def is_visible(self, site: Array, estimate: Estimate) -> bool:
        """Return whether a site (3,), m, is visible through the crew window.

        `estimate` is the pose of the lander, and the site is in the local frame. Without a window,
        the result is always True.
        """
        window = self.briefing.software.designation_window
        return window is None or bool(window.is_visible(estimate, site))

    def _cost_of_visible(self, sites: Array, estimate: Estimate) -> DivertCost:
        """Return the divert cost of sites (n, 3), m; infinite for sites not visible.

        Sites outside the crew window are not visible: their propellant is infinite and their
        time-to-go NaN. Without a window, all sites are visible.
        """
        cost, window = self.cost_of(sites, estimate), self.briefing.software.designation_window
        if window is None:
            return cost
        seen = window.is_visible(estimate, sites)
        return replace(
            cost,
            propellant=np.where(seen, cost.propellant, np.inf),
            time_to_go=np.where(seen, cost.time_to_go, np.nan),
        )

    def observe(self, status: DescentStatus) -> Observation:
        """Return the policy's observation for a state of the descent (`status`).

        Raises
        ------
        RuntimeError
            If the lander has no mapper.
        """
        mapper = self.mapper
        if mapper is None:
            raise RuntimeError("this lander has no mapper, so no map is available for decisions")
        site, estimate = status.site, status.estimate
        part = self.briefing.software.mappers[self.decision_map_name]
        hazard_map = checked_hazard_map(self.decision_map_name, part, mapper, status.time)
        miss = float(self._miss_of(np.array([status.time_to_go]), status)[0])
        aim = self._dispersion.averaged_p_safe(hazard_map, miss)
        scoreboard = mapper.scoreboard(site)
        cost_of_visible = partial(self._cost_of_visible, estimate=estimate)
        reach = ReachabilityMap.over_map(hazard_map, site, cost_of_visible)
        candidates = candidate_sites(
            hazard_map,
            aim,
            site,
            cost_of_visible,
            count=self.decisions.candidates,
            separation=self.decisions.separation,
            miss_of=partial(self._miss_of, status=status) if self._navigation.is_drifting else None,
            mapper=self.decision_map_name,
            scoreboard=scoreboard,
            reach=reach,
        )
        row, col = (int(v) for v in hazard_map.grid.cell(site[:2]))
        inside = bool(hazard_map.grid.contains(site[:2]))
        seen = inside and bool(hazard_map.observed[row, col])
        return Observation(
            time=status.time,
            estimate=estimate,
            hazard_map=hazard_map,
            candidates=candidates,
            site=site,
            site_p_safe=float(aim[row, col]) if seen else float("nan"),
            site_propellant=float(self.cost_of(site[None, :], estimate).propellant[0]),
            time_to_go=status.time_to_go,
            propellant=status.mass - self.lander.dry_mass,
            site_eligible=bool(hazard_map.eligible_at(site[:2])),
            site_value=float(hazard_map.value_at(site[:2])),
            scoreboard=scoreboard,
            expected_miss=miss,
            reachability=reach,
        )

    def _miss_of(self, time_to_go: Array, status: DescentStatus) -> Array:
        """Return the expected landing miss for times-to-go (n,), s: 1 sigma per axis, m.

        Where a time-to-go is not finite, the one of `status` is used.
        """
        until = np.where(np.isfinite(time_to_go), time_to_go, status.time_to_go)
        return self._dispersion.expected_misses(
            status.estimate, self._navigation.is_drifting, until
        )
