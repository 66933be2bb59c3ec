"""Run one flight with site decisions, by the full simulation or by kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.campaign.dispersions import Dispersions
from lunarsim.grid import Grid
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies import Candidates, Decision, Observation
from lunarsim.rng import SPLITS, RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_values
from lunarsim.simulation import Simulation
from lunarsim.typing import Array
from lunarsim_envs.descent.batch import FLYING
from lunarsim_envs.descent.options import KEYS, apply_options, scenario_with_options
from lunarsim_envs.dispersions import check_option_is_fixed
from lunarsim_envs.rewards import touchdown_limit_ratios
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.site_inputs import SiteInputs, downsample_maps


class SiteFlight(Protocol):
    """Interface of one simulated flight that stops at each site decision."""

    simulation: Simulation | None
    # Random scenario values of the current flight, by key.
    drawn: dict[str, Any]

    def apply_options(self, options: Mapping[str, Any]) -> None:
        """Apply options of `reset` to the next flights."""
        ...

    def begin(self, rng: np.random.Generator) -> None:
        """Start a random flight, selected by `rng`, and fly it to its first decision."""
        ...

    def decide(
        self, site: Array | None, after_cycle: Callable[[], None], time_scale: float | None = None
    ) -> None:
        """Apply a decision and fly to the next decision or the end.

        Parameters
        ----------
        site
            New site (3,), local frame, m; None keeps the site.
        after_cycle
            Function called after every control cycle of the full simulation; kernels call it once,
            at the end.
        time_scale
            Factor on the time-to-go of the minimum-propellant path; None keeps the time-to-go.
        """
        ...

    @property
    def time_scale_refused(self) -> bool:
        """Whether the factor on the time-to-go of the last decision was refused."""
        ...

    @property
    def seen(self) -> Observation:
        """Current observation of an onboard policy."""
        ...

    @property
    def inputs(self) -> SiteInputs:
        """Current observation of a policy, as arrays."""
        ...

    @property
    def time(self) -> float:
        """Time since the start, s."""
        ...

    @property
    def mass(self) -> float:
        """True mass of the lander, kg."""
        ...

    @property
    def outcome(self) -> tuple[bool, tuple[str, ...]] | None:
        """Whether the landing was safe, and the violated limits; None during the flight."""
        ...

    @property
    def touchdown_ratios(self) -> Array:
        """Touchdown speed, tilt and terrain over their limits (1, 3); NaN in flight."""
        ...

    def close(self) -> None:
        """Release the flight and its resources."""
        ...


class OnboardFlight:
    """A flight by the full simulation, with mappers and navigation of its scenario.

    `split` is the split of the worlds, one of `lunarsim.rng.SPLITS`; `dispersions` are the random
    scenario values of each flight, or None.
    """

    def __init__(
        self, scenario: Scenario, split: str, dispersions: Dispersions | None = None
    ) -> None:
        self._split, self._dispersions = split, dispersions
        self.drawn: dict[str, Any] = {}
        self.scenario = self._flown_scenario = scenario
        self.simulation: Simulation | None = None
        self._seen: Observation | None = None
        self._small: tuple[object, NDArray[np.float32]] | None = None
        self.time_scale_refused = False

    @property
    def _flown(self) -> Simulation:
        assert self.simulation is not None
        return self.simulation

    def apply_options(self, options: Mapping[str, Any]) -> None:
        """Apply options of `reset` to the next flights."""
        scenario = scenario_with_options(options, self.scenario)
        for option in options:
            check_option_is_fixed(option, KEYS[option], self._dispersions)
        self._flown_scenario = scenario

    def begin(self, rng: np.random.Generator) -> None:
        """Start a random flight, selected by `rng`, and fly it to its first decision."""
        # Seeds of different splits lie in different ranges, so that worlds are different.
        seed = int(rng.integers(2**62)) + SPLITS.index(self._split) * 2**62
        drawn = {} if self._dispersions is None else self._dispersions.draws_of(RandomStreams(seed))
        scenario = with_values(self._flown_scenario, drawn, "dispersions")
        # If the start is refused, the last flight stays.
        new = Simulation(scenario, seed)
        self.close()
        self.simulation, self.drawn = new, drawn
        self.time_scale_refused = False
        self._fly_on(lambda: None)

    def decide(
        self, site: Array | None, after_cycle: Callable[[], None], time_scale: float | None = None
    ) -> None:
        """Apply a site decision and fly to the next decision or the end."""
        flown = self._flown
        before = len(flown.computer.telemetry)
        taken = flown.apply(Decision(site, "agent", time_scale=time_scale))
        events = {name for _, name, _ in flown.computer.telemetry[before:]}
        self.time_scale_refused = time_scale is not None and (
            not taken or "time-scale-refused" in events
        )
        flown.move()
        self._fly_on(after_cycle)

    def _fly_on(self, after_cycle: Callable[[], None]) -> None:
        flown = self._flown
        while not (flown.done or flown.decision_due):
            flown.move()
            after_cycle()
        self._seen = flown.observe()

    @property
    def seen(self) -> Observation:
        """Current observation of an onboard policy."""
        assert self._seen is not None
        return self._seen

    @property
    def inputs(self) -> SiteInputs:
        """Current observation of a policy, as arrays."""
        hazard_map = self.seen.hazard_map
        if self._small is None or self._small[0] is not hazard_map:
            small = downsample_maps(hazard_map.p_safe[None], hazard_map.observed[None])
            self._small = (hazard_map, small)
        return SiteInputs.of(self.seen, self._small[1])

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self._flown.time

    @property
    def mass(self) -> float:
        """True mass of the lander, kg."""
        return self._flown.state.mass

    @property
    def outcome(self) -> tuple[bool, tuple[str, ...]] | None:
        """Whether the landing was safe, and the violated limits; None during the flight."""
        outcome = self._flown.outcome
        return None if outcome is None else (outcome.safe, outcome.failure_causes)

    @property
    def touchdown_ratios(self) -> Array:
        """Touchdown speed, tilt and terrain over their limits (1, 3); NaN in flight."""
        outcome = self._flown.outcome
        t = None if outcome is None else outcome.touchdown
        if t is None:
            return np.full((1, 3), np.nan)
        values = t.vertical_speed, t.horizontal_speed, t.tilt, t.rate, t.slope, t.roughness
        return touchdown_limit_ratios(self._flown.lander, [values])

    def close(self) -> None:
        """Release the simulation: external software and graphics buffers of its terrain."""
        if self.simulation is not None:
            self.simulation.close()
        self.simulation, self._seen, self._small = None, None, None


class KernelFlight:
    """A flight by compiled kernels over a pool of worlds.

    `lanes` is a batch of one lander.
    """

    def __init__(self, lanes: SiteDescentBatch) -> None:
        self.simulation: Simulation | None = None
        self.drawn: dict[str, Any] = {}
        self.lanes = lanes
        self._one = np.ones(1, np.bool_)
        self._small = downsample_maps(lanes.maps.p, lanes.maps.seen)
        self._sights: SiteInputs | None = None

    def apply_options(self, options: Mapping[str, Any]) -> None:
        """Apply options of `reset` to the next flights."""
        apply_options(options, self.lanes, self._one)

    def begin(self, rng: np.random.Generator) -> None:
        """Start a random flight, selected by `rng`, and fly it to its first decision."""
        self._sights = None
        self.lanes.seed(self._one, rng.integers(2**64, size=1, dtype=np.uint64))
        self.lanes.begin(self._one)
        self._small = downsample_maps(self.lanes.maps.p, self.lanes.maps.seen)

    def decide(
        self, site: Array | None, after_cycle: Callable[[], None], time_scale: float | None = None
    ) -> None:
        """Apply a site decision and fly to the next decision or the end.

        `after_cycle` is called once, at the end.
        """
        goal = np.full((1, 3), np.nan) if site is None else np.asarray(site)[None]
        asked = None if time_scale is None else np.array([time_scale])
        self.lanes.decide(goal, self._one, asked)
        self._sights = None
        if self.lanes.mapped[0]:
            self._small = downsample_maps(self.lanes.maps.p, self.lanes.maps.seen)
        after_cycle()

    @property
    def time_scale_refused(self) -> bool:
        """Whether the factor on the time-to-go of the last decision was refused."""
        return bool(self.lanes.time_scale_refused[0])

    @property
    def seen(self) -> Observation:
        """Current observation of an onboard policy."""
        return observation_of_lane(self.lanes, 0)

    @property
    def inputs(self) -> SiteInputs:
        """Current observation of a policy, as arrays."""
        if self._sights is None:
            self._sights = site_inputs(self.lanes, self._small)
        return self._sights

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return float(self.lanes.time[0])

    @property
    def mass(self) -> float:
        """True mass of the lander, kg."""
        return float(self.lanes.y[0, 13])

    @property
    def outcome(self) -> tuple[bool, tuple[str, ...]] | None:
        """Whether the landing was safe, and the violated limits; None during the flight."""
        if self.lanes.ended[0] == FLYING:
            return None
        return bool(self.lanes.safe[0]), self.lanes.failure_causes(0)

    @property
    def touchdown_ratios(self) -> Array:
        """Touchdown speed, tilt and terrain over their limits (1, 3); NaN in flight."""
        return touchdown_limit_ratios(self.lanes.craft.dynamics.lander, self.lanes.touchdown_values)

    def close(self) -> None:
        """Do nothing: there are no resources to release."""


def site_inputs(lanes: SiteDescentBatch, small: NDArray[np.float32]) -> SiteInputs:
    """Collect the arrays from which observations of n landers are computed.

    `small` are the downsampled maps (n, 2, 48, 48), from `downsample_maps`.
    """
    place, velocity = lanes.estimated_state
    guidance, found, maps = lanes.guidance, lanes.candidates, lanes.maps
    left = np.maximum(guidance.arrival - lanes.time, 0.0)
    return SiteInputs(
        place, velocity, lanes.y[:, 6:10], guidance.site, left,
        lanes.y[:, 13] - lanes.params[:, 3], found.position, found.p_safe, found.distance,
        found.propellant, found.number, found.here, maps.p, maps.seen, maps.corner, maps.posting,
        small,
    )  # fmt: skip


def observation_of_lane(lanes: SiteDescentBatch, lane: int) -> Observation:
    """Return the observation of an onboard policy for lander `lane` of a batch."""
    place, velocity = (one[lane] for one in lanes.estimated_state)
    y, maps, found, guidance = lanes.y[lane], lanes.maps, lanes.candidates, lanes.guidance
    n = int(found.number[lane])
    covariance = np.zeros((9, 9))
    covariance[[3, 4], [3, 4]] = maps.miss_params[1] ** 2
    rows, cols = maps.p.shape[1:]
    west, south = map(float, maps.corner[lane])
    grid = Grid(west, south, maps.posting, rows, cols)
    hazard_map = HazardMap(
        grid, maps.p[lane].copy(), maps.seen[lane].copy(), maps.height[lane].copy()
    )
    p_here, cost_here, miss = map(float, found.here[lane])
    return Observation(
        time=float(lanes.time[lane]),
        estimate=Estimate(
            float(lanes.time[lane]), place, velocity, y[6:10].copy(), y[10:13].copy(),
            float(y[13]), covariance,
        ),
        hazard_map=hazard_map,
        candidates=Candidates(
            found.position[lane, :n].copy(), found.p_safe[lane, :n].copy(),
            found.distance[lane, :n].copy(), found.propellant[lane, :n].copy(),
        ),
        site=guidance.site[lane].copy(),
        site_p_safe=p_here,
        site_propellant=cost_here,
        time_to_go=float(guidance.arrival[lane] - lanes.time[lane]),
        propellant=float(y[13] - lanes.params[lane, 3]),
        expected_miss=miss,
    )  # fmt: skip
