"""``lunarsim/Retarget-v0``: where to land, decided once a second on the way down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, suggestion
from lunarsim.onboard.policies import Observation
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim_envs.arguments import options_of, scenario_of, truth_of, weights_of, whole
from lunarsim_envs.descent.picture import Picture
from lunarsim_envs.rendering import Frames
from lunarsim_envs.rewards import RewardWeights, SiteRewards, summed
from lunarsim_envs.screen import Screen, modes_here
from lunarsim_envs.sites.actions import DEFAULT_ACTION, SiteActions
from lunarsim_envs.sites.flights import KernelFlight
from lunarsim_envs.sites.onboard import perceiving
from lunarsim_envs.sites.parts import DEFAULT, ShownSites
from lunarsim_envs.sites.perception import PERCEPTIONS, WHOLE, flight_of
from lunarsim_envs.views import Views

FloatArray = NDArray[np.float32]
# What a flight failed that ran out of time.
LATE = ("time-limit",)


def default_scenario() -> Scenario:
    """Return gently rolling highland relief with 7 % rock cover."""
    return Scenario.from_dict(
        {
            "name": "golombek",
            "rocks": {"cover": 0.07},
            "target": {"scatter_m": [45.0, 45.0]},
        }
    )


def retarget_scenario(
    given: Scenario | str | Path | None, changes: Mapping[str, Any] | None
) -> Scenario:
    """Return a scenario from itself, a path, a name or nothing, with other values of some keys.

    Raises
    ------
    InputError
        If it has nothing to decide on.
    """
    scenario = scenario_of(given, changes, default_scenario())
    if not scenario.mappers:
        raise InputError("mappers", {}, "at least one table [mappers.NAME] to decide on")
    return scenario


class RetargetEnv(gymnasium.Env[dict[str, Any], Any]):
    """Choose the landing site of a descending lander.

    One step is one decision, and the flight goes on until the next one is due. With perception
    ``"onboard"``, ``"shadows"``, ``"quadtree"`` or ``"fused"`` the environment steps the same
    `lunarsim.simulation.Simulation` as the command line. With ``"truth"``, ``"surrogate"`` or
    ``"gaussian-dem"`` the same laws of guidance, attitude loop, vehicle and verdict fly in kernels,
    over a pool of worlds, a hundred times as fast; navigation is then the truth and a drift (none
    with ``"truth"``).

    ## Action Space

    ``Discrete(21)``: 0 keeps the present site, i flies to row i - 1 of ``sites``. Choosing a row
    that is not available keeps the site and costs the ``invalid`` term;
    ``info["action_mask"]`` (21,) tells which actions are available.

    ``action=("site", "stretch")`` makes it ``MultiDiscrete([21, 5])``: where to, and by which path,
    that is in which time. By 0 the second number leaves the time-to-go as it is (a new site gets
    the cheapest); by 1 to 4 it becomes 1, 1.07, 1.15 or 1.3 times that of the cheapest admissible
    path from here to the site, be it new or the present one
    (`lunarsim_envs.sites.actions.STRETCHES`). What would break a limit of the approach gives way to
    the cheapest; ``info["stretch_refused"]`` tells that the last step asked for a stretch that is
    not flown. The cheapest path is mostly the fastest that keeps the limits, so none takes less
    time. A stretch is refused, too, where the row is not available (all stays as it is then), where
    the site is refused, and where the mission sets the time-to-go (``approach.time_to_go_s``,
    ``jerk_m_s3``) or the law does (``optimal``, ``neural-optimal``, ``information-seeking``).

    ``info["action_mask"]`` and `action_masks` are (26,) then, the choices of one part after those
    of the other, as MaskablePPO takes them; ``MultiDiscrete.sample(mask=...)`` takes
    ``tuple(numpy.split(info["action_mask"], [21]))``. `lunarsim_envs.sites.actions.register` adds
    parts. Agents that choose sites alone fly there too, and leave the time-to-go as it is.

    ## Observation Space

    A ``Dict`` of float32 arrays, named parts (``observation=[...]`` chooses others):

    - ``estimate`` (10,): position relative to the present site (m), velocity (m/s), attitude
      quaternion (scalar last), as navigation estimates them.
    - ``hazard_map`` (2, 48, 48): mean probability of safety and share observed in equal blocks of
      the hazard map; row 0 south, column 0 west.
    - ``sites`` (20, 6): offset from the present site east, north, up (m), probability of safety,
      propellant to reach it (kg), 1 if available. Rows without a site are zero.
    - ``to_go`` (3,): time-to-go (s), propellant left (kg), altitude above the site (m).

    Also:

    - ``candidates`` (20, 6): the rows of the actions: offset east and north (m), probability of
      safety, propellant over that of the present site (kg), distance (m), 1 if available.
    - ``site`` (4,): of the present site: probability of safety, 1 if it has been seen, propellant
      to reach it (kg), expected miss (m).
    - ``hazard_crop`` (2, 33, 33): probability of safety and 1 where seen, a metre apart about the
      present site.

    `lunarsim_envs.sites.parts.register` adds more.

    ## Rewards

    The sum of named terms, in ``info["reward_terms"]``: ``touchdown`` (+1 for a safe landing, -1
    for any other end but that of the time), ``propellant`` (-1 for full tanks, in proportion),
    ``invalid`` (-0.05, ten times a flight at most); unless they are given weights nothing:
    ``speed``, ``tilt`` and ``hazard`` (of a safe touchdown by how near its speeds, its tilt, and
    slope and roughness under the pads are to the limits), ``information`` (of what the decision
    adds to what the map tells) and ``shaping`` (of a potential, the probability of safety of the
    site flown to; its discounted sum is the same for all flights from one first decision). Every
    crash returns less than any safe landing, shaping aside; weights with which it may not are
    refused.
    ``info["cost"]``, for constrained methods, is 1 where an episode terminates and is not safe, and
    0 else.

    ## Starting State

    World, target, start, navigation errors and sensor noise are drawn from the seed; the flight
    runs to the first decision (400 m above the site by default). Flown by kernels, it takes one of
    the pool's worlds.

    ``reset(options=...)``, for a curriculum, takes ``position_m``, ``velocity_m_s``,
    ``position_sigma_m`` and ``velocity_sigma_m_s`` of the table [start], ``target_m`` and
    ``target_scatter_m`` of [target], and ``cover`` of [rocks]; they hold until the next reset, also
    through automatic ones. Flown by kernels, targets must lie where those of the scenario may, and
    covers be named by ``covers``. The whole computer also takes ``sun_azimuth_deg`` and
    ``sun_elevation_deg`` of [sun].

    ## Episode End

    Terminated when the flight ends: touchdown, or off the map. The last decision is taken at 50 m;
    the step after it flies to the ground. Truncated by the scenario's time limit: the flight counts
    as not safe then, but neither as a crash. A flight that ends before there is anything to decide
    ends with the first step, whatever it is.

    ## Arguments

    - ``scenario``: a `lunarsim.scenario.Scenario`, the path of a TOML file or the name of a shipped
      one.
    - ``changes``: other values of some of its keys, ``{"rocks.cover": 0.1}``.
    - ``perception``: ``"onboard"``, the scenario's own mapper and navigation; ``"truth"``, the
      exact safety of what the LiDAR has in view; ``"surrogate"``, a statistical model of the
      mapper's errors in space; ``"gaussian-dem"``, that mapper on real scans; ``"shadows"``,
      ``"quadtree"``, ``"fused"``, a mapper of that kind on board, whichever the scenario decides
      on: what it lacks for it is added (`lunarsim_envs.sites.onboard.perceiving`).
    - ``surrogate``: file of another surrogate, of ``scenarios/learning/fit_surrogate.py``.
    - ``observation``, ``action``: names of their parts.
    - ``worlds``, ``world_seed``: flown by kernels, how many worlds are drawn, once, and their root
      seed; the truth about them is kept in the cache of campaigns.
    - ``covers``: further covers of rocks, of each of which as many worlds are drawn, for
      ``reset(options={"cover": ...})``.
    - ``weights``: `lunarsim_envs.rewards.RewardWeights`; by default those of the table
      [site_reward] of the scenario.
    - ``render_mode``: ``"rgb_array"``, a frame at each decision; ``"rgb_array_list"``, a frame
      every half second of the flight since the last call, down to the ground (not of flights by
      kernels); ``"human"``, the same frames in a window; or None.
      ``lunarsim_envs.video`` makes films of them.
    - ``views``: whether frames show a chase view of the lander over the rendered ground, what its
      camera sees, and gauges as well (needs OpenGL; not of flights by kernels).

    - ``num_envs``, ``autoreset_mode``, ``max_episode_steps`` with ``gymnasium.make_vec(...,
      vectorization_mode="vector_entry_point")``: number of flights in kernels, with perception
      ``"surrogate"`` unless another of those that kernels fly is asked for; "NextStep", "SameStep"
      or "Disabled"; number of steps after which an episode is truncated. Lane i with seed s flies
      what one environment with seed s + i does.

    ## Version History

    - v0: first version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array", "rgb_array_list", "human"],
        "render_fps": 2,
    }

    def __init__(
        self,
        scenario: Scenario | str | Path | None = None,
        weights: RewardWeights | None = None,
        render_mode: str | None = None,
        *,
        perception: str = "onboard",
        observation: Sequence[str] = DEFAULT,
        action: Sequence[str] = DEFAULT_ACTION,
        changes: Mapping[str, Any] | None = None,
        worlds: int = 16,
        world_seed: int = 0,
        covers: Sequence[float] = (),
        surrogate: Any = None,
        views: bool = False,
    ) -> None:
        if not isinstance(perception, str) or perception not in PERCEPTIONS:
            raise InputError("perception", perception, suggestion(str(perception), PERCEPTIONS))
        if perception not in WHOLE:
            self.metadata = self.metadata | {
                "render_modes": ["rgb_array", "human"],
                "render_fps": 1,
            }
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            named = ", ".join(map(repr, modes))
            raise ValueError(f"render_mode = {render_mode!r}: must be {named} or None")
        views = truth_of("views", views)
        worlds, world_seed = whole("worlds", worlds, 1), whole("world_seed", world_seed, 0)
        if views and (render_mode is None or perception not in WHOLE):
            named = ", ".join(map(repr, WHOLE))
            raise InputError("views", views, f"False without a render_mode or a perception {named}")
        # Those of the class have "human" everywhere: else Gymnasium would not ask for it here.
        self.metadata = self.metadata | {"render_modes": modes_here(modes)}
        self.scenario = retarget_scenario(scenario, changes)
        if perception in WHOLE:
            self.scenario = perceiving(self.scenario, perception)
        self.weights = weights_of(weights, RewardWeights) or RewardWeights.of(self.scenario)
        lander = self.scenario.vehicle.make()
        self.rewards = SiteRewards(self.weights, lander.propellant_mass, 1)
        self.render_mode = render_mode
        self.perception = perception
        self.actions = SiteActions(action)
        self.flight = flight_of(perception, self.scenario, worlds, world_seed, surrogate, covers)
        self.shown = ShownSites(observation)
        self.action_space = self.actions.space
        self.observation_space = self.shown.space
        self.frames: Frames | None = None
        self.views: Views | None = None
        self._picture: Picture | None = None
        if render_mode is not None and isinstance(self.flight, KernelFlight):
            self._picture = Picture(self.flight.lanes)
        self._with_views = views
        self._begun, self._over = False, False
        self._due = 0.0
        self._film: list[NDArray[np.uint8]] = []
        # What frames say of the last step: row, reward, stretch.
        self._last: tuple[int | None, float | None, float | None] = (None, None, None)
        self._screen = Screen(self.metadata["render_fps"]) if render_mode == "human" else None

    @property
    def simulation(self) -> Simulation | None:
        """What flies with perception "onboard"; None else, and before the first reset."""
        return self.flight.simulation

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a new flight and run it to the first decision."""
        self.flight.take(options_of(options))
        self._begin(seed)
        self.frames, self._last, self._film = None, (None, None, None), []
        self._begun, self._over = True, False
        self.rewards.begin(np.ones(1, np.bool_), *self.standing())
        if self._picture is not None:
            self._picture.begin()
        elif self.render_mode is not None and self.simulation is not None:
            # Axes take longer than a frame may: they are made with the flight.
            self.frames = Frames(self.simulation, self.flight.seen)
            self.views = Views(self.simulation) if self._with_views else None
        self._take_frame()
        return self._encode(), self._info()

    def _begin(self, seed: int | None) -> None:
        """Seed and begin a flight; one that is refused as it begins leaves the seed as it was."""
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
        """Carry out a decision and fly on to the next one."""
        flight = self.flight
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        if self._over:
            raise gymnasium.error.ResetNeeded("the flight has ended: call reset()")
        chosen = self.actions.chosen(action)
        orders = self.actions.orders(chosen, flight.sights)
        invalid = bool(orders.invalid[0])
        row = 0 if invalid else int(self.actions.choice("site", chosen)[0])
        site = None if np.isnan(orders.site[0, 0]) else orders.site[0]
        stretch = None if np.isnan(orders.stretch[0]) else float(orders.stretch[0])
        self._last = (row, None, stretch)
        self._due = flight.time + 1.0 / self.metadata["render_fps"]
        # A flight may end before there is anything to decide: its first step tells so.
        if flight.verdict is None:
            flight.decide(site, self._each, stretch)
        verdict = flight.verdict
        self._over = verdict is not None
        # Time has run out: the flight was cut off, and nobody knows how it would have ended.
        late = verdict is not None and verdict[1] == LATE
        ended = self._over and not late
        terms = self._terms(invalid, None if late else verdict)
        info = self._info() | {"reward_terms": terms}
        info["cost"] = float(verdict is not None and ended and not verdict[0])
        if self.actions.stretches:
            info["stretch_refused"] = bool(orders.lost[0]) or flight.unstretched
        reward = float(summed(terms))
        self._last = (row, reward, stretch)
        self._take_frame()
        return self._encode(), reward, ended, late, info

    def standing(self) -> tuple[Any, ...]:
        """Return mass, p_safe of the site and the map of the one flight; see `SiteRewards`."""
        sights = self.flight.sights
        return np.array([self.flight.mass]), sights.here[:, 0], sights.p, sights.seen

    def _terms(
        self, invalid: bool, verdict: tuple[bool, tuple[str, ...]] | None
    ) -> dict[str, float]:
        """Return the terms of the decision that has been carried out, by name."""
        over, safe = verdict is not None, verdict is not None and verdict[0]
        touch = self.flight.touch if over else np.full((1, 3), np.nan)
        one, wrong, ended, well = np.array([[True], [invalid], [over], [safe]])
        terms = self.rewards.terms(one, wrong, ended, well, touch, one, *self.standing())
        return {name: float(term[0]) for name, term in terms.items()}

    def render(self) -> NDArray[np.uint8] | list[NDArray[np.uint8]] | None:  # type: ignore[override]
        """Return the descent, its last 60 m and the map as an image (360, 800, 3).

        With `views` a chase view, the onboard camera and gauges stand above it (720, 800, 3).
        In the mode ``"human"`` it returns nothing: a window shows every frame as the flight goes.
        Axes stay as the first frame of a flight has them. In the mode of lists it returns the
        images since the last call.
        """
        if self.render_mode is None:
            return None
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before render()")
        if self.render_mode == "rgb_array_list":
            film, self._film = self._film, []
            return film
        return None if self._screen is not None else self._frame()

    @property
    def seen(self) -> Observation | None:
        """What the onboard computer shows a policy now; None before the first reset."""
        return self.flight.seen if self._begun else None

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which choices can be had (21,), as sb3-contrib's MaskablePPO asks for it.

        Of several parts those of one after those of the other.
        """
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before action_masks()")
        return np.asarray(self.actions.masks(self.flight.sights)[0])

    def _frame(self) -> NDArray[np.uint8]:
        """Return an image of the flight as it stands."""
        if self._picture is not None:
            return self._picture.draw()
        assert self.frames is not None
        drawn = self.frames.draw(self.flight.seen, *self._last)
        return drawn if self.views is None else np.vstack((self.views.draw(), drawn))

    def close(self) -> None:
        """Let go of the flight, its pictures, and what they hold on the graphics device."""
        self.frames, self.views, self._film = None, None, []
        self._begun = False
        if self._screen is not None:
            self._screen.close()
        self.flight.close()

    def _take_frame(self) -> None:
        """Keep an image for the mode of lists, or show it."""
        if self.render_mode == "rgb_array_list":
            self._film.append(self._frame())
        elif self._screen is not None:
            self._screen.show(self._frame())

    def _each(self) -> None:
        """Note where the lander is, and keep an image where one is due."""
        if self._picture is not None:
            self._picture.note()
        elif self.frames is not None and self.flight.time > self._due - 1e-6:
            self._due += 1.0 / self.metadata["render_fps"]
            self._take_frame()

    def _encode(self) -> dict[str, FloatArray]:
        return {name: one[0] for name, one in self.shown.of(self.flight.sights).items()}

    def _info(self) -> dict[str, Any]:
        flight = self.flight
        mask = self.actions.masks(flight.sights)[0].astype(np.int8)
        info: dict[str, Any] = {"time": flight.time, "action_mask": mask}
        verdict = flight.verdict
        if verdict is not None:
            info["safe"], info["failed"] = verdict
            info["propellant_kg"] = self._wet_mass - flight.mass
        return info

    @cached_property
    def _wet_mass(self) -> float:
        return float(self.scenario.vehicle.make().wet_mass)
