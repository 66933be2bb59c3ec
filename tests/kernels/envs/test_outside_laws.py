"""A guidance law from outside the package: in the simulation, an environment, and 4,096 lanes."""

from __future__ import annotations

import re
import sys
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import lunarsim
from lunarsim.errors import InputError
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim_envs.sites import _flight_kernels as f
from tests.envs.site_scene import SMALL, lanes, made_up
from tests.worlds import ROOT

PAGE = ROOT / "docs" / "howto" / "custom-parts.md"


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    folder = tmp_path_factory.mktemp("law")
    (code,) = re.findall(r"```python\n# stiff_law.py\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    (folder / "stiff_law.py").write_text(code)
    sys.path.append(str(folder))
    lunarsim.allow_modules("stiff_law")
    yield SMALL.changed(guidance={"kind": "stiff_law:StiffLaw", "gain": 6.5})
    sys.path.remove(str(folder))


def test_lanes_command_what_the_onboard_computer_commands(scenario):
    many = lanes(1, scenario=scenario, perception="truth")
    briefing = SimpleNamespace(surface_gravity=scenario.gravity_m_s2, nonuniform_gravity=None)
    law = scenario.guidance.make().build(briefing, many.law.lag)
    y, state, command = many.y[0], np.empty((2, 3)), np.empty(3)
    own = many.guidance._replace(
        **{name: getattr(many.guidance, name).copy() for name in many.guidance._fields}
    )
    own.response[0, 6], own.path[0, 0] = np.nan, np.nan
    approach, lander = scenario.approach.make(), many.craft.dynamics.lander
    for n in range(20):
        time = many.time[0] + 0.1 * n
        f.compute_command(0, y, time, own, many.law, command, np.empty((7, 3)))
        f.estimate_state(y, own.drift_velocity[0], time, state)
        estimate = Estimate(time, *state, y[6:10], y[10:13], y[13], np.zeros((9, 9)))
        end = approach.end(own.site[0], lander)
        expected = law.command(estimate, end, time, own.arrival[0] - time)
        assert command == pytest.approx(expected, rel=1e-12, abs=1e-12)
        y[:3] += 0.1 * y[3:6]


def test_4096_lanes_fly_the_law_without_compiling_again(scenario):
    lanes(2, perception="truth").decide(np.full((2, 3), np.nan), np.ones(2, bool))
    compiled = len(f.fly.compiled.signatures)
    many = lanes(4096, keys=range(4096), scenario=scenario, perception="truth")
    apollo = lanes(4096, keys=range(4096), perception="truth")
    for batch in (many, apollo):
        for _ in range(2):
            batch.decide(np.full((4096, 3), np.nan), np.ones(4096, bool))
    assert len(f.fly.compiled.signatures) == compiled
    assert np.isfinite(many.y).all()
    assert np.abs(many.y[:, :3] - apollo.y[:, :3]).max() > 0.1


def test_simulation_and_single_environments_fly_the_law(scenario):
    flight = lunarsim.fly(scenario.changed(mappers={}, tasking={}), policy="no-divert", seed=1)
    assert flight.outcome.touchdown.vertical_speed < 3.0
    env = gymnasium.make(
        "lunarsim_envs:lunarsim/Retarget-v1", scenario=scenario, perception="surrogate", worlds=2,
        world_seed=5, surrogate=made_up(scenario),
    )  # fmt: skip
    _, info = env.reset(seed=3)
    ended = False
    while not ended:
        _, _, ended, _, info = env.step(int(np.flatnonzero(info["action_mask"])[0]))
    assert 10.0 < info["propellant_kg"] < 150.0
    assert not {"vertical-speed", "horizontal-speed", "tilt"} & set(info["failure_causes"])


def test_a_law_with_its_own_build_is_refused_by_batches(scenario, tmp_path, monkeypatch):
    (tmp_path / "own_build.py").write_text(
        "from stiff_law import StiffLaw\n\n\nclass Own(StiffLaw):\n"
        "    def build(self, briefing, lag):\n        return super().build(briefing, lag)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    lunarsim.allow_modules("own_build")
    with pytest.raises(InputError, match=r"guidance\.kind: must be a law with paths of one shape"):
        lanes(1, scenario=SMALL.changed(guidance={"kind": "own_build:Own"}), perception="truth")
