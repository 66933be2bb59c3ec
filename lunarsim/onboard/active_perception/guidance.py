"""Information-seeking guidance law: plans paths by what the sensors observe.

At fixed intervals the planner (`InformationPlanner`) searches for the path that gains most
information about the terrain within reach, within the propellant that the mission allows. It uses
the current hazard map, the navigation estimate, and the rocks and the Sun of the briefing. Between
plans the path is flown as by the Apollo law. Once observations no longer count, because no decision
follows, the lander descends on the minimum-propellant path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.active_perception.information import ExpectedRocks
from lunarsim.onboard.active_perception.planner import InformationPlanner, PathPlan, PlanningProblem
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
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite

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
    """Settings of guidance on Apollo paths that maximise hazard information.

    The paths are chosen by what the sensors observe of the terrain that the lander can still reach.
    The cost of reaching a site is that of the paths of the Apollo law.

    Attributes
    ----------
    interval
        Time between plans, s.
    candidates
        Number of paths evaluated for a plan.
    nodes_per_side
        Number of terrain squares along a side of the map for which information is evaluated.
    propellant_allowance
        Propellant that observation may cost in total, above the minimum-propellant path, kg.
    propellant_weight
        Fraction of hazard uncertainty whose removal is worth one kilogram of propellant, 1/kg.
    min_rock_diameter
        Minimum diameter of a rock that is a hazard, m.
    max_final_tilt
        Maximum tilt of the thrust below the altitude of the last decision, rad.
    """

    interval: float = quantity(2.0, "s", gt=0, le=60, help="Time between two plans of the path")
    candidates: int = quantity(
        3000, ge=30, le=100_000, help="Number of candidate paths that are evaluated for each plan"
    )
    nodes_per_side: int = quantity(
        8,
        ge=2,
        le=40,
        help="Number of terrain squares along each side of the map, in which hazard information is "
        "evaluated",
    )
    propellant_allowance: float = quantity(
        1.5,
        "kg",
        ge=0,
        help="Maximum propellant that paths may use for better observations, in addition to that "
        "of the minimum-propellant path",
    )
    propellant_weight: float = quantity(
        0.02,
        ge=0,
        help="Fraction of the map's hazard uncertainty that a path must remove to justify using "
        "one kilogram of propellant",
    )
    min_rock_diameter: float = quantity(
        0.5, "m", gt=0, lt=4, help="Minimum diameter at which a rock counts as a hazard"
    )
    max_final_tilt: float = quantity(
        25.0,
        "deg",
        ge=0,
        lt=85,
        help="Maximum angle of the thrust from the vertical after the last landing-site decision",
    )

    @property
    def shape(self) -> PathShape:
        """Shape of the paths: that of the Apollo law."""
        return APOLLO

    def build(self, briefing: Briefing, lag: float) -> InformationSeekingGuidance:  # type: ignore[override]
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.

        Raises
        ------
        InputError
            If no mapper uses a tasked sensor on a gimbal, so that nothing can be observed.
        """
        return InformationSeekingGuidance(self, briefing, lag)


class InformationSeekingGuidance:
    """Guidance of one flight on paths that maximise hazard information.

    Attributes
    ----------
    hazard_map_source
        Function that returns the current hazard map; None until the onboard computer sets it.
    arrival
        Planned time of the end of the approach, s; None before the first command.
    events
        Events: time (s), name ("guidance-fallback", "guidance-planned", "observation-phase-ended"),
        details.
    plan
        Plan being flown; None: time-to-go and end acceleration of the onboard computer are used.
    planner
        Planner of the paths.
    """

    def __init__(self, settings: InformationSeekingLaw, briefing: Briefing, lag: float) -> None:
        self.settings = settings
        self.briefing = briefing
        self.lander, self.gravity = briefing.lander, briefing.surface_gravity
        self.hazard_map_source: Callable[[], HazardMap | None] | None = None
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.plan: PathPlan | None = None
        self.limits: PathLimits = briefing.software.approach.limits
        sensors = build_coverage_models(briefing, settings.min_rock_diameter)
        if not sensors:
            raise InputError(
                "guidance.kind", "information-seeking",
                "'information-seeking' needs a camera or LiDAR with a table [tasking.NAME] "
                "and a mapper that uses it",
                "A camera also needs a Sun elevation between 2 and 80 deg.", show_value=False,
            )  # fmt: skip
        schedules = [
            _measurement_altitudes(briefing.software.tasking[sensor.name]) for sensor in sensors
        ]
        self.planner = InformationPlanner(
            sensors,
            schedules,
            settings.candidates,
            settings.propellant_weight,
            settings.max_final_tilt,
        )
        rocks = ExpectedRocks.golombek(briefing.rocks.cover, settings.min_rock_diameter)
        self._prior = rocks.hazard_probability(footprint_radius(briefing))
        self._lag_model = ActuatorLagModel(lag)
        self._apollo = PathGuidance(
            APOLLO, self.gravity, lag_model=self._lag_model,
            min_time_to_go=settings.min_time_to_go, gravity_model=briefing.nonuniform_gravity,
        )  # fmt: skip
        self._end: PhaseEnd | None = None
        self._next = -np.inf
        self._budget: float | None = None  # minimum mass after propellant used for observation, kg
        self._lowest = np.inf
        self._observation_over = self._has_fallen_back = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, after planning if it is due.

        `end` is the end of the approach, `time` the current time and `time_to_go` the time-to-go
        from the onboard computer, s, which is used at the first command and after a divert until a
        plan exists.
        """
        require_finite_state(estimate, end)
        check_finite("guidance.time_to_go", time_to_go)
        self._lag_model.advance(time)
        moved = self._end is not None and _horizontal_distance(self._end, end) > _DIVERT_DISTANCE_M
        if self.arrival is None or moved:
            self.arrival = time + time_to_go  # the computer's estimate
        site = self._landing_site(end)
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
        """Return whether another plan may be made at `time`, s.

        A decision on the site must still follow, and more than 6 s must be left.
        """
        return (
            not self._is_past_decisions
            and self.arrival is not None
            and self.arrival - time > _MIN_REPLANNING_TIME_S
        )

    @property
    def _is_past_decisions(self) -> bool:
        """Whether observations no longer matter, because no site decision follows."""
        return bool(self._lowest <= self.briefing.software.decisions.last_altitude)

    def _cheapest_path(
        self, estimate: Estimate, end: PhaseEnd, limits: PathLimits, min_time: float = 0.0
    ) -> tuple[float, float]:
        """Return propellant (kg) and time-to-go (s) of the cheapest admissible path.

        The path starts at `estimate`, ends at `end`, keeps `limits`, and takes at least
        `min_time`, s. Without an admissible path the results are inf and NaN.
        """
        end_batch = replace(end, position=end.position[None, :])
        cost = divert_cost(
            estimate,
            end_batch,
            self.lander,
            self.gravity,
            limits=limits,
            min_times=np.array([min_time]),
        )
        return float(cost.propellant[0]), float(cost.time_to_go[0])

    def _landing_site(self, end: PhaseEnd) -> Array:
        """Return the site (3,), m, above which the approach ends at `end`."""
        approach = self.briefing.software.approach
        height = approach.end(np.zeros(3), self.lander).position
        return np.asarray(end.position - height)

    # --- Plans ----------------------------------------------------------------------------

    def _predict_state(self, estimate: Estimate) -> Estimate:
        """Return the state predicted for the time when a command takes effect.

        `estimate` is the current state; only position and velocity are changed.
        """
        position, velocity = self._lag_model.predict(estimate)
        return replace(estimate, position=position, velocity=velocity)

    def _replan(
        self, estimate: Estimate, end: PhaseEnd, time: float, site: Array, previous: PathPlan | None
    ) -> None:
        """Plan the best path from the state at which commands take effect, or fall back.

        Without a map or an admissible path, the plan stays as it is (none after a divert). If no
        site decision follows any more, the descent begins instead. `site` (3,), m, is the landing
        site, and `previous` the plan flown before; None: none. `time` is the current time, s.
        """
        if self._is_past_decisions:
            self._begin_descent(estimate, end, time)
            return
        start, lead = self._predict_state(estimate), self._lag_model.lag
        cheapest, fastest = self._cheapest_path(start, end, self.limits)
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
            "known_fraction": plan.known_fraction, "propellant": plan.propellant,
            "time_to_go": plan.time_to_go,
        }))  # fmt: skip

    def _propellant_limit(self, mass: float, cheapest: float) -> float:
        """Return the propellant that a path may use, kg: the rest of the initial budget.

        The budget is fixed once: the propellant of the cheapest path at the first plan plus the
        allowance; until a path exists, the result is infinite. `mass` is the current mass, kg. The
        result is at least `cheapest`, the propellant of the cheapest path, kg, so that the site
        can still be reached when the budget is used up.
        """
        if self._budget is None:
            if not np.isfinite(cheapest):
                return float("inf")
            self._budget = mass - cheapest - self.settings.propellant_allowance
        return max(mass - self._budget, cheapest if np.isfinite(cheapest) else 0.0)

    def _fall_back(self, time: float, reason: str) -> None:
        """Record at `time`, s, that no new plan was found, and the `reason`.

        The last plan, or the path of the onboard computer, is flown further. Only the first of
        consecutive failures is recorded.
        """
        if not self._has_fallen_back:
            self.events.append((time, "guidance-fallback", {"reason": reason}))
        self._has_fallen_back = True

    def _begin_descent(self, estimate: Estimate, end: PhaseEnd, time: float) -> None:
        """Start the descent on a path with little tilt once observations no longer matter.

        Paths with less tilt are preferred. For the same tilt limit the slower variant is preferred,
        because a reversal of the tilt takes one or two seconds. The propellant above that of the
        cheapest candidate is limited by the allowance, since a path with almost no tilt can hover
        down for minutes. If no path is admissible, the plan is flown to its end, which also keeps
        the maximum tilt. The same holds if all paths hover near the height of the end, because this
        would end the phase beside the end point. After a divert without a plan, a hovering path is
        accepted.
        """
        paths = self._descent_paths(self._predict_state(estimate), end)
        if not paths:
            return
        max_propellant = (
            min(propellant for propellant, _, _ in paths) + self.settings.propellant_allowance
        )
        _, fastest, tilt = next(path for path in paths if path[0] <= max_propellant)
        self.plan, self._observation_over = None, True
        self.arrival = time + fastest + self._lag_model.lag
        self.events.append((time, "observation-phase-ended", {"time_to_go": fastest, "tilt": tilt}))

    def _descent_paths(self, start: Estimate, end: PhaseEnd) -> list[tuple[float, float, float]]:
        """Return candidate paths for the descent after observation, by increasing tilt.

        Each is propellant (kg), time-to-go (s) and tilt limit (rad). Paths that sink to the height
        of `end` too early are excluded, unless only they exist and there is no plan. `start` is the
        state at the start of the paths.
        """
        paths = []
        for tilt_fraction in _TILT_FRACTIONS:
            tilt = tilt_fraction * min(self.settings.max_final_tilt, self.limits.max_tilt)
            limits = replace(self.limits, max_tilt=tilt)
            fast_propellant, fastest = self._cheapest_path(start, end, limits)
            calm_propellant, slower = self._cheapest_path(
                start, end, limits, _CALM_TIME_RATIO * fastest
            )
            paths += [(calm_propellant, slower, tilt), (fast_propellant, fastest, tilt)]
        paths = [path for path in paths if np.isfinite(path[0])]
        monotonic = [path for path in paths if self._descends_monotonically(start, end, path[1])]
        return monotonic if monotonic or self.plan is not None else paths

    def _descends_monotonically(self, start: Estimate, end: PhaseEnd, time_to_go: float) -> bool:
        """Return whether a path stays sufficiently above its final height until its end.

        At each time before the end, the remaining height must be at least half of the final sink
        rate times the remaining time. `start` is the state at the start of the path and
        `time_to_go` its duration, s.
        """
        path = self.settings.shape.path(start.position, start.velocity, end, time_to_go)
        height = path.at(_CHECKED_FRACTIONS * time_to_go)[0][:, 2] - end.position[2]
        remaining = (1.0 - _CHECKED_FRACTIONS) * time_to_go
        return bool((height >= _MIN_SINK_RATIO * -end.velocity[2] * remaining).all())

    def problem(self, start: Estimate, end: PhaseEnd, site: Array) -> PlanningProblem | None:
        """Return the inputs of path planning; None without a hazard map.

        `start` is the state at the start of the path, `end` the end of the approach and `site` (3,)
        the landing site, m.
        """
        hazard_map = None if self.hazard_map_source is None else self.hazard_map_source()
        if hazard_map is None:
            return None
        nodes = terrain_nodes(hazard_map, self.settings.nodes_per_side, self._prior, site)
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
        """Return the lateral acceleration available for a divert at a mass (kg), m/s^2."""
        max_acceleration = self.limits.thrust_range(self.lander)[1] / mass
        spare = np.sqrt(max(max_acceleration**2 - self.gravity**2, 1e-4))
        return float(min(self.gravity * np.tan(self.limits.max_tilt), spare))


def _measurement_altitudes(tasking: Any) -> MeasurementAltitudes:
    """Return the altitudes at which a sensor measures, from its tasking settings.

    Settings without altitudes get the default.
    """
    altitudes = getattr(tasking, "measurement_altitudes", None)
    return altitudes if isinstance(altitudes, MeasurementAltitudes) else MeasurementAltitudes()


def _horizontal_distance(a: PhaseEnd, b: PhaseEnd) -> float:
    """Return the horizontal distance of two phase ends, m."""
    return float(np.hypot(*(a.position[:2] - b.position[:2])))
