"""The law that looks where it lands: paths chosen anew as it flies for what they let it see.

Every so often the planner (`SeekingPlanner`) looks for the path after which most is known of the
ground that can still be landed on, for no more propellant than the mission allows. It is asked with
what the lander believes: the hazard map as it stands, its own place, the rocks and the Sun of the
briefing. In between the path is flown as the Apollo law flies its own. Once looks no longer count
the lander goes down by the cheapest path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.contract import PhaseEnd, refuse_unknown
from lunarsim.onboard.guidance.divert import PathLimits, divert_cost
from lunarsim.onboard.guidance.following import Answering, PathGuidance
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.seeking.eyes import eyes_of, footprint_of
from lunarsim.onboard.seeking.ground import nodes_of
from lunarsim.onboard.seeking.information import ExpectedRocks
from lunarsim.onboard.seeking.planner import Plan, Problem, SeekingPlanner
from lunarsim.onboard.tasking.contract import Looks
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]

_MOVED = 1.0  # of the end, m: a divert
# With less time left than this the last plan is flown out, s.
_LAST = 6.0
# After a look the map is drawn anew within so long, s.
_DRAWN = 1.0
# Shares of the greatest lean that are tried in turn for the way down after the looks.
_UPRIGHT = (0.6, 0.8, 1.0)
# So many times the time of the cheapest one it takes there.
_CALM = 1.4
# Share of the speed downward at the end by which it sinks at least, on the mean of what is left.
_SINKING = 0.5
_LOOKED_AT = np.linspace(0.0, 1.0, 101)[:-1]  # shares of its time


@dataclass(frozen=True)
class InformationSeekingLaw(PathLaw):
    """Paths that reduce what is not known of the ground in reach; the Apollo law's in between.

    What it costs to reach a site is told by the paths of the Apollo law.

    Attributes
    ----------
    interval
        Between plans, s.
    candidates
        Paths looked at for a plan.
    squares
        Of the ground along a side of the map.
    allowance
        Propellant that seeing may cost over the cheapest path, in all, kg.
    price
        Share of the uncertainty that a kilogram of propellant is worth, 1/kg.
    least_diameter
        Of a rock that is a hazard, m.
    end_tilt
        Greatest lean of the thrust once looks no longer count, rad.
    """

    interval: float = quantity(2.0, "s", gt=0, le=60, help="between plans")
    candidates: int = quantity(3000, ge=30, le=100_000, help="paths looked at for a plan")
    squares: int = quantity(8, ge=2, le=40, help="of the ground along a side of the map")
    allowance: float = quantity(
        1.5, "kg", ge=0, help="propellant that seeing may cost over the cheapest path"
    )
    price: float = quantity(0.02, ge=0, help="share of the uncertainty that a kilogram is worth")
    least_diameter: float = quantity(0.5, "m", gt=0, lt=4, help="of a rock that is a hazard")
    end_tilt: float = quantity(25.0, "deg", ge=0, lt=85, help="greatest below the last decision")

    @property
    def shape(self) -> PathShape:
        """Of its paths."""
        return APOLLO

    def build(self, briefing: Briefing, lag: float) -> SeekingGuidance:  # type: ignore[override]
        """Return the law of one flight.

        Raises
        ------
        InputError
            If the lander has no sensor on a gimbal, or no mapper that takes it in: nothing to see
            by.
        """
        return SeekingGuidance(self, briefing, lag)


class SeekingGuidance:
    """The law in flight; see `InformationSeekingLaw`.

    Attributes
    ----------
    belief
        Gives the hazard map as it stands; None before the computer has said so.
    arrival
        When it means to be at the end, s; None before the first command.
    events
        What happened: time (s), name ("guidance-fallback", "guidance-planned", "seeking-over"),
        details.
    plan
        What is flown, as it was made; None: the computer's time-to-go and end.
    planner
        What looks for plans.
    """

    def __init__(self, settings: InformationSeekingLaw, briefing: Briefing, lag: float) -> None:
        self.settings = settings
        self.briefing = briefing
        self.lander, self.gravity = briefing.lander, briefing.weight
        self.belief: Callable[[], HazardMap | None] | None = None
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.plan: Plan | None = None
        self.limits: PathLimits = briefing.software.approach.limits
        eyes = eyes_of(briefing, settings.least_diameter)
        if not eyes:
            raise InputError(
                "guidance.kind", "information-seeking",
                "a lander with a tasked camera or LiDAR that a mapper takes in, and for a camera a "
                "Sun between 2 and 80 deg high",
            )  # fmt: skip
        looks = [_looks(briefing.software.tasking[eye.name]) for eye in eyes]
        self.planner = SeekingPlanner(
            eyes, looks, settings.candidates, settings.price, settings.end_tilt
        )
        rocks = ExpectedRocks.of(briefing.rocks.cover, settings.least_diameter)
        self._prior = rocks.hazard(footprint_of(briefing))
        self._answering = Answering(lag)
        self._apollo = PathGuidance(
            APOLLO, self.gravity, answering=self._answering,
            least_time_to_go=settings.least_time_to_go, field=briefing.field,
        )  # fmt: skip
        self._end: PhaseEnd | None = None
        self._next = -np.inf
        self._budget: float | None = None  # mass below which seeing may not burn, kg
        self._lowest = np.inf
        self._over = self._fallen = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2."""
        refuse_unknown(estimate, end)
        if not np.isfinite(time_to_go):
            raise InputError("guidance.time_to_go", time_to_go, "a finite time in s")
        self._answering.follow(time)
        moved = self._end is not None and _apart(self._end, end) > _MOVED
        if self.arrival is None or moved:
            self.arrival = time + time_to_go  # the computer's guess
        site = self._site(end)
        altitude = float(estimate.position[2] - site[2] - self.lander.com_height)
        self._lowest = min(self._lowest, altitude)
        if moved or self._end is None or (time >= self._next - 1e-9 and self._open(time)):
            self._end, self._next = end, time + self.settings.interval
            flown = self.plan
            if moved:
                self.plan = None  # it ends elsewhere: only as a first guess is it good
            self._replan(estimate, end, time, site, flown)
        elif self._late and not self._over:
            self._go_down(estimate, end, time)
        asked = end if self.plan is None else replace(end, acceleration=self.plan.acceleration)
        return self._apollo.command(estimate, asked, time, self.arrival - time)

    def _open(self, time: float) -> bool:
        """Tell whether plans are still made."""
        return not self._late and self.arrival is not None and self.arrival - time > _LAST

    @property
    def _late(self) -> bool:
        """Whether looks no longer count: nothing is decided by them."""
        return bool(self._lowest <= self.briefing.software.decisions.last_altitude)

    def _cheapest(
        self, estimate: Estimate, end: PhaseEnd, limits: PathLimits, least: float = 0.0
    ) -> tuple[float, float]:
        """Return propellant (kg) and time-to-go (s) of the cheapest path; inf and NaN: none.

        It takes no less than `least`, s.
        """
        one = replace(end, position=end.position[None, :])
        cost = divert_cost(
            estimate, one, self.lander, self.gravity, limits=limits, least_times=np.array([least])
        )
        return float(cost.propellant[0]), float(cost.time_to_go[0])

    def _site(self, end: PhaseEnd) -> Array:
        """Return the site of an end of the approach (3,), m."""
        approach = self.briefing.software.approach
        above = approach.end(np.zeros(3), self.lander).position
        return np.asarray(end.position - above)

    # --- plans ----------------------------------------------------------------------------

    def _ahead(self, estimate: Estimate) -> Estimate:
        """Return where the lander is when a command takes effect."""
        position, velocity = self._answering.ahead(estimate)
        return replace(estimate, position=position, velocity=velocity)

    def _replan(
        self, estimate: Estimate, end: PhaseEnd, time: float, site: Array, flown: Plan | None
    ) -> None:
        """Look for the best path from where commands take effect; `flown`: the one so far."""
        if self._late:
            self._go_down(estimate, end, time)
            return
        here, lead = self._ahead(estimate), self._answering.lead
        cheapest, soonest = self._cheapest(here, end, self.limits)
        left = (self.arrival or time) - time - lead
        problem = self.problem(here, end, site)
        last = None if flown is None else replace(flown, time_to_go=left)
        expected = soonest if np.isfinite(soonest) else max(left, 1.0)
        most = self._most(estimate.mass, cheapest)
        plan = None if problem is None else self.planner.best(problem, expected, most, last)
        if plan is None:
            self._fall_back(time, "no map" if problem is None else "no admissible path")
            return
        self._fallen = False
        self.plan = plan
        self.arrival = time + lead + plan.time_to_go
        self.events.append((time, "guidance-planned", {
            "known": plan.known, "propellant": plan.propellant, "time_to_go": plan.time_to_go,
        }))  # fmt: skip

    def _most(self, mass: float, cheapest: float) -> float:
        """Return the propellant that a path may take, kg: what is left of that of the first plan.

        A site that is dearer than that may be flown to all the same.
        """
        if self._budget is None:
            if not np.isfinite(cheapest):
                return float("inf")
            self._budget = mass - cheapest - self.settings.allowance
        return max(mass - self._budget, cheapest if np.isfinite(cheapest) else 0.0)

    def _fall_back(self, time: float, why: str) -> None:
        """Fly on as before: by the last plan to this end, or as the computer wants it."""
        if not self._fallen:
            self.events.append((time, "guidance-fallback", {"reason": why}))
        self._fallen = True

    def _go_down(self, estimate: Estimate, end: PhaseEnd, time: float) -> None:
        """Take a path that leans little where looks no longer count, if there is one.

        The less the better, and not in haste: a lander that is to lean to the other side takes a
        second or two to turn over. But for that no more is burnt over the cheapest of these paths
        than seeing may cost: one that leans by hardly more than nothing may hover down for
        minutes. Where there is none the plan is flown out, which keeps the greatest lean too;
        so it is where they all hover about the height of the end, which would end the phase beside
        it. After a divert that no plan was found for, one that hovers is better than none.
        """
        ways = self._ways_down(self._ahead(estimate), end)
        if not ways:
            return
        most = min(propellant for propellant, _, _ in ways) + self.settings.allowance
        _, soonest, lean = next(way for way in ways if way[0] <= most)
        self.plan, self._over = None, True
        self.arrival = time + soonest + self._answering.lead
        self.events.append((time, "seeking-over", {"time_to_go": soonest, "lean": lean}))

    def _ways_down(self, here: Estimate, end: PhaseEnd) -> list[tuple[float, float, float]]:
        """Return propellant (kg), time-to-go (s) and lean (rad) of paths, the calmest first."""
        ways = []
        for share in _UPRIGHT:
            lean = share * min(self.settings.end_tilt, self.limits.max_tilt)
            limits = replace(self.limits, max_tilt=lean)
            hasty, soonest = self._cheapest(here, end, limits)
            calm, slower = self._cheapest(here, end, limits, _CALM * soonest)
            ways += [(calm, slower, lean), (hasty, soonest, lean)]
        ways = [way for way in ways if np.isfinite(way[0])]
        sinking = [way for way in ways if self._sinks(here, end, way[1])]
        return sinking if sinking or self.plan is not None else ways

    def _sinks(self, here: Estimate, end: PhaseEnd, time_to_go: float) -> bool:
        """Tell whether a path comes to the height of its end no sooner than to its end."""
        path = self.settings.shape.path(here.position, here.velocity, end, time_to_go)
        above = path.at(_LOOKED_AT * time_to_go)[0][:, 2] - end.position[2]
        left = (1.0 - _LOOKED_AT) * time_to_go
        return bool((above >= _SINKING * -end.velocity[2] * left).all())

    def problem(self, here: Estimate, end: PhaseEnd, site: Array) -> Problem | None:
        """Return what a plan is to be made for; None without a map."""
        hazard_map = None if self.belief is None else self.belief()
        if hazard_map is None:
            return None
        nodes = nodes_of(hazard_map, self.settings.squares, self._prior, site)
        away = np.hypot(*(nodes[:, :2] - site[:2]).T)
        # A path with T left answers a step d to the side with 6 d / T^2 at once; before that the
        # map has to be drawn, and the site chosen.
        decisions = self.briefing.software.decisions
        needs = np.sqrt(6.0 * away / self._aside(here.mass)) + _DRAWN + decisions.interval
        return Problem(
            here, end, site, np.column_stack((nodes, needs)), self.lander, self.gravity,
            self.limits, self.lander.com_height, decisions.last_altitude, self._lowest,
        )  # fmt: skip

    def _aside(self, mass: float) -> float:
        """Return the acceleration that a divert may ask for to the side, m/s^2."""
        lander = self.lander
        margin = self.limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
        most = (lander.thrust_max - margin) / mass
        spare = np.sqrt(max(most**2 - self.gravity**2, 1e-4))
        return float(min(self.gravity * np.tan(self.limits.max_tilt), spare))


def _looks(part: Any) -> Looks:
    """Return when a schedule measures."""
    known = getattr(part, "looks", None)
    return known if isinstance(known, Looks) else Looks()


def _apart(a: PhaseEnd, b: PhaseEnd) -> float:
    return float(np.hypot(*(a.position[:2] - b.position[:2])))
