"""Search for the path that gains most information about reachable terrain.

Paths are those of the Apollo law (Klumpp 1974), defined by time-to-go and acceleration at the end.
The end acceleration bends the complete path laterally and vertically, so that it can overfly the
site or approach it from another direction. One kernel scores thousands of paths: a Halton sequence
over all parameters, then a denser one about the best path.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.stats import qmc

from lunarsim.models.lander import Lander
from lunarsim.onboard.active_perception import _information_kernels as kernels
from lunarsim.onboard.active_perception.sensor_coverage import SensorCoverageModel
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import PathLimits
from lunarsim.onboard.guidance.paths import APOLLO
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.tasking.contract import MeasurementAltitudes
from lunarsim.typing import Array

# Samples at which limits are checked (Simpson intervals), and at which sensors observe.
_LIMIT_SAMPLES, _OBSERVATION_SAMPLES = 24, 24
# Bounds of the path parameters: time-to-go as a fraction of the expected one, and end accelerations
# as fractions of gravity, along and across the way, and vertical.
_TIME_TO_GO_RANGE = (0.7, 1.8)
_MAX_HORIZONTAL, _VERTICAL_RANGE = 1.2, (-0.5, 1.2)
# Width of the refinement about the best path, as a fraction of the parameter ranges.
_REFINEMENT_WIDTH = 0.12


@dataclass(frozen=True)
class PathPlan:
    """Planned approach path with its expected information and propellant.

    Attributes
    ----------
    time_to_go
        Time-to-go, s.
    acceleration
        Acceleration at the end (3,), m/s^2.
    known_fraction
        Expected fraction of hazard uncertainty removed, averaged over the reachable terrain.
    propellant
        Propellant used on the path, kg.
    """

    time_to_go: float
    acceleration: Array
    known_fraction: float
    propellant: float


@dataclass(frozen=True)
class PlanningProblem:
    """Inputs of path planning: state, end, terrain and limits.

    Attributes
    ----------
    estimate
        Navigation estimate at the start of the path.
    end
        End of the approach.
    site
        Landing site (3,), local frame, m.
    nodes
        Terrain nodes (g, 6): position (m), weight, fraction of uncertainty already removed, and
        minimum time-to-go for a divert there, s.
    lander
        Vehicle parameters.
    gravity
        Downward gravitational acceleration, m/s^2.
    limits
        Limits of thrust, tilt, glideslope and propellant.
    com_height
        Height of the centre of mass above the pads, m.
    min_altitude
        Altitude of the pads above the site below which observations do not count, m.
    lowest_altitude
        Lowest altitude flown so far, m; single observations above it are in the past.
    """

    estimate: Estimate
    end: PhaseEnd
    site: Array
    nodes: Array
    lander: Lander
    gravity: float
    limits: PathLimits
    com_height: float
    min_altitude: float
    lowest_altitude: float = np.inf


class InformationPlanner:
    """Planner that selects the path with most information for its propellant.

    Candidate paths are scored with models of the sensors and the altitudes at which they measure.

    Parameters
    ----------
    sensors, schedules
        Models of the sensors, and the altitudes at which each of them measures.
    candidates
        Number of paths evaluated for a plan.
    propellant_weight
        Fraction of hazard uncertainty whose removal is worth one kilogram of propellant, 1/kg.
    max_final_tilt
        Maximum tilt of the thrust at the end of the approach, rad.
    """

    def __init__(
        self,
        sensors: list[SensorCoverageModel],
        schedules: list[MeasurementAltitudes],
        candidates: int,
        propellant_weight: float,
        max_final_tilt: float,
    ) -> None:
        self.candidates, self.propellant_weight, self.max_final_tilt = (
            candidates,
            propellant_weight,
            max_final_tilt,
        )
        self._schedules = schedules
        self._tables = [
            np.ascontiguousarray([getattr(sensor, name) for sensor in sensors])
            for name in ("sharpness", "visible_fraction", "displacement", "reduction")
        ]
        self._sensor_params = np.array(
            [_sensor_params(e, o) for e, o in zip(sensors, schedules, strict=True)]
        )
        self._limit_table, self._observation_table = (
            _time_fractions(_LIMIT_SAMPLES),
            _time_fractions(_OBSERVATION_SAMPLES),
        )

    def best(
        self,
        problem: PlanningProblem,
        expected: float,
        max_propellant: float,
        last: PathPlan | None,
    ) -> PathPlan | None:
        """Return the best path within the limits; None if no path is admissible.

        If no candidate stays below `max_propellant`, this limit is raised to the propellant of the
        cheapest candidate.

        Parameters
        ----------
        problem
            Inputs of the planning.
        expected
            Expected time-to-go, around which paths are sampled, s.
        max_propellant
            Propellant that a path may use, kg.
        last
            Plan being flown, which is one of the candidates; None: no plan.
        """
        low, high = self._plan_bounds(problem, expected)
        plans = self.sample_plans(problem, expected, 2 * self.candidates // 3)
        if last is not None:
            plans = np.vstack((_plan_parameters(last), plans))
        value, known, propellant = self._net_values(problem, plans, max_propellant)
        if not np.isfinite(value).any():
            max_propellant = float(np.min(propellant))
            value, known, propellant = self._net_values(problem, plans, max_propellant)
        first = int(np.argmax(value))
        if not np.isfinite(value[first]):
            return None
        offsets = _REFINEMENT_WIDTH * (high - low) * (_halton_points(self.candidates // 3) - 0.5)
        refined = plans[first] + _to_enu(problem, offsets)
        refined[:, 0] = np.maximum(refined[:, 0], 1.0)
        refined_value, refined_known, refined_propellant = self._net_values(
            problem, refined, max_propellant
        )
        plans = np.vstack((plans, refined))
        value = np.append(value, refined_value)
        known, propellant = (
            np.append(known, refined_known),
            np.append(propellant, refined_propellant),
        )
        k = int(np.argmax(value))
        return PathPlan(
            float(plans[k, 0]), plans[k, 1:].copy(), float(known[k]), float(propellant[k])
        )

    def _plan_bounds(self, problem: PlanningProblem, expected: float) -> tuple[Array, Array]:
        """Return lower and upper bounds of time-to-go and end acceleration (4,).

        `expected` is the expected time-to-go, s. The accelerations, m/s^2, are along the horizontal
        direction to the end, to its left, and up.
        """
        g = problem.gravity
        low = np.array(
            [
                _TIME_TO_GO_RANGE[0] * expected,
                -_MAX_HORIZONTAL * g,
                -_MAX_HORIZONTAL * g,
                _VERTICAL_RANGE[0] * g,
            ]
        )
        high = np.array(
            [
                _TIME_TO_GO_RANGE[1] * expected,
                _MAX_HORIZONTAL * g,
                _MAX_HORIZONTAL * g,
                _VERTICAL_RANGE[1] * g,
            ]
        )
        low[0] = max(low[0], 1.0)
        return low, np.maximum(high, low)

    def sample_plans(self, problem: PlanningProblem, expected: float, count: int) -> Array:
        """Return evenly spread candidate plans (count, 4).

        Each is the time-to-go, s, and the acceleration at the end, ENU, m/s^2.

        Parameters
        ----------
        problem
            Inputs of the planning.
        expected
            Expected time-to-go, around which plans are sampled, s.
        count
            Number of plans.
        """
        low, high = self._plan_bounds(problem, expected)
        return _to_enu(problem, low + (high - low) * _halton_points(count))

    def _net_values(
        self, problem: PlanningProblem, plans: Array, max_propellant: float
    ) -> tuple[Array, Array, Array]:
        """Return net value, information and propellant (kg) of plans (n, 4), each (n,).

        The information is the fraction of hazard uncertainty removed. The net value is the
        information minus the weighted propellant; it is -inf for a plan that is not admissible.
        `max_propellant`, kg, limits the propellant of admissible plans.
        """
        scored = self.score(problem, plans)
        e, lander = problem.estimate, problem.lander
        propellant = e.mass * -np.expm1(-scored[:, 1] / lander.exhaust_velocity)
        available = e.mass - lander.dry_mass - problem.limits.reserve
        is_admissible = propellant <= min(max_propellant, available)
        value = np.where(
            is_admissible,
            scored[:, 0] - self.propellant_weight * np.where(is_admissible, propellant, 0.0),
            -np.inf,
        )
        return value, scored[:, 0], propellant

    def score(self, problem: PlanningProblem, plans: Array) -> Array:
        """Return the fraction of uncertainty removed and the delta-v of plans (n, 2).

        The plans (n, 4) consist of time-to-go (s) and acceleration at the end, ENU (m/s^2). The
        delta-v, m/s, is inf if a limit is violated.
        """
        p = problem
        out = np.empty((len(plans), 2))
        vehicle = p.limits.params(p.estimate.mass, p.lander, p.gravity)
        site = np.array([*p.site, p.site[2] + p.com_height, p.min_altitude])
        kernels.score_paths.run_loop(
            len(plans), 10.0,
            np.array([p.estimate.position, p.estimate.velocity], dtype=np.float64),
            np.asarray(p.end.position, dtype=np.float64),
            np.asarray(p.end.velocity, dtype=np.float64), np.ascontiguousarray(plans),
            self._limit_table, self._observation_table, np.array(APOLLO.powers), vehicle,
            float(np.tan(self.max_final_tilt)), site, np.ascontiguousarray(p.nodes),
            *self._tables, self._sensor_params, self._single_altitudes(p.lowest_altitude), out,
        )  # fmt: skip
        return out

    def _single_altitudes(self, lowest_altitude: float) -> Array:
        """Return the altitudes of future single observations (sensors, k), m.

        `lowest_altitude` is the lowest altitude flown so far, m. Unused elements of a row are NaN.
        A sensor whose single observations are all in the past gets an altitude of -inf, which is
        never reached; a sensor that measures at any altitude gets NaN only.
        """
        max_count = max(max((len(o.at) for o in self._schedules), default=0), 1)
        out = np.full((len(self._schedules), max_count), np.nan)
        for row, schedules in zip(out, self._schedules, strict=True):
            if schedules.at:
                ahead = [h for h in schedules.at if h < lowest_altitude] or [-np.inf]
                row[: len(ahead)] = ahead
        return out


def _to_enu(problem: PlanningProblem, plans: Array) -> Array:
    """Rotate the end accelerations of plans (n, 4) from path axes to ENU.

    The path axes are the horizontal direction to the end, the direction to its left, and up.
    """
    direction = problem.end.position[:2] - problem.estimate.position[:2]
    length = float(np.hypot(*direction))
    along = direction / length if length > 1.0 else np.array([1.0, 0.0])
    out = plans.copy()
    along_acceleration, across_acceleration = plans[:, 1], plans[:, 2]
    out[:, 1] = along_acceleration * along[0] - across_acceleration * along[1]
    out[:, 2] = along_acceleration * along[1] + across_acceleration * along[0]
    return out


def _sensor_params(sensor: SensorCoverageModel, schedules: MeasurementAltitudes) -> list[float]:
    """Return the row of `sensor_params` for the kernel `score_paths` (9,).

    It consists of pixel angle, maximum sharpness, cosines of half the field of view and of the
    gimbal limit, maximum range, highest and lowest measurement altitude, and Sun direction (2).
    """
    field = 1.0 / np.sqrt(1.0 + sensor.half_field**2)
    limit = float(np.cos(min(sensor.gimbal_limit, np.pi)))
    return [
        sensor.pixel,
        sensor.max_sharpness,
        field,
        limit,
        sensor.max_range,
        schedules.highest,
        schedules.lowest,
        *sensor.sun,
    ]


def _time_fractions(count: int) -> Array:
    """Return the fraction of time left and its two powers at samples of a path.

    `count` is the number of intervals; the result (count + 1, 3) is for `evaluate_path`.
    """
    left = 1.0 - np.arange(count + 1) / count
    return np.column_stack((left, left**APOLLO.low, left**APOLLO.high))


def _plan_parameters(plan: PathPlan) -> Array:
    """Return time-to-go and end acceleration of a plan as an array (1, 4)."""
    return np.array([[plan.time_to_go, *plan.acceleration]])


@lru_cache(maxsize=8)
def _halton_points(count: int) -> Array:
    """Return points (count, 4) of a Halton sequence in the four-dimensional unit cube.

    They are evenly spread; at least one point is returned.
    """
    points: Any = qmc.Halton(4, scramble=False).random(max(count, 1) + 1)[1:]
    return np.asarray(points)
