"""Minimum-propellant guidance by cone programs, solved about once a second.

The lossless convexification of `lunarsim.optimal` is solved, with free final time, from the state
predicted at the response of attitude and engine. A minimum-propellant path brakes as late as
possible. After a disturbance, no path may keep the upper throttle margin. The margin is therefore
available at a penalty that is high enough to avoid its use if another path exists. At least 4 % of
the throttle range are reserved in this way: without any reserve, a late-braking path cannot correct
errors. Deadlines count solver iterations, never a clock, so that flights are reproducible: a plan
with too many iterations is late. If no plan is in time, none exists even with full thrust, or the
path violates the thrust limits, the Apollo law flies until the landing site changes. Plans that
fail and succeed alternately would use far more propellant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.guidance.divert_cost import PathLimits, divert_cost
from lunarsim.onboard.guidance.path_guidance import ActuatorLagModel, PathGuidance
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.optimal.cone_program import QocoOnlySolver
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import is_flyable, remaining_log_mass, search_near
from lunarsim.optimal.path import OptimalPath
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite

_APEX_DEPTH_M = 0.5  # depth of the glideslope's apex under the end, m; as for the polynomial laws
_DIVERT_DISTANCE_M = 1.0  # horizontal move of the end that counts as a divert, m
_MIN_UPPER_MARGIN = (
    0.04  # minimum fraction of the throttle range that plans reserve at the upper end
)
_WARM_TIME_FACTORS = (
    1.0,
    1.04,
    1.12,
)  # multiples of the expected time to try, with a previous plan
_COLD_TIME_FACTORS = (1.0, 0.93, 1.06, 0.86, 1.13, 0.8, 1.25)  # the same without a previous plan
_MAX_SOLVES, _STEP = 3, 0.015  # solves of a search around the last final time, and its first step


@dataclass(frozen=True)
class OptimalLaw(PathLaw):
    """Settings of minimum-propellant guidance by repeated optimal planning.

    The Apollo law is the fallback. The cost of reaching a site is that of the Apollo law's paths:
    an upper bound of the propellant of this law.

    Attributes
    ----------
    min_time_to_go
        Time-to-go below which the last plan is flown to its end, s.
    interval
        Time between plans, s.
    intervals
        Number of intervals of constant thrust in a plan.
    iterations
        Maximum number of solver iterations of a plan; a plan with more is late and rejected.
    frequency
        Natural frequency of plan tracking, rad/s; critically damped.
    max_final_tilt, tilt_rate
        Maximum tilt at the end of the approach, rad, and its allowed growth backward in time,
        rad/s. The vertical descent needs a small tilt, and attitude takes time to follow.
    """

    min_time_to_go: float = quantity(
        3.0,
        "s",
        gt=0,
        help="time-to-go below which the lander makes no new plan and follows the last plan to its "
        "end",
    )
    interval: float = quantity(1.0, "s", gt=0, le=60, help="time between two plans of the path")
    intervals: int = quantity(
        30, ge=8, le=200, help="number of time intervals with constant thrust in a plan"
    )
    iterations: int = quantity(
        400,
        ge=1,
        help="maximum number of solver iterations for a plan; a plan that needs more is rejected",
    )
    frequency: float = quantity(
        0.5, "rad/s", ge=0, le=3, help="natural frequency of the feedback loop that tracks the plan"
    )
    max_final_tilt: float = quantity(
        10.0,
        "deg",
        ge=0,
        lt=85,
        help="maximum angle of the thrust from the vertical at the end of the approach",
    )
    tilt_rate: float = quantity(
        15.0,
        "deg/s",
        gt=0,
        le=180,
        help="rate of the tilt limit: at t seconds before the end of the approach, the limit is "
        "max_final_tilt_deg plus this rate times t, up to max_tilt_deg of the approach",
    )

    @property
    def shape(self) -> PathShape:
        """Shape of the paths that give the cost of a site: that of the Apollo law."""
        return APOLLO

    def build(self, briefing: Briefing, lag: float) -> OptimalGuidance:  # type: ignore[override]
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.
        """
        return OptimalGuidance(self, briefing, lag)


@dataclass(frozen=True)
class _TimedPath:
    """Planned minimum-propellant path with the time at which it starts, s."""

    path: OptimalPath
    start_time: float


class OptimalGuidance:
    """Minimum-propellant guidance of one flight by repeated optimal planning.

    Attributes
    ----------
    arrival
        Planned time of arrival at the end, s; None before the first command.
    events
        Events: time (s), name ("guidance-fallback", "guidance-planned"), details.
    plans
        Number of plans so far.
    """

    def __init__(self, settings: OptimalLaw, briefing: Briefing, lag: float) -> None:
        self.settings = settings
        self.lander = briefing.lander
        self.limits: PathLimits = briefing.software.approach.limits
        self.gravity = briefing.surface_gravity
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.plans = 0
        self._planner = Planner(settings.intervals, QocoOnlySolver)
        self._lag_model = ActuatorLagModel(lag)
        # This law has its own open-loop end, for the last seconds without a plan.
        self._apollo = PathGuidance(
            APOLLO, self.gravity, lag_model=self._lag_model,
            min_time_to_go=ApolloLaw().min_time_to_go, gravity_model=briefing.nonuniform_gravity,
        )  # fmt: skip
        self._field = briefing.nonuniform_gravity
        self._plan: _TimedPath | None = None
        self._end: PhaseEnd | None = None
        self._next_plan_time = -np.inf
        self._is_fallback = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, after planning if it is due.

        `end` is the required end state, `time` the current time and `time_to_go` the time-to-go
        from the onboard computer, s.
        """
        _check(estimate, end, time_to_go)
        self._lag_model.advance(time)
        if self.arrival is None:
            self.arrival = time + time_to_go
        is_divert = (
            self._end is not None and _horizontal_distance(self._end, end) > _DIVERT_DISTANCE_M
        )
        if is_divert:
            self.arrival = time + time_to_go  # the onboard computer's estimate for the new site
        keeps_plan = self._is_fallback or self.arrival - time < self.settings.min_time_to_go
        is_due = time >= self._next_plan_time - 1e-9 and not keeps_plan
        if is_divert or is_due or self._end is None:
            self._end, self._next_plan_time = end, time + self.settings.interval
            self._replan(estimate, end, time, ignore_last=is_divert)
        if self._plan is None:
            return self._apollo.command(estimate, end, time, self.arrival - time)
        wanted = self._track(self._plan, estimate, time)
        acceleration = wanted - np.array([0.0, 0.0, self.gravity])
        self._lag_model.record_command(acceleration)
        # Plans assume uniform gravity; the remaining acceleration is compensated here.
        return (
            wanted
            if self._field is None
            else acceleration
            - self._field.free_fall_acceleration(estimate.position, estimate.velocity)
        )

    # --- plans ----------------------------------------------------------------------------

    def _replan(self, estimate: Estimate, end: PhaseEnd, time: float, *, ignore_last: bool) -> None:
        """Plan a path from the predicted state; switch to the Apollo law if that fails.

        The state is predicted one response lag ahead, when commands take effect. A plan with more
        solver iterations than the settings allow counts as failed. With `ignore_last`, the previous
        plan is not used as a first guess.
        """
        before = self._planner.iterations
        path, reason = self._plan_path(estimate, end, time, None if ignore_last else self._plan)
        iterations = self._planner.iterations - before
        if path is not None and iterations > self.settings.iterations:
            path, reason = None, "late"
        if path is None:
            self._fall_back(estimate, end, time, reason, iterations)
            return
        self.plans += 1
        if self._is_fallback:
            self.events.append((time, "guidance-planned", {"iterations": iterations}))
        self._is_fallback = False
        self._plan = _TimedPath(path, time + self._lag_model.lag)
        # A command one lag before the end of the path takes effect at its end, where the next phase
        # begins.
        self.arrival = time + path.duration

    def _plan_path(
        self, estimate: Estimate, end: PhaseEnd, time: float, last: _TimedPath | None
    ) -> tuple[OptimalPath | None, str]:
        """Return a minimum-propellant path and an empty text, or None and the reason.

        `last` is the previous plan, used as a first guess; None: none. `time` is the current time,
        s.
        """
        position, velocity = self._lag_model.predict(estimate)
        expected = max((self.arrival or 0.0) - time, 1.0)
        masses = None
        if last is not None:
            elapsed = time + self._lag_model.lag - last.start_time
            masses = remaining_log_mass(last.path, elapsed, self._planner.intervals)
        try:
            descent = self._build_problem(estimate.mass, position, velocity, end)
            times = (
                s * expected for s in (_COLD_TIME_FACTORS if last is None else _WARM_TIME_FACTORS)
            )
            max_solves, step = (_MAX_SOLVES, _STEP) if last is not None else (12, 4.0 * _STEP)
            path = search_near(
                self._planner, descent, times, max_solves=max_solves, log_mass=masses, step=step,
                curvature_guess=0.0 if last is None else last.path.curvature,
            )  # fmt: skip
        except InputError as error:
            return None, str(error)
        if path is None:
            return None, self._failure_reason(descent, expected)
        return (path, "") if is_flyable(path) else (None, "thrust")

    def _failure_reason(self, descent: Descent, expected: float) -> str:
        """Return why no path was found: "infeasible" or "solver"; empty in a fallback.

        "infeasible" means that no path exists at any tried final time around the expected one
        (`expected`, s). "solver" means that the solver failed although a path may exist. During a
        fallback the reason has already been reported.
        """
        if self._is_fallback:
            return ""
        planner = Planner(self.settings.intervals)
        try:
            found = any(
                planner.at_time(descent, s * expected) is not None for s in _COLD_TIME_FACTORS
            )
        except SolverError:
            return "solver"
        return "solver" if found else "infeasible"

    def _build_problem(
        self, mass: float, position: Array, velocity: Array, end: PhaseEnd
    ) -> Descent:
        """Return the optimal control problem from a state to a phase end.

        The upper throttle margin is available at a penalty. `mass` is in kg; `position` and
        `velocity` (3,) are in m and m/s.
        """
        lander, limits = self.lander, self.limits
        throttle = lander.thrust_max - lander.thrust_min
        thrust_slack = self._upper_margin * throttle
        displacement = position - end.position
        horizontal = float(np.hypot(displacement[0], displacement[1]))
        # A lander below the glideslope gets a lower glideslope.
        elevation = float(np.arctan2(displacement[2] + _APEX_DEPTH_M, horizontal + 1e-9))
        glideslope = max(min(limits.glideslope, elevation - np.deg2rad(0.5)), 0.0)
        return Descent(
            position, velocity, mass, end.position, end.velocity, self.gravity,
            limits.thrust_range(lander)[0], lander.thrust_max - thrust_slack,
            lander.exhaust_velocity,
            lander.dry_mass + min(limits.reserve, 0.5 * (mass - lander.dry_mass)),
            limits.max_tilt, glideslope, _APEX_DEPTH_M, thrust_slack=thrust_slack,
            max_final_tilt=self.settings.max_final_tilt, tilt_rate=self.settings.tilt_rate,
        )  # fmt: skip

    @property
    def _upper_margin(self) -> float:
        """Fraction of the throttle range reserved at the upper end."""
        return max(self.limits.throttle_margin, _MIN_UPPER_MARGIN)

    def _fall_back(
        self, estimate: Estimate, end: PhaseEnd, time: float, reason: str, iterations: int
    ) -> None:
        """Drop the plan and switch to the Apollo law until the landing site changes.

        If that law does not fly already, an event with `reason` and the number of solver
        `iterations` is recorded, and the arrival time becomes that of the law's minimum-propellant
        path, if one is admissible.
        """
        if not self._is_fallback:
            self.events.append(
                (time, "guidance-fallback", {"reason": reason, "iterations": iterations})
            )
            one = replace(end, position=end.position[None, :])
            cost = divert_cost(estimate, one, self.lander, self.gravity, limits=self.limits)
            if np.isfinite(cost.time_to_go[0]):
                self.arrival = time + float(cost.time_to_go[0])
        self._is_fallback = True
        self._plan = None

    # --- tracking -------------------------------------------------------------------------

    def _track(self, plan: _TimedPath, estimate: Estimate, time: float) -> Array:
        """Return the plan's thrust acceleration plus tracking feedback (3,), m/s^2.

        `time` is the current time, s; position and velocity errors are fed back.
        """
        position, velocity = self._lag_model.predict(estimate)
        at = min(time + self._lag_model.lag - plan.start_time, plan.path.duration)
        r, v, thrust = plan.path.at(at)
        w = self.settings.frequency
        return np.asarray(thrust + w * w * (r - position) + 2.0 * w * (v - velocity))


def _horizontal_distance(a: PhaseEnd, b: PhaseEnd) -> float:
    """Return the horizontal distance of two phase ends, m."""
    return float(np.hypot(*(a.position[:2] - b.position[:2])))


def _check(estimate: Estimate, end: PhaseEnd, time_to_go: float) -> None:
    """Raise InputError if the state, the end or the time-to-go is not finite."""
    require_finite_state(estimate, end)
    check_finite("guidance.time_to_go", time_to_go)
