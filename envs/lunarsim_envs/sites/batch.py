"""Simulate many landers with site decisions in compiled kernels."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from lunarsim.core.feedback import compile_formula, follow_path
from lunarsim.errors import InputError
from lunarsim.onboard.guidance.divert_cost import divert_params
from lunarsim.onboard.guidance.path_guidance import CompiledFeedback
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.onboard.policies.candidates import SAFETY_LEVELS
from lunarsim.scenario import Scenario
from lunarsim.typing import Array, BoolArray
from lunarsim.vehicle._kernels import SIMD_BATCH
from lunarsim_envs.descent.batch import FLYING, DescentBatch, VehicleParams
from lunarsim_envs.sites import _choice_kernels as choice
from lunarsim_envs.sites import _flight_kernels as f
from lunarsim_envs.sites import _map_kernels as m
from lunarsim_envs.sites.field_of_view import deciding_mapper, scan_altitudes
from lunarsim_envs.sites.pool import SiteWorldPool

# Compute time per lane and control cycle, and per lane and map, microseconds.
_CYCLE, _MAP = 6.0, 2000.0
# Values of the current site before the first map: not observed, out of reach, no miss.
_NOTHING = np.array([np.nan, np.inf, 0.0])


def kernel_guidance(scenario: Scenario, craft: VehicleParams) -> f.GuidanceParams:
    """Convert the guidance settings of a scenario to the form that kernels use.

    Raises
    ------
    InputError
        If the scenario has tables or settings that only the full simulation supports.
    """
    software = scenario.software()
    guidance, approach, window = software.guidance, software.approach, software.decisions
    _check_supported(scenario, guidance)
    lander = craft.dynamics.lander
    gravity = scenario.gravity_m_s2
    lag = software.control.response_time + lander.thrust_lag
    end = approach.end(np.zeros(3), lander)
    feedback = guidance.feedback(gravity)
    clock = scenario.simulation.make()
    return f.GuidanceParams(
        divert_params(guidance.shape, end, lander, gravity, approach.limits),
        feedback is not None, feedback.formula if feedback else compile_formula(follow_path),
        feedback.gains if feedback else np.empty(0),
        np.asarray(end.position, dtype=np.float64),
        np.array([
            max(approach.vertical_altitude, approach.takeover_altitude), approach.end_time_to_go,
        ]),
        VerticalDescent().for_lag(lag, gravity, lander.dry_mass, lander.exhaust_velocity).params,
        -approach.vertical_descent_speed,
        np.array([window.last_altitude, window.first_altitude, window.interval]),
        scan_altitudes(scenario), lag, guidance.min_time_to_go, approach.max_tilt,
        lander.thrust_max, lander.com_height, clock.steps,
    )  # fmt: skip


def _check_supported(scenario: Scenario, guidance: Any) -> None:
    """Raise InputError if kernels do not support the guidance or a scenario table."""
    kind = type(guidance)
    plain = (
        isinstance(guidance, PathLaw) and kind.cost is PathLaw.cost and kind.build is PathLaw.build
    )
    feedback = guidance.feedback(scenario.gravity_m_s2) if plain else None
    if not plain or not isinstance(feedback, CompiledFeedback | None):
        raise InputError(
            "guidance.kind", scenario.guidance.kind,
            "must be a law with paths of one shape (as 'apollo' has) for this perception",
            "Otherwise use perception='onboard'.",
        )  # fmt: skip
    if scenario.true_lander() != scenario.vehicle.make():
        raise InputError(
            "truth.vehicle", None, "must be omitted for this perception",
            "Otherwise use perception='onboard'.", show_value=False,
        )  # fmt: skip
    for table in (
        "braking", "window", "terminal_descent", "domain_randomization", "prior_map",
        "sensor_faults",
    ):  # fmt: skip
        if getattr(scenario, table) not in (None, {}):
            remedy = (
                "" if table == "domain_randomization" else "Otherwise use perception='onboard'."
            )
            raise InputError(
                table, None, "must be omitted for this perception", remedy, show_value=False
            )
    approach = scenario.approach.make()
    if not approach.has_free_time_to_go:
        key = "approach.jerk_m_s3" if approach.time_to_go is None else "approach.time_to_go_s"
        raise InputError(
            key, None, "must be omitted for this perception",
            "Otherwise use perception='onboard'.", show_value=False,
        )  # fmt: skip


class SiteDescentBatch(DescentBatch):
    """Landers that fly in parallel, map the terrain and can divert to other sites.

    A lane is one lander of the batch with its current flight.

    Parameters
    ----------
    count
        Number of lanes n.
    scenario
        Scenario of the flights.
    pool
        Worlds with their true safety.
    errors
        Error model of the perception, from `Surrogate.errors` or `exact_errors`.
    view
        Field of view of the LiDAR, from `fov_and_footprint`.
    drift_sigma, reported_velocity_sigma
        True standard deviation of the drift velocity, east and north (2,), and the standard
        deviation that navigation reports per axis, m/s.
    posting
        Cell size of the maps, m.

    Attributes
    ----------
    guidance, maps, candidates
        Guidance states (`GuidanceState`), hazard maps (`Maps`) and candidate sites
        (`CandidateSites`).
    refused, time_scale_refused
        Whether the site of the last decision was out of reach, and whether its factor on the
        time-to-go was refused (n,).
    """

    levels: ClassVar[Array] = np.array(SAFETY_LEVELS, np.float32)
    keeps_maps: ClassVar[bool] = True
    max_distance_ratio: ClassVar[float] = np.inf

    def __init__(
        self, count: int, scenario: Scenario, pool: SiteWorldPool, *, errors: m.MapErrorModel,
        view: Array, drift_sigma: Array, reported_velocity_sigma: float, posting: float,
    ) -> None:  # fmt: skip
        craft = VehicleParams.of(scenario)
        clock = scenario.simulation.make()
        super().__init__(count, craft, pool.terrains, guided=True, rate=1.0 / clock.cycle)
        self.pool, self.errors, self.view = pool, errors, view
        self.law = kernel_guidance(scenario, craft)
        self.decisions = scenario.decisions.make()
        size = scenario.mappers[deciding_mapper(scenario)].make().size
        cells = max(1, round(size / posting)) if self.keeps_maps else 1
        self.drift_sigma = np.asarray(drift_sigma, dtype=np.float64)
        approach = scenario.approach.make()
        miss_params = np.array([
            self.decisions.touchdown_sigma, reported_velocity_sigma,
            approach.vertical_altitude / approach.vertical_descent_speed,
        ])  # fmt: skip
        self.guidance = _guidance_state(count)
        self.maps = _maps(count, cells, posting, miss_params)
        # Twice the number: reachable candidates, plus substitutes for those out of reach.
        self.candidates = _candidate_sites(
            count, 2 * (self.decisions.candidates + len(self.levels))
        )
        self.refused, self.time_scale_refused = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        self._control = self._vehicle.control

    def begin(self, mask: BoolArray) -> None:
        """Start new flights of the landers of `mask` (n,); fly to their first decisions."""
        super().begin(mask)
        f.begin.run_loop(
            self.count, 100.0, mask, self._keys, self._flight_counts, self.y, self.target,
            self.drift_sigma, self._control, self.craft.heading, self.guidance, self.law,
        )  # fmt: skip
        maps = self.maps
        half = 0.5 * (maps.p.shape[1] - 1) * maps.posting
        maps.corner[mask] = self.target[mask, :2] - half
        maps.p[mask], maps.seen[mask], maps.averaged[mask] = 0.0, False, 0.0
        maps.height[mask] = np.nan
        maps.averaged_miss[mask], maps.map_time[mask] = np.nan, 0.0
        self.refused[mask] = self.time_scale_refused[mask] = False
        # Clear the candidates of the last flight, because a flight may end before its first map.
        self.candidates.number[mask], self.candidates.here[mask] = 0, _NOTHING
        self.mapped = mask.copy()
        self._fly_on(mask)

    def decide(self, sites: Array, mask: BoolArray, time_scales: Array | None = None) -> None:
        """Apply site decisions of some landers and fly to the next decision or the end.

        Parameters
        ----------
        sites
            New sites (n, 3), local frame, m; NaN keeps the site.
        mask
            Landers that decide (n,).
        time_scales
            Factors on the time-to-go of the minimum-propellant path (n,); NaN or None keeps the
            time-to-go.
        """
        mask = mask & (self.ended == FLYING)
        asked = np.full(self.count, np.nan) if time_scales is None else time_scales
        f.decide.run_loop(
            self.count, 20.0, mask, self.time, self.y, sites, asked, self.guidance,
            self.law, self.refused, self.time_scale_refused,
        )  # fmt: skip
        self.mapped = np.zeros(self.count, np.bool_)
        self._fly_on(mask)

    def _fly_on(self, mask: BoolArray) -> None:
        """Fly to the next decision or the end, with scans on the way.

        Then evaluate the candidate sites of the landers of `mask` (n,) that still fly.
        """
        while True:
            f.fly.run_loop(
                self.count, 10.0 * _CYCLE, self.y, self._rate, min(SIMD_BATCH, self.count),
                self.craft.dynamics.step, self.craft.time_limit, self._vehicle, self._terrains,
                self._flights, self.guidance, self.law,
            )  # fmt: skip
            due = (self.guidance.event == f.SCAN) & (self.ended == FLYING)
            if not due.any():
                break
            self.scan(due)
            self.mapped |= due
        asked = mask & (self.ended == FLYING)
        if asked.any():
            choice.select_candidates.run_loop(
                self.count, _MAP, asked, self.y, self.time,
                self.guidance, self.law, self.maps, self.decisions.candidates,
                self.decisions.separation, self.levels, self.candidates,
            )  # fmt: skip

    def scan(self, due: BoolArray) -> None:
        """Take a LiDAR scan for the landers of `due` (n,) and update their hazard maps."""
        m.scan.run_loop(
            self.count, _MAP, due, self._keys, self._flight_counts, self.y, self.time,
            self.world, self.guidance, self.maps, self.pool.layers, self.errors, self.view,
        )  # fmt: skip

    @property
    def estimated_state(self) -> tuple[Array, Array]:
        """Estimated position, m, and velocity, m/s, (n, 3) each, local frame."""
        slip, place = self.guidance.drift_velocity, self.y[:, :3].copy()
        velocity = self.y[:, 3:6].copy()
        place[:, :2] += slip * self.time[:, None]
        velocity[:, :2] += slip
        return place, velocity


def _guidance_state(n: int) -> f.GuidanceState:
    return f.GuidanceState(
        np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.full(n, np.nan), np.zeros(n, np.int64),
        np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.bool_), np.zeros((n, 7)),
        np.full((n, 8), np.nan), np.zeros((n, 2)),
    )  # fmt: skip


def _maps(n: int, cells: int, posting: float, miss_params: Array) -> m.Maps:
    shape = (n, cells, cells)
    return m.Maps(
        np.zeros((n, 2)), posting, np.zeros(shape, np.float32), np.zeros(shape, np.bool_),
        np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32), np.full(n, np.nan),
        miss_params, np.zeros(n),
    )  # fmt: skip


def _candidate_sites(n: int, most: int) -> choice.CandidateSites:
    return choice.CandidateSites(
        np.zeros((n, most, 3)), np.zeros((n, most)), np.zeros((n, most)), np.zeros((n, most)),
        np.zeros(n, np.int64), np.tile(_NOTHING, (n, 1)),
    )  # fmt: skip
