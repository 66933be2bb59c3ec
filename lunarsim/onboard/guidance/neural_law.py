"""Minimum-propellant guidance by a trained network; no onboard solver.

The training data are descents from `lunarsim.optimal` under the limits of the default lander and
approach. They begin at an elevation of 15 deg or more over their end, up to 800 m above it, with
crossrange speeds up to 10 m/s. In each cycle the network gives thrust and time-to-go for the state
predicted at the response of attitude and engine. If the state is outside the training domain, or
the output violates the limits of thrust or tilt, the Apollo law flies, and the network is tried
again after an interval. E-guidance flies the last seconds, because its final thrust is free like
that of an optimal descent: a network ends near the target, a path exactly at it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.guidance.optimal_network import OptimalNetwork, reduce_state
from lunarsim.onboard.guidance.path_guidance import ActuatorLagModel, PathGuidance
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.guidance.polynomial_laws import EGuidanceLaw
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite

_DIVERT_DISTANCE_M = 1.0  # horizontal move of the end that counts as a divert, m
# Domain of the initial states of training: elevation over the end, rad; height, m; crossrange
# speed, m/s.
MIN_ELEVATION_RAD, MAX_HEIGHT_M, MAX_CROSSRANGE_SPEED_M_S = np.deg2rad(15.0), 800.0, 10.0
_PARAM_TOLERANCE = 1e-3  # maximum relative difference of problem parameters from those of training


@cache
def load_default_network() -> OptimalNetwork:
    """Return the trained network that is supplied with lunarsim."""
    return OptimalNetwork.load()


@dataclass(frozen=True)
class NeuralOptimalLaw(PathLaw):
    """Settings of minimum-propellant guidance by a trained network.

    The Apollo law is the fallback. The cost of reaching a site is that of the Apollo law's paths.

    Attributes
    ----------
    min_time_to_go
        Time-to-go below which the last path of E-guidance is flown open loop, s.
    handover
        Time-to-go below which E-guidance flies to the end, s.
    interval
        Time after a fallback until the network is tried again, s.
    thrust_tolerance, tilt_tolerance
        Limit violations of the network's output that are clipped instead of rejected: fraction of
        the maximum thrust, and tilt, rad.
    """

    handover: float = quantity(
        3.0, "s", gt=0, help="time-to-go below which E-guidance replaces the neural network"
    )
    interval: float = quantity(
        1.0,
        "s",
        gt=0,
        le=60,
        help="time for which the Apollo law replaces the neural network after a rejected command "
        "or a state outside the network's training domain",
    )
    thrust_tolerance: float = quantity(
        0.05,
        ge=0,
        le=1,
        help="violation of the thrust limits, as a fraction of the maximum thrust, up to which the "
        "network's command is clipped; a larger violation rejects the command",
    )
    tilt_tolerance: float = quantity(
        3.0,
        "deg",
        ge=0,
        lt=45,
        help="violation of the tilt limit up to which the network's command is clipped; a larger "
        "violation rejects the command",
    )

    @property
    def shape(self) -> PathShape:
        """Shape of the paths that give the cost of a site: that of the Apollo law."""
        return APOLLO

    def build(self, briefing: Briefing, lag: float) -> NeuralGuidance:  # type: ignore[override]
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.
        """
        return NeuralGuidance(self, briefing, lag, load_default_network())


class NeuralGuidance:
    """Minimum-propellant guidance of one flight by a trained network.

    Attributes
    ----------
    arrival
        Planned time of arrival at the end, s; None when the approach begins.
    events
        Events: time (s), name ("guidance-fallback", "guidance-planned"), details.
    evaluation_count, violation_count
        Number of network evaluations, and of outputs that violate the limits.
    """

    def __init__(
        self, settings: NeuralOptimalLaw, briefing: Briefing, lag: float, network: OptimalNetwork
    ) -> None:
        self.settings, self.network = settings, network
        self.lander, self.gravity = briefing.lander, briefing.surface_gravity
        self.limits = briefing.software.approach.limits
        self.arrival: float | None = None
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.evaluation_count = self.violation_count = 0
        self._field = briefing.nonuniform_gravity
        self._lag_model = ActuatorLagModel(lag)
        self._apollo, self._terminal_law = (
            PathGuidance(
                shape, self.gravity, lag_model=self._lag_model,
                min_time_to_go=least, gravity_model=briefing.nonuniform_gravity,
            )
            for shape, least in (
                (APOLLO, ApolloLaw().min_time_to_go),
                (EGuidanceLaw().shape, settings.min_time_to_go),
            )
        )  # fmt: skip
        self._end: PhaseEnd | None = None
        self._next_attempt = -np.inf
        self._is_fallback = self._is_terminal = self._is_following = False

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, from the network or a fallback.

        `end` is the required end state, `time` the current time and `time_to_go` the time-to-go
        from the onboard computer, s.

        Raises
        ------
        InputError
            If the estimate, the end or the time-to-go is not finite.
        """
        require_finite_state(estimate, end)
        check_finite("guidance.time_to_go", time_to_go)
        self._lag_model.advance(time)
        if (
            self.arrival is None  # the approach begins, perhaps again after a hover
            or self._end is None
            or _horizontal_distance(self._end, end) > _DIVERT_DISTANCE_M
        ):
            self._end, self._next_attempt, self._is_terminal = end, -np.inf, False
            self._is_following = False
            self.arrival = time + time_to_go
        thrust = None
        if not self._is_terminal and time >= self._next_attempt - 1e-9:
            thrust = self._evaluate_network(estimate, end, time)
        if thrust is None:
            law = self._terminal_law if self._is_terminal else self._apollo
            return law.command(estimate, end, time, self.arrival - time)
        acceleration = thrust - np.array([0.0, 0.0, self.gravity])
        self._lag_model.record_command(acceleration)
        if self._field is None:
            return thrust
        return np.asarray(
            acceleration - self._field.free_fall_acceleration(estimate.position, estimate.velocity)
        )

    def _evaluate_network(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array | None:
        """Return the network's thrust over mass (3,), m/s^2; None if another law flies.

        The result is None if the problem or the state is outside the training domain, the output
        violates the limits by more than the tolerances, or E-guidance flies the last seconds. If
        the network flew before and the Apollo law has no admissible path, a violating output is
        clipped instead.
        """
        if not self._matches_training(end):
            self._fall_back(estimate, end, time, "problem differs from training")
            return None
        position, velocity = self._lag_model.predict(estimate)
        inputs, axes = reduce_state(position - end.position, velocity, estimate.mass)
        # On a followed path the state may leave the domain of initial states.
        if not (
            self.network.is_in_domain(inputs) and (self._is_following or _is_trained_start(inputs))
        ):
            self._fall_back(estimate, end, time, "outside the training domain")
            return None
        self.evaluation_count += 1
        output = self.network(inputs)
        wanted = axes.T @ output[:3]
        thrust, left = self._within_limits(wanted, estimate.mass), float(output[3])
        if thrust is None or not left > 0.0:
            self.violation_count += 1
        if (
            thrust is None
            and self._is_following
            and not np.isfinite(self._apollo_time(estimate, end))
        ):
            # Near the end an optimal descent is at its limits, and no other law has a path: clip
            # instead.
            thrust = self._clip_to_limits(wanted, estimate.mass)
        if thrust is None or not left > 0.0:
            self._fall_back(estimate, end, time, "infeasible")
            return None
        if self._is_fallback:
            self.events.append((time, "guidance-planned", {}))
        self._is_fallback, self._is_following = False, True
        # The command is issued one lag ahead, so that the end comes earlier by the lag.
        self.arrival = time + self._lag_model.lag + left
        self._is_terminal = left < self.settings.handover
        return None if self._is_terminal else thrust

    def _matches_training(self, end: PhaseEnd) -> bool:
        """Return whether vehicle, gravity, limits and end velocity are those of training."""
        lander, limits = self.lander, self.limits
        params = np.array(
            [
                self.gravity, *limits.thrust_range(lander), lander.exhaust_velocity,
                -end.velocity[2], limits.max_tilt, limits.glideslope,
            ]
        )  # fmt: skip
        is_vertical = float(np.hypot(end.velocity[0], end.velocity[1])) < 1e-6
        return is_vertical and np.allclose(
            params, self.network.problem, rtol=_PARAM_TOLERANCE, atol=1e-9
        )

    def _within_limits(self, thrust: Array, mass: float) -> Array | None:
        """Clip thrust over mass to the limits of thrust and tilt; None if far outside.

        `thrust` (3,) is thrust over mass, m/s^2, and `mass` is in kg. Far outside means by more
        than the tolerances in the settings.
        """
        lander, slack = self.lander, self.settings.thrust_tolerance * self.lander.thrust_max
        force = float(np.linalg.norm(thrust)) * mass
        tilt = float(np.arctan2(np.hypot(thrust[0], thrust[1]), thrust[2]))
        if not lander.thrust_min - slack <= force <= lander.thrust_max + slack:
            return None
        if not tilt <= self.limits.max_tilt + self.settings.tilt_tolerance:
            return None
        return self._clip_to_limits(thrust, mass)

    def _clip_to_limits(self, thrust: Array, mass: float) -> Array:
        """Return thrust over mass (3,), m/s^2, clipped to the limits of thrust and tilt."""
        lander, horizontal = self.lander, float(np.hypot(thrust[0], thrust[1]))
        force = float(np.linalg.norm(thrust)) * mass
        if float(np.arctan2(horizontal, thrust[2])) > self.limits.max_tilt:
            direction = thrust[:2] / horizontal
            max_tilt = self.limits.max_tilt
            thrust = force / mass * np.array([*(np.sin(max_tilt) * direction), np.cos(max_tilt)])
        wanted = min(max(force, lander.thrust_min), lander.thrust_max)
        return np.asarray(thrust * (wanted / force))

    def _apollo_time(self, estimate: Estimate, end: PhaseEnd) -> float:
        """Return the minimum-propellant time-to-go of the Apollo law, s; NaN for none."""
        one = replace(end, position=end.position[None, :])
        cost = divert_cost(estimate, one, self.lander, self.gravity, limits=self.limits)
        return float(cost.time_to_go[0])

    def _fall_back(self, estimate: Estimate, end: PhaseEnd, time: float, reason: str) -> None:
        """Switch to the Apollo law; the network is tried again after `settings.interval`.

        If that law does not fly already, an event with `reason` is recorded, and the arrival time
        becomes that of the law's minimum-propellant path, if one is admissible.
        """
        self._next_attempt = time + self.settings.interval
        if not self._is_fallback:
            self.events.append((time, "guidance-fallback", {"reason": reason}))
            time_to_go = self._apollo_time(estimate, end)
            if np.isfinite(time_to_go):
                self.arrival = time + time_to_go
        self._is_fallback, self._is_following = True, False


def _is_trained_start(inputs: Array) -> bool:
    """Return whether network inputs (6,) are within the initial states of training."""
    low = inputs[1] < np.tan(MIN_ELEVATION_RAD) * inputs[0]
    return not (low or inputs[1] > MAX_HEIGHT_M or inputs[3] > MAX_CROSSRANGE_SPEED_M_S)


def _horizontal_distance(a: PhaseEnd, b: PhaseEnd) -> float:
    """Return the horizontal distance of two phase ends, m."""
    return float(np.hypot(*(a.position[:2] - b.position[:2])))
