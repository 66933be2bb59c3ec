"""Information-seeking guidance law: plans paths by what the sensors observe.

At fixed intervals the planner (`SeekingPlanner`) searches for the path that gains most information
about the terrain within reach, within the propellant that the mission allows. It uses the current
hazard map, the navigation estimate, and the rocks and the Sun of the briefing. Between plans the
path is flown as by the Apollo law. Once observations no longer count, because no decision follows,
the lander descends on the minimum-propellant path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.active_perception.information import ExpectedRocks
from lunarsim.onboard.active_perception.planner import PathPlan, PlanningProblem, SeekingPlanner
from lunarsim.onboard.active_perception.sensor_coverage import (
    build_coverage_models,
    footprint_radius,
)
from lunarsim.onboard.active_perception.terrain_nodes import terrain_nodes
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.guidance.divert_cost import PathLimits, divert_cost
from lunarsim.onboard.guidance.path_guidance import ActuatorLagModel, PathGuidance
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.tasking.contract import MeasurementAltitudes
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]

# A larger shift of the end of the approach is a divert.
_DIVERT_DISTANCE_M = 1.0
# With less time left, the last plan is flown to its end.
_MIN_REPLANNING_TIME_S = 6.0
# Maximum delay between an observation and the updated map.
_MAP_LATENCY_S = 1.0
# Fractions of the maximum tilt that are tried in turn for the descent after the observations.
_TILT_FRACTIONS = (0.6, 0.8, 1.0)
# The calm variant of these paths takes this multiple of the minimum-propellant time.
_CALM_TIME_RATIO = 1.4
# Minimum mean sink rate over the remaining path, as a fraction of the sink rate at the end.
_MIN_SINK_RATIO = 0.5
_CHECKED_FRACTIONS = np.linspace(0.0, 1.0, 101)[:-1]  # fractions of the time-to-go


@dataclass(frozen=True)
class InformationSeekingLaw(PathLaw):
    """Apollo-law paths that maximise the information about reachable terrain.

    The cost of reaching a site is that of the paths of the Apollo law.

    Attributes
    ----------
    interval
        Time between plans, s.
    candidates
        Number of paths evaluated for a plan.
    squares
        Terrain nodes along a side of the map.
    allowance
        Propellant that observation may cost in total, above the minimum-propellant path, kg.
    price
        Fraction of uncertainty that one kilogram of propellant is worth, 1/kg.
    least_diameter
        Minimum diameter of a rock that is a hazard, m.
    end_tilt
        Maximum tilt of the thrust below the altitude of the last decision, rad.
    """

    interval: float = quantity(2.0, "s", gt=0, le=60, help="Time between plans")
    candidates: int = quantity(3000, ge=30, le=100_000, help="Number of paths evaluated for a plan")
    squares: int = quantity(8, ge=2, le=40, help="Terrain nodes along a side of the map")
    allowance: float = quantity(
        1.5, "kg", ge=0, help="Propellant allowed for observation above the minimum"
    )
    price: float = quantity(
        0.02, ge=0, help="Weight of one kilogram of propellant, fraction of uncertainty"
    )
    least_diameter: float = quantity(
        0.5, "m", gt=0, lt=4, help="Minimum diameter of a rock that is a hazard"
    )
    end_tilt: float = quantity(
        25.0, "deg", ge=0, lt=85, help="Maximum tilt below the altitude of the last decision"
    )

    @property
    def shape(self) -> PathShape:
        """Shape of the paths."""
        return APOLLO

    def build(self, briefing: Briefing, lag: float) -> SeekingGuidance:  # type: ignore[override]
        """Return the guidance law of one flight.

        Raises
        ------
        InputError
            If no mapper uses a tasked sensor on a gimbal, so that nothing can be observed.
        """
        return SeekingGuidance(self, briefing, lag)


class SeekingGuidance:
    """Information-seeking guidance of one flight; see `InformationSeekingLaw`.

    Attributes
    ----------
    belief
        Returns the current hazard map; None until the computer sets it.
    arrival
        Planned time at the end of the approach, s; None before the first command.
    events
        Events: time (s), name ("guidance-fallback", "guidance-planned", "seeking-over"), details.
    plan
        Plan being flown; None: the time-to-go and end of the computer are used.
    planner
        Planner of the paths.
    """

    def __init__(self, settings: InformationSeekingLaw, briefing: Briefing, lag: float) -> None:
        self.settings = settings
        self.briefing = briefing
        self.lander, self.gravity = briefing.lander, briefing.weight
        self.belief: Callable[[], HazardMap | None] | None = None
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.plan: PathPlan | None = None
        self.limits: PathLimits = briefing.software.approach.limits
        sensors = build_coverage_models(briefing, settings.least_diameter)
        if not sensors:
            raise InputError(
                "guidance.kind", "information-seeking",
                "needs a tasked camera or LiDAR that a mapper uses",
                "A camera needs a Sun elevation between 2 and 80 deg.",
            )  # fmt: skip
        looks = [
            _measurement_altitudes(briefing.software.tasking[sensor.name]) for sensor in sensors
        ]
        self.planner = SeekingPlanner(
            sensors, looks, settings.candidates, settings.price, settings.end_tilt
        )
        rocks = ExpectedRocks.of(briefing.rocks.cover, settings.least_diameter)
        self._prior = rocks.hazard(footprint_radius(briefing))
        self._answering = ActuatorLagModel(lag)
        self._apollo = PathGuidance(
            APOLLO, self.gravity, answering=self._answering,
            least_time_to_go=settings.least_time_to_go, field=briefing.field,
        )  # fmt: skip
        self._end: PhaseEnd | None = None
        self._next = -np.inf
        self._budget: float | None = None  # minimum mass after propellant used for observation, kg
        self._lowest = np.inf
        self._observation_over = self._has_fallen_back = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2."""
        require_finite_state(estimate, end)
        if not np.isfinite(time_to_go):
            raise InputError("guidance.time_to_go", time_to_go, "must be a finite time in s")
        self._answering.follow(time)
        moved = self._end is not None and _horizontal_distance(self._end, end) > _DIVERT_DISTANCE_M
        if self.arrival is None or moved:
            self.arrival = time + time_to_go  # the computer's estimate
        site = self._site(end)
        altitude = float(estimate.position[2] - site[2] - self.lander.com_height)
        self._lowest = min(self._lowest, altitude)
        if moved or self._end is None or (time >= self._next - 1e-9 and self._can_replan(time)):
            self._end, self._next = end, time + self.settings.interval
            previous = self.plan
            if moved:
                self.plan = None  # it ends elsewhere and serves only as a first guess
            self._replan(estimate, end, time, site, previous)
        elif self._is_past_decisions and not self._observation_over:
            self._begin_descent(estimate, end, time)
        target_end = end if self.plan is None else replace(end, acceleration=self.plan.acceleration)
        return self._apollo.command(estimate, target_end, time, self.arrival - time)

    def _can_replan(self, time: float) -> bool:
        """Return whether enough time is left for another plan."""
        return (
            not self._is_past_decisions
            and self.arrival is not None
            and self.arrival - time > _MIN_REPLANNING_TIME_S
        )

    @property
    def _is_past_decisions(self) -> bool:
        """Whether observations no longer count, because no decision follows."""
        return bool(self._lowest <= self.briefing.software.decisions.last_altitude)

    def _cheapest(
        self, estimate: Estimate, end: PhaseEnd, limits: PathLimits, min_time: float = 0.0
    ) -> tuple[float, float]:
        """Return propellant (kg) and time-to-go (s) of the cheapest admissible path.

        It takes at least `min_time`. Without an admissible path they are inf and NaN.
        """
        end_batch = replace(end, position=end.position[None, :])
        cost = divert_cost(
            estimate,
            end_batch,
            self.lander,
            self.gravity,
            limits=limits,
            least_times=np.array([min_time]),
        )
        return float(cost.propellant[0]), float(cost.time_to_go[0])

    def _site(self, end: PhaseEnd) -> Array:
        """Return the site that belongs to an end of the approach (3,), m."""
        approach = self.briefing.software.approach
        height = approach.end(np.zeros(3), self.lander).position
        return np.asarray(end.position - height)

    # --- Plans ----------------------------------------------------------------------------

    def _ahead(self, estimate: Estimate) -> Estimate:
        """Return the estimate at the time when a command takes effect."""
        position, velocity = self._answering.ahead(estimate)
        return replace(estimate, position=position, velocity=velocity)

    def _replan(
        self, estimate: Estimate, end: PhaseEnd, time: float, site: Array, previous: PathPlan | None
    ) -> None:
        """Search for the best path from where commands take effect."""
        if self._is_past_decisions:
            self._begin_descent(estimate, end, time)
            return
        start, lead = self._ahead(estimate), self._answering.lead
        cheapest, fastest = self._cheapest(start, end, self.limits)
        remaining = (self.arrival or time) - time - lead
        problem = self.problem(start, end, site)
        last = None if previous is None else replace(previous, time_to_go=remaining)
        expected = fastest if np.isfinite(fastest) else max(remaining, 1.0)
        max_propellant = self._propellant_limit(estimate.mass, cheapest)
        plan = (
            None if problem is None else self.planner.best(problem, expected, max_propellant, last)
        )
        if plan is None:
            self._fall_back(time, "no map" if problem is None else "no admissible path")
            return
        self._has_fallen_back = False
        self.plan = plan
        self.arrival = time + lead + plan.time_to_go
        self.events.append((time, "guidance-planned", {
            "known": plan.known, "propellant": plan.propellant, "time_to_go": plan.time_to_go,
        }))  # fmt: skip

    def _propellant_limit(self, mass: float, cheapest: float) -> float:
        """Return the propellant that a path may use, kg: the rest of the initial budget.

        A site that needs more than this can still be flown to.
        """
        if self._budget is None:
            if not np.isfinite(cheapest):
                return float("inf")
            self._budget = mass - cheapest - self.settings.allowance
        return max(mass - self._budget, cheapest if np.isfinite(cheapest) else 0.0)

    def _fall_back(self, time: float, reason: str) -> None:
        """Keep the last plan to this end, or fly as the computer commands."""
        if not self._has_fallen_back:
            self.events.append((time, "guidance-fallback", {"reason": reason}))
        self._has_fallen_back = True

    def _begin_descent(self, estimate: Estimate, end: PhaseEnd, time: float) -> None:
        """Select a path with little tilt once observations no longer count.

        Paths with less tilt are preferred, and of those the slower variant, because a reversal of
        the tilt takes one or two seconds. The propellant above that of the cheapest of these paths
        is limited by the allowance, since a path with almost no tilt can hover down for minutes. If
        no path is admissible, the plan is flown to its end, which also keeps the maximum tilt. The
        same holds if all paths hover near the height of the end, because this would end the phase
        beside the end point. After a divert without a plan, a hovering path is accepted.
        """
        paths = self._descent_paths(self._ahead(estimate), end)
        if not paths:
            return
        max_propellant = min(propellant for propellant, _, _ in paths) + self.settings.allowance
        _, fastest, tilt = next(path for path in paths if path[0] <= max_propellant)
        self.plan, self._observation_over = None, True
        self.arrival = time + fastest + self._answering.lead
        self.events.append((time, "seeking-over", {"time_to_go": fastest, "lean": tilt}))

    def _descent_paths(self, start: Estimate, end: PhaseEnd) -> list[tuple[float, float, float]]:
        """Return propellant (kg), time-to-go (s) and tilt (rad), by increasing tilt."""
        paths = []
        for share in _TILT_FRACTIONS:
            tilt = share * min(self.settings.end_tilt, self.limits.max_tilt)
            limits = replace(self.limits, max_tilt=tilt)
            fast_propellant, fastest = self._cheapest(start, end, limits)
            calm_propellant, slower = self._cheapest(start, end, limits, _CALM_TIME_RATIO * fastest)
            paths += [(calm_propellant, slower, tilt), (fast_propellant, fastest, tilt)]
        paths = [path for path in paths if np.isfinite(path[0])]
        monotonic = [path for path in paths if self._descends_monotonically(start, end, path[1])]
        return monotonic if monotonic or self.plan is not None else paths

    def _descends_monotonically(self, start: Estimate, end: PhaseEnd, time_to_go: float) -> bool:
        """Return whether a path reaches the height of its end no earlier than its end."""
        path = self.settings.shape.path(start.position, start.velocity, end, time_to_go)
        height = path.at(_CHECKED_FRACTIONS * time_to_go)[0][:, 2] - end.position[2]
        remaining = (1.0 - _CHECKED_FRACTIONS) * time_to_go
        return bool((height >= _MIN_SINK_RATIO * -end.velocity[2] * remaining).all())

    def problem(self, start: Estimate, end: PhaseEnd, site: Array) -> PlanningProblem | None:
        """Return the planning problem; None without a map."""
        hazard_map = None if self.belief is None else self.belief()
        if hazard_map is None:
            return None
        nodes = terrain_nodes(hazard_map, self.settings.squares, self._prior, site)
        distance = np.hypot(*(nodes[:, :2] - site[:2]).T)
        # With time-to-go T, a lateral divert d needs an initial acceleration of 6 d / T^2. Before
        # that, the map must be updated and the site selected.
        decisions = self.briefing.software.decisions
        min_time_to_go = (
            np.sqrt(6.0 * distance / self._lateral_acceleration(start.mass))
            + _MAP_LATENCY_S
            + decisions.interval
        )
        return PlanningProblem(
            start, end, site, np.column_stack((nodes, min_time_to_go)), self.lander, self.gravity,
            self.limits, self.lander.com_height, decisions.last_altitude, self._lowest,
        )  # fmt: skip

    def _lateral_acceleration(self, mass: float) -> float:
        """Return the lateral acceleration available for a divert, m/s^2."""
        lander = self.lander
        margin = self.limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
        max_acceleration = (lander.thrust_max - margin) / mass
        spare = np.sqrt(max(max_acceleration**2 - self.gravity**2, 1e-4))
        return float(min(self.gravity * np.tan(self.limits.max_tilt), spare))


def _measurement_altitudes(part: Any) -> MeasurementAltitudes:
    """Return the altitudes at which a schedule measures."""
    known = getattr(part, "looks", None)
    return known if isinstance(known, MeasurementAltitudes) else MeasurementAltitudes()


def _horizontal_distance(a: PhaseEnd, b: PhaseEnd) -> float:
    return float(np.hypot(*(a.position[:2] - b.position[:2])))
