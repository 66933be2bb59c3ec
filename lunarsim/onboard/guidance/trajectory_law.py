"""Guidance along a reference trajectory from a file: feedforward and feedback."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.guidance.path_guidance import ActuatorLagModel, PathGuidance
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.guidance.reference_trajectory import ReferenceTrajectory
from lunarsim.onboard.guidance.trajectory_files import load_trajectory
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite

_DIVERT_DISTANCE_M = 1.0  # horizontal move of the end within a cycle that counts as a divert, m


@dataclass(frozen=True)
class TrajectoryLaw(PathLaw):
    """Settings of guidance that tracks a reference trajectory from a file.

    The commanded acceleration, gravity included, is
    ``a_ref + (r_ref - r) / T^2 + 2 D (v_ref - v) / T`` with the time constant T and the damping
    ratio D: position errors decay like those of a second-order system with the natural frequency
    1 / T. State and reference are those one response lag ahead. The Apollo law flies after a divert
    and after a hover, and its paths give the cost of a site.

    Attributes
    ----------
    path
        File with the trajectory, OEM or CSV, in the site frame; its time 0 is the start of the
        flight.
    time_constant, damping
        Time constant, s, and damping ratio of the tracking errors.
    max_start_offset, max_start_velocity_error
        Maximum deviation of the first state from the estimated start state, m and m/s.
    max_end_offset
        Maximum distance of the last position from the line between target and end of the approach,
        m.
    """

    path: Path | None = quantity(
        None, help="file with the reference trajectory, OEM (.oem) or CSV (.csv), relative to the "
        "scenario file; the frame is the site frame, and its time 0 is the start of the flight",
    )  # fmt: skip
    time_constant: float = quantity(
        2.0, "s", ge=0.5, le=100, help="time constant of the tracking errors: the inverse of the "
        "natural frequency of the feedback loop",
    )  # fmt: skip
    damping: float = quantity(
        1.0, ge=0.3, le=3, help="damping ratio of the tracking errors; 1: critical damping"
    )
    max_start_offset: float = quantity(
        50.0, "m", gt=0, help="maximum distance between the first position of the reference and "
        "the start of the flight",
    )  # fmt: skip
    max_start_velocity_error: float = quantity(
        5.0, "m/s", gt=0, help="maximum difference between the first velocity of the reference and "
        "the velocity at the start of the flight",
    )  # fmt: skip
    max_end_offset: float = quantity(
        10.0, "m", gt=0, help="maximum distance between the last position of the reference and the "
        "vertical line from the landing target to the end of the approach",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_bounds(self, "guidance")
        self.reference()

    @property
    def shape(self) -> PathShape:
        """Shape of the paths that give the cost of a site: that of the Apollo law."""
        return APOLLO

    def reference(self) -> ReferenceTrajectory:
        """Read the reference trajectory.

        Raises
        ------
        InputError
            If the file is omitted, missing or invalid.
        """
        if self.path is None:
            raise InputError(
                "path", None, "is required", "Name an OEM or CSV file.", show_value=False
            )
        return load_trajectory(self.path)

    def build(self, briefing: Briefing, lag: float) -> TrajectoryGuidance:  # type: ignore[override]
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.

        Raises
        ------
        InputError
            If the trajectory does not begin at the start state or ends far from the target.
        """
        reference = self.reference()
        self._check_start(reference, briefing)
        self._check_end(reference, briefing)
        return TrajectoryGuidance(self, reference, briefing, lag)

    def _check_start(self, reference: ReferenceTrajectory, briefing: Briefing) -> None:
        start = briefing.start
        for what, found, wanted, limit, unit, key in (
            ("position", reference.position[0], start.position, self.max_start_offset, "m",
             "max_start_offset_m"),
            ("velocity", reference.velocity[0], start.velocity, self.max_start_velocity_error,
             "m/s", "max_start_velocity_error_m_s"),
        ):  # fmt: skip
            error = float(np.linalg.norm(found - wanted))
            if error > limit:
                raise InputError(
                    "path", str(self.path),
                    f"must begin at the start state, because its first {what} differs by "
                    f"{error:.4g} {unit}",
                    f"At most {limit:g} {unit} are allowed ({key}).",
                )  # fmt: skip

    def _check_end(self, reference: ReferenceTrajectory, briefing: Briefing) -> None:
        target, last = briefing.target, reference.position[-1]
        end = briefing.software.approach.end(target, briefing.lander).position
        nearest = np.array([*end[:2], np.clip(last[2], target[2], end[2])])
        distance = float(np.linalg.norm(last - nearest))
        if distance > self.max_end_offset:
            raise InputError(
                "path", str(self.path),
                f"must end at the target, because its last position is {distance:.4g} m away",
                f"At most {self.max_end_offset:g} m are allowed (max_end_offset_m). Set "
                "target.position_m to the end of the reference.",
            )  # fmt: skip


class TrajectoryGuidance:
    """Guidance of one flight along a reference trajectory.

    The reference moves with the end of the approach, which follows corrections of navigation and
    the mapped height of the site.

    Attributes
    ----------
    arrival
        Time at which the reference reaches the height of the end of the approach, s.
    events
        Events: time (s), name ("guidance-fallback"), details.
    """

    def __init__(
        self, settings: TrajectoryLaw, reference: ReferenceTrajectory, briefing: Briefing,
        lag: float,
    ) -> None:  # fmt: skip
        self.settings, self.reference = settings, reference
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self._briefing = briefing
        self._planned_end = briefing.software.approach.end(briefing.target, briefing.lander)
        self._lag_model = ActuatorLagModel(lag)
        self._gravity = np.array([0.0, 0.0, -briefing.surface_gravity])
        self._apollo = PathGuidance(
            APOLLO, briefing.surface_gravity, lag_model=self._lag_model,
            min_time_to_go=ApolloLaw().min_time_to_go, gravity_model=briefing.nonuniform_gravity,
        )  # fmt: skip
        self._last_end: Array | None = None
        self._is_fallback = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        `end` is the required end state, `time` the current time and `time_to_go` the time-to-go
        from the onboard computer, s.
        """
        require_finite_state(estimate, end)
        check_finite("guidance.time_to_go", time_to_go)
        reason = "" if self._is_fallback else self._reason_to_fall_back(end, time)
        if reason:
            self._fall_back(estimate, end, time, reason)
        self._last_end = np.array(end.position[:2])
        if self._is_fallback:
            left = time_to_go if self.arrival is None else self.arrival - time
            return self._apollo.command(estimate, end, time, left)
        self.arrival = self.reference.time_at_height(float(self._planned_end.position[2]))
        self._lag_model.advance(time)
        acceleration = self._track(estimate, end, time + self._lag_model.lag)
        self._lag_model.record_command(acceleration)
        field = self._briefing.nonuniform_gravity
        free_fall = (
            self._gravity
            if field is None
            else field.free_fall_acceleration(estimate.position, estimate.velocity)
        )
        return np.asarray(acceleration - free_fall)

    def _track(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the total acceleration (3,) that tracks the reference, m/s^2."""
        position, velocity = self._lag_model.predict(estimate)
        r, v, a = self.reference.at(time)
        shift = end.position - self._planned_end.position
        rate = 1.0 / self.settings.time_constant
        return np.asarray(
            a
            + rate**2 * (r + shift - position)
            + 2.0 * self.settings.damping * rate * (v - velocity)
        )

    def _reason_to_fall_back(self, end: PhaseEnd, time: float) -> str:
        """Return why the reference can no longer be tracked; empty if it can."""
        if time > self.reference.duration:
            return "end of the reference"
        if self._last_end is None:
            return ""
        if self.arrival is None:
            return "new approach"
        moved = float(np.hypot(*(end.position[:2] - self._last_end)))
        return "divert" if moved > _DIVERT_DISTANCE_M else ""

    def _fall_back(self, estimate: Estimate, end: PhaseEnd, time: float, reason: str) -> None:
        """Switch to the Apollo law for the rest of the approach.

        An event with `reason` is recorded. The arrival time becomes that of the law's
        minimum-propellant path, if one is admissible.
        """
        self._is_fallback = True
        self.events.append((time, "guidance-fallback", {"reason": reason}))
        one = replace(end, position=end.position[None, :])
        limits = self._briefing.software.approach.limits
        gravity = self._briefing.surface_gravity
        cost = divert_cost(estimate, one, self._briefing.lander, gravity, limits=limits)
        if np.isfinite(cost.time_to_go[0]):
            self.arrival = time + float(cost.time_to_go[0])
