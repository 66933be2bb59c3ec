"""Environment ``lunarsim/Retarget-v1``: choose the landing site once per second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, suggestion
from lunarsim.onboard.policies import Observation
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.typing import BoolArray
from lunarsim_envs.arguments import (
    checked_bool,
    checked_int,
    checked_options,
    checked_split,
    checked_weights,
    scenario_argument,
)
from lunarsim_envs.chase_view import ChaseViewRenderer
from lunarsim_envs.frame_window import FrameWindow, available_render_modes
from lunarsim_envs.rewards import RewardWeights, SiteRewards, sum_terms
from lunarsim_envs.sites.actions import DEFAULT_ACTION, SiteActions
from lunarsim_envs.sites.field_of_view import deciding_mapper
from lunarsim_envs.sites.flights import KernelFlight
from lunarsim_envs.sites.map_view import MapView
from lunarsim_envs.sites.observations import DEFAULT, SiteObservationLayout
from lunarsim_envs.sites.perception import FULL_SIMULATION, PERCEPTIONS, create_flight
from lunarsim_envs.sites.perception_scenarios import with_perception

if TYPE_CHECKING:
    from lunarsim_envs.frame_renderer import FrameRenderer

FloatArray = NDArray[np.float32]


def default_scenario() -> Scenario:
    """Return the default scenario: gently rolling highlands with 7 % rock cover."""
    return Scenario.from_dict(
        {
            "name": "golombek",
            "rocks": {"cover": 0.07},
            "target": {"scatter_m": [45.0, 45.0]},
        }
    )


def retarget_scenario(
    source: Scenario | str | Path | None, changes: Mapping[str, Any] | None
) -> Scenario:
    """Load the scenario of a ``Retarget-v1`` environment and apply changed values.

    `source` is a scenario, a path or a name; None selects `default_scenario`. `changes` has new
    values by scenario key.

    Raises
    ------
    InputError
        If the scenario has no mapper.
    """
    scenario = scenario_argument(source, changes, default_scenario())
    deciding_mapper(scenario)
    return scenario


class RetargetEnv(gymnasium.Env[dict[str, Any], Any]):
    """Choose the landing site of a descending lander.

    One step is one decision; the flight continues until the next decision is due. With the
    perceptions ``"onboard"``, ``"shadows"``, ``"quadtree"`` and ``"fused"``, the environment runs
    the same `lunarsim.simulation.Simulation` as the command line. With ``"truth"``, ``"surrogate"``
    and ``"gaussian-dem"``, compiled kernels run the same guidance laws, attitude loop, vehicle and
    touchdown evaluation over a pool of worlds (simulated terrains with rocks). They are over 200
    times as fast with ``"truth"`` and ``"surrogate"``, and 3 times with ``"gaussian-dem"``, which
    simulates scans. Navigation is then the true state plus a drift (no drift with ``"truth"``).

    ## Action Space

    ``Discrete(21)``: 0 keeps the current site; i diverts to the candidate site in row i - 1 of the
    observation ``sites``. If that site is not available, the lander keeps its site and the reward
    gets the ``invalid`` term.
    ``info["action_mask"]`` (21,) marks the available actions.

    With ``action=("site", "time_scale")`` the space is ``MultiDiscrete([21, 5])``. The second value
    sets the time-to-go: 0 keeps it (a new site gets the minimum-propellant path); 1 to 4 multiply
    the time-to-go of the minimum-propellant path to the site by 1, 1.07, 1.15 or 1.3
    (`lunarsim_envs.sites.actions.TIME_SCALES`). Factors below 1 are not offered, because the
    minimum-propellant path is usually the fastest one within the limits. If a factor would violate
    a limit of the approach, the lander flies the minimum-propellant path, and
    ``info["time_scale_refused"]`` is true. A factor is also refused if the site is not available
    (then nothing changes), if the divert is refused, and if the time-to-go is set by the mission
    (``approach.time_to_go_s``, ``jerk_m_s3``) or by the guidance law (``optimal``,
    ``neural-optimal``,
    ``information-seeking``).

    ``info["action_mask"]`` and `action_masks` then have shape (26,): the masks of both components
    in sequence, as MaskablePPO needs them. ``MultiDiscrete.sample(mask=...)`` needs
    ``tuple(numpy.split(info["action_mask"], [21]))``. `lunarsim_envs.sites.actions.register` adds
    custom components. Agents that choose only sites also work and keep the time-to-go.

    ## Observation Space

    A ``Dict`` of float32 arrays with these components (``observation=[...]`` selects others):

    - ``estimate`` (10,): estimated position relative to the current site (m), velocity (m/s) and
      attitude quaternion (scalar last), ENU.
    - ``hazard_map`` (2, 48, 48): mean p_safe and observed fraction in equal blocks of the hazard
      map; row 0 is south, column 0 is west.
    - ``sites`` (20, 6): offset from the current site east, north, up (m), p_safe, propellant to
      reach it (kg), 1 if available. Rows without a site are zero.
    - ``to_go`` (3,): time-to-go (s), remaining propellant (kg), altitude above the site (m).

    Also available:

    - ``candidates`` (20, 6): one row per divert action: offset east and north (m), p_safe,
      propellant minus that of the current site (kg), distance (m), 1 if available.
    - ``site`` (4,): current site: p_safe, 1 if observed, propellant to reach it (kg), expected miss
      (m).
    - ``hazard_crop`` (2, 33, 33): p_safe and observed mask around the current site, 1 m spacing.
    - ``site_features`` (21, 8): scaled features of each action
      (`lunarsim_envs.sites.site_features`), for a network that scores all sites alike.

    p_safe is the probability, given the measurements, that a touchdown centred there violates none
    of the limits of slope, roughness and belly clearance, whatever its heading. It excludes speed,
    tilt, tip-over and position error. ``sites``, ``candidates`` and ``site`` average it over the
    expected position error.

    - *Extent of the map.* In the default scenario the map is a square of 100 m with blocks of 2.1
      m. It is centred on the first current site and does not move when the lander diverts: the
      current site is then at the sum of the offsets of the chosen rows, within centimetres.
      ``hazard_crop`` moves with the current site. Axes are ENU.
    - *Rows.* Rows are sorted by falling p_safe. A site can change its row between two steps. Rows
      are ``decisions.candidates`` (16) sites with the highest p_safe, up to four nearest sites
      above p_safe of 0.99, 0.95, 0.8 and 0.5, and sites that the mapper ranks, at most 20 in all.
    - *Availability.* A site is unavailable if the lander cannot reach it within the limits of
      [approach] (thrust, tilt, glideslope, reserve). Its propellant is then 5000 kg.
    - *Before the first map* all values of the map and of ``sites`` are zero. In the default
      scenario, the map usually comes with the third step.
    - *Time-to-go.* The first step plans the minimum-propellant path again, also with action 0. The
      time-to-go then changes by several seconds. In later steps action 0 lets it count down.
    - *Calibrated domain.* The observation does not contain the layer ``in_domain`` of the map,
      which marks cells with a calibrated p_safe. It is ``env.unwrapped.seen.hazard_map.in_domain``
      (None with kernels). The title "Map is outside its calibrated domain" of a frame means that no
      observed cell is in the domain: use p_safe only to rank sites.

    `lunarsim_envs.sites.observations.register` adds custom components.

    ## Info

    - At every step and at `reset`: ``time``, s since the start, ``action_mask``, and with
      ``dispersions`` the drawn values by scenario key.
    - At every step: ``reward_terms``, ``cost``, and ``time_scale_refused`` if the action has a
      ``time_scale``.
    - At the end of an episode: ``safe``, ``failure_causes``, ``propellant_kg`` used since the start
      and ``score``, the sum of the rewards without shaping. In a vector environment,
      ``failure_causes`` has one bit for each limit in `lunarsim.core.touchdown.CAUSES`.

    ``env.unwrapped.action_masks()`` returns the mask as booleans.

    ## Rewards

    The reward is the sum of the terms in ``info["reward_terms"]``:

    - ``touchdown``: +1 for a safe landing, -1 for any other outcome.
    - ``propellant``: minus the propellant used since the last decision, as a fraction of a full
      tank (``vehicle.propellant_mass_kg``). Propellant used before the first decision is not
      charged.
    - ``invalid``: -0.05 for an unavailable row, at most ten times per flight.
    - ``speed``, ``tilt``, ``hazard``: penalties for a safe touchdown close to the limits of speed,
      tilt, and slope or roughness under the pads; zero weight by default.
    - ``information``: reward for map information gained since the last decision; zero weight by
      default.
    - ``shaping``: p_safe of the current site after the step, minus p_safe before it, with 0 after
      the end; zero weight by default. The sum over an episode is minus p_safe at the first
      decision, whatever the agent does.

    The score, without shaping, is higher for every safe landing than for any other outcome. Weights
    that violate this are refused. ``info["cost"]``, for constrained methods, is 1 if an episode
    ends without a safe landing, and 0 otherwise. `lunarsim_envs.costs.CostWrapper` adds costs of
    every step.

    ## Starting State

    The seed fixes world, target, start, navigation errors and sensor noise. The flight runs to the
    first decision (400 m above the site by default). Kernels use a world from the pool.

    For a curriculum, ``reset(options=...)`` accepts ``position_m``, ``velocity_m_s``,
    ``position_sigma_m`` and ``velocity_sigma_m_s`` of the table [start], ``target_m`` and
    ``target_scatter_m`` of [target], and ``cover`` of [rocks]. Options hold until the next call of
    `reset`; automatic resets keep them. With kernels, targets must be within the target area of the
    scenario, and the argument ``covers`` must contain the cover. The full simulation also accepts
    ``sun_azimuth_deg`` and ``sun_elevation_deg`` of [sun].

    ## Episode End

    The episode terminates when the flight ends by touchdown, off the map or at the time limit of
    the scenario. The last decision is at 50 m; the step after it flies to the touchdown. A flight
    that ends before the first decision ends with the first step, whatever its action.

    ## Arguments

    - ``scenario``: a `lunarsim.scenario.Scenario`, the path of a TOML file or the name of a
      scenario that is supplied with lunarsim. Default: rolling highlands with 7 % rock cover.
    - ``changes``: changed values by key, for example ``{"rocks.cover": 0.1}``.
    - ``perception``: source of the hazard map. ``"surrogate"`` (default): statistical model of the
      spatial errors of the mapper ``gaussian-dem``. ``"onboard"``: mapper and navigation of the
      scenario. ``"truth"``: true safety within the LiDAR's field of view. ``"gaussian-dem"``: this
      mapper with simulated scans.
      ``"shadows"``, ``"quadtree"``, ``"fused"``: an onboard mapper of this kind, which is added to
      the scenario if needed (`lunarsim_envs.sites.perception_scenarios.with_perception`).
    - ``surrogate``: file of a custom surrogate from ``scenarios/learning/fit_surrogate.py``.
    - ``dispersions``: random scenario values of each episode, for instance faults of sensors and
      actuators: distributions by key as in the table [dispersions] of a campaign, or the path of a
      campaign file. Only for the full simulation.
    - ``observation``, ``action``: names of the components. Default action: ``["site"]``.
    - ``worlds``, ``world_seed``: with kernels, number of worlds in the pool and their root seed
      (defaults: 4 and 0). Each takes about a second to build; train with more. The cache of
      campaigns keeps the true maps.
    - ``split``: ``"train"`` (default), ``"validation"`` or ``"test"``. No world of one split is a
      world of another, for any seed. ``lunarsim evaluate`` flies ``"test"`` by default. Measured
      terrain is the same in all splits; rocks differ.
    - ``covers``: additional rock covers for ``reset(options={"cover": ...})``. The pool has
      ``worlds`` worlds for each cover.
    - ``weights``: `lunarsim_envs.rewards.RewardWeights`, ``"dense"`` (default weights) or
      ``"sparse"`` (1 for a safe landing, otherwise 0). Default: the table [site_reward] of the
      scenario.
    - ``render_mode``: ``"rgb_array"`` returns a frame per decision; ``"rgb_array_list"`` returns
      frames every 0.5 s since the last call, down to touchdown (not with kernels); ``"human"``
      shows these frames in a window; None disables rendering. ``lunarsim_envs.video`` writes
      videos.
    - ``views``: adds a chase view over the rendered terrain, the onboard camera view and gauges to
      frames (needs OpenGL; not with kernels).
    - ``num_envs``, ``autoreset_mode``, ``max_episode_steps``, ``rendered`` with
      ``gymnasium.make_vec(..., vectorization_mode="vector_entry_point")``: number of flights in
      kernels; "NextStep", "SameStep" or "Disabled"; number of steps until truncation; environments
      whose frames ``render`` returns with ``render_mode="rgb_array"`` (default: the first one).
      Environment i with seed s gives the same episodes as a single environment with seed s + i.

    ## Version History

    - v1: first version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array", "rgb_array_list", "human"],
        "render_fps": 2,
    }

    def __init__(
        self,
        scenario: Scenario | str | Path | None = None,
        weights: RewardWeights | str | None = None,
        render_mode: str | None = None,
        *,
        perception: str = "surrogate",
        observation: Sequence[str] = DEFAULT,
        action: Sequence[str] = DEFAULT_ACTION,
        changes: Mapping[str, Any] | None = None,
        worlds: int = 4,
        world_seed: int = 0,
        split: str = "train",
        covers: Sequence[float] = (),
        surrogate: Any = None,
        dispersions: Mapping[str, Any] | str | Path | None = None,
        views: bool = False,
    ) -> None:
        if not isinstance(perception, str) or perception not in PERCEPTIONS:
            near = suggestion(str(perception), PERCEPTIONS)
            raise InputError("perception", perception, "is unknown", near)
        if perception not in FULL_SIMULATION:
            modes = ["rgb_array", "human"]
            self.metadata = self.metadata | {"render_modes": modes, "render_fps": 1}
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            named = ", ".join(map(repr, modes))
            raise ValueError(f"render_mode: must be {named} or None, got {render_mode!r}.")
        views, split = checked_bool("views", views), checked_split(split)
        worlds = checked_int("worlds", worlds, 1)
        world_seed = checked_int("world_seed", world_seed, 0)
        if views and (render_mode is None or perception not in FULL_SIMULATION):
            problem = f"needs a render_mode and a perception of {', '.join(FULL_SIMULATION)}"
            raise InputError("views", views, problem, show_value=False)
        # The class always lists "human", because Gymnasium checks the class before the instance.
        self.metadata = self.metadata | {"render_modes": available_render_modes(modes)}
        self.scenario = retarget_scenario(scenario, changes)
        if perception in FULL_SIMULATION:
            self.scenario = with_perception(self.scenario, perception)
        self.weights = checked_weights(weights, RewardWeights) or RewardWeights.of(self.scenario)
        tank = self.scenario.vehicle.make().propellant_mass
        self.rewards = SiteRewards(self.weights, tank, 1)
        self.render_mode, self.perception = render_mode, perception
        self.actions = SiteActions(action)
        more = worlds, world_seed, surrogate, covers, split, dispersions
        self.flight = create_flight(perception, self.scenario, *more)
        self.shown = SiteObservationLayout(observation)
        self.action_space = self.actions.space
        self.observation_space = self.shown.space
        self.frames: FrameRenderer | None = None
        self.views: ChaseViewRenderer | None = None
        self._picture: MapView | None = None
        if render_mode is not None and isinstance(self.flight, KernelFlight):
            self._picture = MapView(self.flight.lanes)
        self._with_views = views
        self._has_started, self._over, self._due = False, False, 0.0
        self._film: list[NDArray[np.uint8]] = []
        # Values of the last step for frame titles: row, reward, time scale.
        self._last: tuple[int | None, float | None, float | None] = (None, None, None)
        self._screen = FrameWindow(self.metadata["render_fps"]) if render_mode == "human" else None

    @property
    def simulation(self) -> Simulation | None:
        """Full simulation of the flight; None with kernels and before the first reset."""
        return self.flight.simulation

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a flight and run it to the first decision; return observation and info."""
        self.flight.apply_options(checked_options(options))
        self._begin(seed)
        self.frames, self._last, self._film = None, (None, None, None), []
        self._has_started, self._over = True, False
        self.rewards.begin(np.ones(1, np.bool_), *self.reward_inputs())
        if self._picture is not None:
            self._picture.begin()
        elif self.render_mode is not None and self.simulation is not None:
            from lunarsim_envs.frame_renderer import FrameRenderer  # noqa: PLC0415  (Matplotlib is slow)

            # Creating axes is slow, so it is done once per flight.
            self.frames = FrameRenderer(self.simulation, self.flight.seen)
            self.views = ChaseViewRenderer(self.simulation) if self._with_views else None
        self._take_frame()
        return self._encode(), self._info()

    def _begin(self, seed: int | None) -> None:
        """Seed and start a flight; after an `InputError`, restore the random generator."""
        before = self._np_random, self._np_random_seed
        super().reset(seed=seed)
        state = self.np_random.bit_generator.state
        try:
            self.flight.begin(self.np_random)
        except InputError:
            self.np_random.bit_generator.state = state
            if seed is not None:
                self._np_random, self._np_random_seed = before
            raise

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Apply a site decision and fly to the next decision or to the end of the flight."""
        flight = self.flight
        if not self._has_started:
            raise gymnasium.error.ResetNeeded("Call reset() before step().")
        if self._over:
            raise gymnasium.error.ResetNeeded("The episode has ended. Call reset().")
        chosen = self.actions.checked_choices(action)
        decisions = self.actions.decisions(chosen, flight.inputs)
        invalid = bool(decisions.invalid[0])
        row = 0 if invalid else int(self.actions.choice("site", chosen)[0])
        site = None if np.isnan(decisions.site[0, 0]) else decisions.site[0]
        time_scale = None if np.isnan(decisions.time_scale[0]) else float(decisions.time_scale[0])
        self._last = (row, None, time_scale)
        self._due = flight.time + 1.0 / self.metadata["render_fps"]
        # A flight may end before its first decision; the first step then reports the end.
        if flight.outcome is None:
            flight.decide(site, self._after_cycle, time_scale)
        outcome = flight.outcome
        self._over = outcome is not None
        terms = self._terms(invalid, outcome)
        info = self._info() | {"reward_terms": terms}
        info["cost"] = float(outcome is not None and not outcome[0])
        if self.actions.has_time_scale:
            info["time_scale_refused"] = (
                bool(decisions.factor_ignored[0]) or flight.time_scale_refused
            )
        reward = float(sum_terms(terms))
        self._last = (row, reward, time_scale)
        self._take_frame()
        return self._encode(), reward, self._over, False, info

    def reward_inputs(self) -> tuple[Any, ...]:
        """Return the arguments of `SiteRewards.begin` after the mask.

        They are the mass (1,), kg, p_safe of the current site (1,), and the maps of p_safe and of
        observed cells (1, rows, cols).
        """
        inputs = self.flight.inputs
        return np.array([self.flight.mass]), inputs.here[:, 0], inputs.p, inputs.seen

    def _terms(
        self, invalid: bool, outcome: tuple[bool, tuple[str, ...]] | None
    ) -> dict[str, float]:
        """Return the reward terms of the last decision by name.

        `invalid`: the chosen site was not available. `outcome`: whether the landing was safe, and
        the failure causes; None while flying.
        """
        over, safe = outcome is not None, outcome is not None and outcome[0]
        touchdown_ratios = self.flight.touchdown_ratios if over else np.full((1, 3), np.nan)
        one, wrong, ended, well = np.array([[True], [invalid], [over], [safe]])
        terms = self.rewards.terms(
            one, wrong, ended, well, touchdown_ratios, one, *self.reward_inputs()
        )
        return {name: float(term[0]) for name, term in terms.items()}

    def render(self) -> NDArray[np.uint8] | list[NDArray[np.uint8]] | None:  # type: ignore[override]
        """Return an RGB image of the descent, its last 60 m and the map (360, 800, 3).

        With `views`, the image also shows a chase view, the onboard camera view and gauges above
        the plots (720, 800, 3). With kernels, the image shows the descent in a vertical plane,
        gauges, and the hazard map with candidate sites (440, 1080, 3). The mode
        ``"rgb_array_list"`` returns the images since the last call.
        The mode ``"human"`` returns None, because a window shows every frame during the flight.
        """
        if self.render_mode is None:
            return None
        if not self._has_started:
            raise gymnasium.error.ResetNeeded("Call reset() before render().")
        if self.render_mode == "rgb_array_list":
            film, self._film = self._film, []
            return film
        return None if self._screen is not None else self._frame()

    @property
    def seen(self) -> Observation | None:
        """Observation as onboard policies get it; None before the first reset."""
        return self.flight.seen if self._has_started else None

    def action_masks(self) -> BoolArray:
        """Return the mask of available actions (21,), as MaskablePPO needs it.

        With several action components, their masks are concatenated.
        """
        if not self._has_started:
            raise gymnasium.error.ResetNeeded("Call reset() before action_masks().")
        return np.asarray(self.actions.masks(self.flight.inputs)[0])

    def _frame(self) -> NDArray[np.uint8]:
        """Draw an RGB image of the current state, as `render` returns it."""
        if self._picture is not None:
            return self._picture.draw()
        assert self.frames is not None
        drawn = self.frames.draw(self.flight.seen, *self._last)
        return drawn if self.views is None else np.vstack((self.views.draw(), drawn))

    def close(self) -> None:
        """Release the flight, its frames and their graphics memory."""
        self.frames, self.views, self._film = None, None, []
        self._has_started = False
        if self._screen is not None:
            self._screen.close()
        self.flight.close()

    def _take_frame(self) -> None:
        """Store an image for ``"rgb_array_list"``, or show it for ``"human"``."""
        if self.render_mode == "rgb_array_list":
            self._film.append(self._frame())
        elif self._screen is not None:
            self._screen.show(self._frame())

    def _after_cycle(self) -> None:
        """Add the current state to the drawn path; store or show a frame if one is due.

        The full simulation calls this function after each control cycle, kernels after each
        decision.
        """
        if self._picture is not None:
            self._picture.note()
        elif self.frames is not None and self.flight.time > self._due - 1e-6:
            self._due += 1.0 / self.metadata["render_fps"]
            self._take_frame()

    def _encode(self) -> dict[str, FloatArray]:
        return {name: one[0] for name, one in self.shown.of(self.flight.inputs).items()}

    def _info(self) -> dict[str, Any]:
        flight = self.flight
        mask = self.actions.masks(flight.inputs)[0].astype(np.int8)
        info: dict[str, Any] = {"time": flight.time, "action_mask": mask}
        if flight.drawn:
            info["dispersions"] = dict(flight.drawn)
        outcome = flight.outcome
        if outcome is not None:
            info["safe"], info["failure_causes"] = outcome
            lander = self.simulation.lander if self.simulation else self.scenario.true_lander()
            info["propellant_kg"] = lander.wet_mass - flight.mass
            info["score"] = float(self.rewards.score[0])
        return info
