"""``lunarsim/Retarget-v0``: where to land, decided once a second on the way down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.policies import Decision, Observation
from lunarsim.scenario import Scenario
from lunarsim.scenario.shipped import found
from lunarsim.simulation import Simulation
from lunarsim_envs.observations import FloatArray, encode, observation_space, shrink
from lunarsim_envs.rendering import Frames
from lunarsim_envs.rewards import RewardWeights, reward_terms

SITES = 20  # candidate sites that an agent may choose from


def default_scenario() -> Scenario:
    """Return gently rolling highland relief with 7 % rock cover."""
    return Scenario.from_dict(
        {
            "name": "golombek",
            "rocks": {"cover": 0.07},
            "target": {"scatter_m": [45.0, 45.0]},
        }
    )


class RetargetEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """Choose the landing site of a descending lander.

    The environment steps the same `lunarsim.simulation.Simulation` as the command line: one step
    is one decision, and the flight goes on until the next one is due.

    ## Action Space

    ``Discrete(21)``: 0 keeps the present site, i flies to row i - 1 of ``sites``. Choosing a row
    that is not available keeps the site and costs the ``invalid`` term;
    ``info["action_mask"]`` (21,) tells which actions are available.

    ## Observation Space

    A ``Dict`` of float32 arrays:

    - ``estimate`` (10,): position relative to the present site (m), velocity (m/s), attitude
      quaternion (scalar last), as navigation estimates them.
    - ``hazard_map`` (2, 48, 48): mean probability of safety and share observed in equal blocks of
      the hazard map; row 0 south, column 0 west.
    - ``sites`` (20, 6): offset from the present site east, north, up (m), probability of safety,
      propellant to reach it (kg), 1 if available. Rows without a site are zero.
    - ``to_go`` (3,): time-to-go (s), propellant left (kg), altitude above the site (m).

    ## Rewards

    The sum of named terms, in ``info["reward_terms"]``: ``touchdown`` (+1 for a safe landing, -1
    for any other end), ``propellant`` (-0.005 a kilogram burnt), ``invalid`` (-0.05).

    ## Starting State

    World, target, start, navigation errors and sensor noise are drawn from the seed; the flight
    runs to the first decision (400 m above the site by default).

    ## Episode End

    Terminated when the flight ends: touchdown, off the map, or the scenario's time limit. The
    last decision is taken at 50 m; the step after it flies to the ground. Never truncated.

    ## Arguments

    - ``scenario``: a `lunarsim.scenario.Scenario`, the path of a TOML file or the name of a shipped
      one.
    - ``weights``: `RewardWeights`.
    - ``render_mode``: ``"rgb_array"``, a frame at each decision; ``"rgb_array_list"``, a frame
      every half second of the flight since the last call, down to the ground; or None.
      ``lunarsim_envs.video.save_video`` makes a film of such frames.

    ## Version History

    - v0: first version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array", "rgb_array_list"],
        "render_fps": 2,
    }

    def __init__(
        self,
        scenario: Scenario | str | Path | None = None,
        weights: RewardWeights | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            modes = ", ".join(map(repr, self.metadata["render_modes"]))
            raise ValueError(f"render_mode = {render_mode!r}: must be {modes} or None")
        if scenario is None:
            self.scenario = default_scenario()
        elif isinstance(scenario, Scenario):
            self.scenario = scenario
        else:
            self.scenario = Scenario.load(found(Path(scenario)))
        if not self.scenario.mappers:
            raise InputError("mappers", {}, "at least one table [mappers.NAME] to decide on")
        self.weights = weights or RewardWeights()
        self.render_mode = render_mode
        self.action_space = spaces.Discrete(SITES + 1)
        self.observation_space = observation_space(SITES)
        self.simulation: Simulation | None = None
        self._observation: Observation | None = None
        self.frames: Frames | None = None
        self._film: list[NDArray[np.uint8]] = []
        self._last: tuple[int | None, float | None] = (None, None)
        self._shrunk: tuple[object, FloatArray] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a new flight and run it to the first decision."""
        super().reset(seed=seed)
        self.frames, self._last, self._film = None, (None, None), []
        self.simulation = Simulation(self.scenario, int(self.np_random.integers(2**62)))
        self._to_next_decision(self.simulation)
        if self.render_mode is not None:
            # Axes take longer than a frame may: they are made with the flight.
            assert self._observation is not None
            self.frames = Frames(self.simulation, self._observation)
        self._take_frame()
        return self._encode(self.simulation), self._info(self.simulation)

    def step(
        self, action: np.int64 | int
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Carry out a decision and fly on to the next one."""
        simulation, observation = self.simulation, self._observation
        if simulation is None or observation is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        if simulation.done:
            raise gymnasium.error.ResetNeeded("the flight has ended: call reset()")
        if not self.action_space.contains(action):
            raise ValueError(f"action = {action!r}: must be an integer from 0 to {SITES}")
        mass = simulation.state.mass
        invalid = False
        decision = Decision.keep("agent")
        if action > 0:
            row = int(action) - 1
            sites = observation.candidates
            invalid = row >= len(sites) or not bool(sites.reachable[row])
            if not invalid:
                decision = Decision(sites.position[row], "agent")
        simulation.apply(decision)
        simulation.move()
        self._last = (0 if invalid else int(action), None)
        self._to_next_decision(simulation)
        terms = reward_terms(
            self.weights,
            ended=simulation.done,
            safe=simulation.verdict is not None and simulation.verdict.safe,
            burnt=mass - simulation.state.mass,
            invalid=invalid,
        )
        info = self._info(simulation) | {"reward_terms": terms}
        self._last = (self._last[0], sum(terms.values()))
        self._take_frame()
        return self._encode(simulation), sum(terms.values()), simulation.done, False, info

    def render(self) -> NDArray[np.uint8] | list[NDArray[np.uint8]] | None:  # type: ignore[override]
        """Return the descent, its last 60 m and the map as an image (360, 800, 3).

        Axes stay as the first frame of a flight has them. In the mode of lists it returns the
        images since the last call.
        """
        if self.render_mode is None:
            return None
        if self.simulation is None or self._observation is None:
            raise gymnasium.error.ResetNeeded("call reset() before render()")
        if self.render_mode == "rgb_array_list":
            film, self._film = self._film, []
            return film
        return self._frame()

    @property
    def seen(self) -> Observation | None:
        """What the onboard computer shows a policy now; None before the first reset."""
        return self._observation

    def action_masks(self) -> NDArray[np.bool_]:
        """Return which actions are available (21,), as sb3-contrib's MaskablePPO asks for it."""
        if self.simulation is None:
            raise gymnasium.error.ResetNeeded("call reset() before action_masks()")
        return np.asarray(self._info(self.simulation)["action_mask"], dtype=np.bool_)

    def _frame(self) -> NDArray[np.uint8]:
        """Return an image of the flight as it stands."""
        assert self.frames is not None
        assert self._observation is not None
        return self.frames.draw(self._observation, *self._last)

    def _take_frame(self) -> None:
        """Keep an image for the mode of lists."""
        if self.render_mode == "rgb_array_list":
            self._film.append(self._frame())

    def _to_next_decision(self, simulation: Simulation) -> None:
        """Fly until a decision is due, or the end."""
        due = simulation.time + 1.0 / self.metadata["render_fps"]
        while not (simulation.done or simulation.decision_due):
            simulation.move()
            # Before the first decision there is no map to show.
            if self.frames is not None and simulation.time > due - 1e-6:
                due += 1.0 / self.metadata["render_fps"]
                self._take_frame()
        self._observation = simulation.observe()

    def _encode(self, simulation: Simulation) -> dict[str, FloatArray]:
        observation = self._observation
        assert observation is not None
        hazard_map = observation.hazard_map
        if self._shrunk is None or self._shrunk[0] is not hazard_map:
            self._shrunk = (hazard_map, shrink(hazard_map))
        return encode(observation, SITES, self._shrunk[1].copy())

    def _info(self, simulation: Simulation) -> dict[str, Any]:
        observation = self._observation
        assert observation is not None
        mask = np.zeros(SITES + 1, np.int8)
        mask[0] = 1
        reachable = observation.candidates.reachable[:SITES]
        mask[1 : 1 + len(reachable)] = reachable
        info: dict[str, Any] = {"time": simulation.time, "action_mask": mask}
        if simulation.verdict is not None:
            info["safe"] = simulation.verdict.safe
            info["failed"] = simulation.verdict.failed
            wet = self.scenario.vehicle.make().wet_mass
            info["propellant_kg"] = wet - simulation.state.mass
        return info
