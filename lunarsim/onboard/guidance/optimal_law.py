"""The law of least propellant: a cone program solved anew once a second, tracked in between.

The lossless convexification of `lunarsim.optimal` is solved from where the lander will be once
attitude and engine have answered, with the final time free. A path of least propellant brakes as
late as it can, so that after a disturbance none may keep the throttle margin: what the margin keeps
back above may be had at a price, high enough that it is left alone while there is another way. 4 %
of the throttle range are kept back so whatever the margin is: with nothing to answer with, a path
that brakes late is lost. What a flight does depends on counts of iterations, never on a clock: a
plan that takes more than it may is late. Where no plan is in time, none exists even with all of the
engine, or what is found breaks the limits of thrust, the Apollo law flies until the next one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd, refuse_unknown
from lunarsim.onboard.guidance.divert import PathLimits, divert_cost
from lunarsim.onboard.guidance.following import Answering, PathGuidance
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.optimal.cone_program import Unjudged
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import flyable, masses_left, search_about
from lunarsim.optimal.path import Path
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]

_DROP = 0.5  # of the glideslope's tip under the end, m: as the polynomial laws have it
_MOVED = 1.0  # of the end, m: a divert
_SPARE = 0.04  # of the throttle range that plans leave above at least
_TIMES = (1.0, 1.04, 1.12)  # shares of the expected time that are tried in turn
_FRESH = (1.0, 0.93, 1.06, 0.86, 1.13, 0.8, 1.25)  # where there is no plan to go by
_SOLVES, _STEP = 3, 0.015  # solves of a search about the last final time, and its first step


@dataclass(frozen=True)
class OptimalLaw(PathLaw):
    """Least propellant, solved anew as it flies; the Apollo law where that fails.

    What it costs to reach a site is told by the paths of the Apollo law, which it falls back to: an
    upper bound of its own propellant.

    Attributes
    ----------
    least_time_to_go
        Below this time-to-go the last plan is flown out, s.
    interval
        Between plans, s.
    intervals
        Of a plan.
    iterations
        Of the solver that a plan may take: with more it is late.
    frequency
        Of tracking a plan, rad/s; critically damped.
    end_tilt, tilt_rate
        Greatest tilt at the end of the approach, rad, and by how much it may grow a second before
        it, rad/s: the vertical descent after it leans little, and attitude takes time to follow.
    """

    least_time_to_go: float = quantity(
        3.0, "s", gt=0, help="below it the last plan is flown out, tracked"
    )
    interval: float = quantity(1.0, "s", gt=0, le=60, help="between plans")
    intervals: int = quantity(30, ge=8, le=200, help="of constant thrust over mass in a plan")
    iterations: int = quantity(400, ge=1, help="of the solver; a plan that takes more is late")
    frequency: float = quantity(0.5, "rad/s", ge=0, le=3, help="with which plans are tracked")
    end_tilt: float = quantity(10.0, "deg", ge=0, lt=85, help="greatest at the end of the approach")
    tilt_rate: float = quantity(
        15.0, "deg/s", gt=0, le=180, help="by which it may grow a second before the end"
    )

    @property
    def shape(self) -> PathShape:
        """Of the paths that reach is told by."""
        return APOLLO

    def build(self, briefing: Briefing, lag: float) -> OptimalGuidance:  # type: ignore[override]
        """Return the law of one flight."""
        return OptimalGuidance(self, briefing, lag)


@dataclass(frozen=True)
class _Plan:
    """A path and when it begins, s."""

    path: Path
    begins: float


class OptimalGuidance:
    """The law in flight; see `OptimalLaw`.

    Attributes
    ----------
    arrival
        When it means to be at the end, s; None before the first command.
    events
        What happened: time (s), name ("guidance-fallback", "guidance-planned"), details.
    plans
        Made so far.
    """

    def __init__(self, settings: OptimalLaw, briefing: Briefing, lag: float) -> None:
        self.settings = settings
        self.lander = briefing.lander
        self.limits: PathLimits = briefing.software.approach.limits
        self.gravity = briefing.weight
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.plans = 0
        self._planner = Planner(settings.intervals, Unjudged)
        self._answering = Answering(lag)
        # It flies what the plan's last seconds leave open, as it does by itself.
        self._apollo = PathGuidance(
            APOLLO, self.gravity, answering=self._answering,
            least_time_to_go=ApolloLaw().least_time_to_go, field=briefing.field,
        )  # fmt: skip
        self._field = briefing.field
        self._plan: _Plan | None = None
        self._end: PhaseEnd | None = None
        self._next = -np.inf
        self._fallen = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2."""
        _check(estimate, end, time_to_go)
        self._answering.follow(time)
        if self.arrival is None:
            self.arrival = time + time_to_go
        moved = self._end is not None and _apart(self._end, end) > _MOVED
        if moved:
            self.arrival = time + time_to_go  # the computer's guess for the new site
        ending = self.arrival - time < self.settings.least_time_to_go
        if moved or (time >= self._next - 1e-9 and not ending) or self._end is None:
            self._end, self._next = end, time + self.settings.interval
            self._replan(estimate, end, time, fresh=moved)
        if self._plan is None:
            return self._apollo.command(estimate, end, time, self.arrival - time)
        wanted = self._tracked(self._plan, estimate, time)
        moves = wanted - np.array([0.0, 0.0, self.gravity])
        self._answering.ask(moves)
        # A plan knows uniform gravity; what is felt besides is made up for as it flies.
        return (
            wanted
            if self._field is None
            else moves - self._field.felt(estimate.position, estimate.velocity)
        )

    # --- plans ----------------------------------------------------------------------------

    def _replan(self, estimate: Estimate, end: PhaseEnd, time: float, *, fresh: bool) -> None:
        """Make a plan from where commands take effect; fall back where there is none."""
        before = self._planner.iterations
        path, why = self._path(estimate, end, time, None if fresh else self._plan)
        spent = self._planner.iterations - before
        if path is not None and spent > self.settings.iterations:
            path, why = None, "late"
        if path is None:
            self._fall_back(estimate, end, time, why, spent)
            return
        self.plans += 1
        if self._fallen:
            self.events.append((time, "guidance-planned", {"iterations": spent}))
        self._fallen = False
        self._plan = _Plan(path, time + self._answering.lead)
        # What is commanded a lag before the end of the path takes effect at its end, where the next
        # phase is to begin.
        self.arrival = time + path.duration

    def _path(
        self, estimate: Estimate, end: PhaseEnd, time: float, last: _Plan | None
    ) -> tuple[Path | None, str]:
        """Return a path, or why there is none."""
        position, velocity = self._answering.ahead(estimate)
        expected = max((self.arrival or 0.0) - time, 1.0)
        masses = None
        if last is not None:
            elapsed = time + self._answering.lead - last.begins
            masses = masses_left(last.path, elapsed, self._planner.intervals)
        try:
            descent = self._descent(estimate.mass, position, velocity, end)
            times = (s * expected for s in (_FRESH if last is None else _TIMES))
            most, step = (_SOLVES, _STEP) if last is not None else (12, 4.0 * _STEP)
            path = search_about(
                self._planner, descent, times, most=most, log_mass=masses, step=step,
                bend=0.0 if last is None else last.path.curvature,
            )  # fmt: skip
        except InputError as error:
            return None, str(error)
        if path is None:
            return None, self._why(descent, expected)
        return (path, "") if flyable(path) else (None, "thrust")

    def _why(self, descent: Descent, expected: float) -> str:
        """Return why there is no path: told once, where the Apollo law takes over.

        "infeasible" is proven for all final times about the expected one.
        """
        if self._fallen:
            return ""
        planner = Planner(self.settings.intervals)
        try:
            found = any(planner.at_time(descent, s * expected) is not None for s in _FRESH)
        except SolverError:
            return "solver"
        return "solver" if found else "infeasible"

    def _descent(self, mass: float, position: Array, velocity: Array, end: PhaseEnd) -> Descent:
        """Return the problem; what the throttle margin keeps back above may be had at a price."""
        lander, limits = self.lander, self.limits
        throttle = lander.thrust_max - lander.thrust_min
        margin, spare = (m * throttle for m in (limits.throttle_margin, self._spare))
        gap = position - end.position
        aside = float(np.hypot(gap[0], gap[1]))
        # One that is under the glideslope already has to come in under it.
        own = float(np.arctan2(gap[2] + _DROP, aside + 1e-9))
        glideslope = max(min(limits.glideslope, own - np.deg2rad(0.5)), 0.0)
        return Descent(
            position, velocity, mass, end.position, end.velocity, self.gravity,
            lander.thrust_min + margin, lander.thrust_max - spare, lander.exhaust_velocity,
            lander.dry_mass + min(limits.reserve, 0.5 * (mass - lander.dry_mass)),
            limits.max_tilt, glideslope, _DROP, spare=spare,
            end_tilt=self.settings.end_tilt, tilt_rate=self.settings.tilt_rate,
        )  # fmt: skip

    @property
    def _spare(self) -> float:
        """Share of the throttle range that is kept back above."""
        return max(self.limits.throttle_margin, _SPARE)

    def _fall_back(
        self, estimate: Estimate, end: PhaseEnd, time: float, why: str, spent: int
    ) -> None:
        """Let the Apollo law fly on, with its own time-to-go where it has an admissible one."""
        if not self._fallen:
            self.events.append((time, "guidance-fallback", {"reason": why, "iterations": spent}))
            one = replace(end, position=end.position[None, :])
            cost = divert_cost(estimate, one, self.lander, self.gravity, limits=self.limits)
            if np.isfinite(cost.time_to_go[0]):
                self.arrival = time + float(cost.time_to_go[0])
        self._fallen = True
        self._plan = None

    # --- tracking -------------------------------------------------------------------------

    def _tracked(self, plan: _Plan, estimate: Estimate, time: float) -> Array:
        """Return the plan's thrust acceleration with what holds the lander to it (3,), m/s^2."""
        position, velocity = self._answering.ahead(estimate)
        at = min(time + self._answering.lead - plan.begins, plan.path.duration)
        r, v, push = plan.path.at(at)
        w = self.settings.frequency
        return np.asarray(push + w * w * (r - position) + 2.0 * w * (v - velocity))


def _apart(a: PhaseEnd, b: PhaseEnd) -> float:
    return float(np.hypot(*(a.position[:2] - b.position[:2])))


def _check(estimate: Estimate, end: PhaseEnd, time_to_go: float) -> None:
    """Refuse what is not finite."""
    refuse_unknown(estimate, end)
    if not np.isfinite(time_to_go):
        raise InputError("guidance.time_to_go", time_to_go, "a finite time in s")
