"""`lunarsim evaluate`: rows, figures of agents, differences on the same episodes, files."""

from __future__ import annotations

import json
import platform
import shlex
import sys
import types
from dataclasses import replace

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from gymnasium import spaces

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.evaluation.statistics import Proportion
from lunarsim_envs.evaluation.episodes import fly_episodes
from lunarsim_envs.evaluation.parallel import fly
from lunarsim_envs.evaluation.request import evaluation_study
from lunarsim_envs.evaluation.results import add_on_target, agent_metrics, differences
from lunarsim_envs.evaluation.tables import agents_table
from tests.envs.site_scene import SMALL
from tests.low_descents import LOW

SETS = [f"{key}={value}" for key, value in LOW.items()]


class Wanted(gymnasium.Env):
    """Three steps that reward the action; told at the end what an environment may tell."""

    observation_space = spaces.Box(-1.0, 1.0, (1,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left, self.luck = 3, float(self.np_random.random())
        return np.array([self.luck], np.float32), {}

    def step(self, action):
        if action.shape != (1,):
            raise ValueError("an action of another shape")
        self.left -= 1
        terms = {"luck": self.luck, "shaping": 10.0}
        info = {"reward_terms": terms, "action_mask": np.ones(2)}
        if not self.left:
            info |= {
                "safe": self.luck > 0.5,
                "miss_m": 20.0 * self.luck,
                "failure_causes": ("a", "b"),
            }
            info["propellant_kg"] = np.float32(2.0)
        return np.zeros(1, np.float32), sum(terms.values()), self.left == 0, False, info


gymnasium.register(id="tests/Wanted-v0", entry_point=Wanted)


def wide(observation, info):
    return np.zeros(2)


def asked(seed=1):
    return evaluation_study("tests/Wanted-v0", None, (), seed)


def test_rows_report_what_came_of_every_episode():
    rows = fly(asked(), ["zero", "random"], 12, jobs=1)
    assert [(r["agent"], r["episode"]) for r in rows] == [
        (a, e) for a in ("zero", "random") for e in range(12)
    ]
    for zero, other in zip(rows[:12], rows[12:], strict=True):
        assert zero["miss_m"] == other["miss_m"]  # the same luck, whoever flies
    for row in rows:
        luck = row["miss_m"] / 20.0
        assert row["return"] == pytest.approx(3.0 * (luck + 10.0))
        assert row["score"] == pytest.approx(3.0 * luck)
        assert row["reward_luck"] == pytest.approx(3.0 * luck)
        assert row["safe"] is (luck > 0.5) and row["failure_causes"] == "a, b" and row["steps"] == 3
        assert row["late"] is False and "action_mask" not in row
    assert len({row["miss_m"] for row in rows}) == 12
    again = list(fly_episodes(asked(), "random", range(5, 7)))
    assert again == rows[17:19]  # of no other episode
    assert fly(asked(2), ["zero"], 2, jobs=1)[0]["miss_m"] != rows[0]["miss_m"]


def test_progress_is_reported_for_every_episode():
    told = []
    fly(asked(), ["zero", "random"], 3, 1, told.append)
    assert sum(told) == 6


def test_an_action_that_does_not_fit_is_the_agents_mistake():
    with pytest.raises(InputError, match="must return valid actions"):
        list(fly_episodes(asked(), "tests.envs.test_evaluation:wide", range(1)))


def rows_of(agent, safe, burnt, score, miss=1.0):
    return [
        {"agent": agent, "episode": i, "score": x, "steps": 5, "safe": bool(s), "miss_m": miss,
         "propellant_kg": p}
        for i, (s, p, x) in enumerate(zip(safe, burnt, score, strict=True))
    ]  # fmt: skip


def test_figures_count_what_landed():
    rows = rows_of("a", [1, 1, 1, 0], [10.0, 12.0, 14.0, 90.0], [1.0, 2.0, 3.0, -6.0])
    rows = add_on_target([row | {"miss_m": 5.0 * k} for k, row in enumerate(rows)], 5.0)
    (told,) = agent_metrics(rows, 1)
    assert told.safe == Proportion(3, 4) and told.on_target == Proportion(2, 4)
    assert told.propellant.value == 12.0 and told.miss.value == 5.0  # of the safe alone
    assert told.score.value == 0.0 and told.score.low < 0.0 < told.score.high
    (blank,) = agent_metrics([{"agent": "b", "episode": 0, "score": 1.0, "steps": 2}], 1)
    assert blank.safe is None and blank.on_target is None
    assert blank.propellant.text(1) == "-" and blank.score.text(1) == "1.0"


def test_differences_are_of_the_same_episodes():
    rng = np.random.default_rng(0)
    luck = rng.normal(size=40)
    first = rows_of("a", luck < 0.5, 50.0 + luck, luck)
    more = 0.01 * rng.normal(size=40)
    second = rows_of("b", luck < 1.5, 47.0 + luck + more, luck + 0.25 + more)
    found = differences([*first, *second], 1)
    (score,), (safe,), (burnt,) = (found[m] for m in ("score", "safe", "propellant_kg"))
    assert (score.first, score.second, score.pairs) == ("a", "b", 40)
    assert score.value == pytest.approx(0.25 + more.mean())
    assert score.low < score.value < score.high < score.low + 0.02  # the luck is shared
    assert safe.value == pytest.approx(((luck >= 0.5) & (luck < 1.5)).mean())
    assert burnt.pairs == int((luck < 0.5).sum()) and burnt.value == pytest.approx(
        -3.0 + more[luck < 0.5].mean()
    )


def test_the_command_writes_what_it_prints(tmp_path, monkeypatch):
    told = []
    for name in ("one", "two"):
        words = ["evaluate", "Guidance-v1", "--agent", "zero", "--agent", "polynomial"]
        for value in SETS:
            words += ["--set", value]
        words += ["--episodes", "4", "--jobs", "1", "--within", "30", "--out", str(tmp_path / name)]
        monkeypatch.setattr(sys, "argv", ["/bin/lunarsim", *words])
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 0, done.output
        told.append(done.stdout)
    table = pq.read_table(tmp_path / "one" / "results.parquet")
    assert table.num_rows == 8
    assert {"agent", "episode", "score", "safe", "on_target", "reward_touchdown"} <= set(
        table.column_names
    )
    one, two = ((tmp_path / name / "results.parquet").read_bytes() for name in ("one", "two"))
    assert one == two and told[0].replace("/one", "") == told[1].replace("/two", "")
    summary = json.loads((tmp_path / "one" / "summary.json").read_text())
    assert summary["env"] == "lunarsim/Guidance-v1" and summary["within_m"] == 30.0
    safe = sum(table["safe"].to_pylist()[4:])
    assert summary["agents"][1]["safe"] == {"count": safe, "total": 4}
    assert str(Proportion(safe, 4)) in told[0]
    assert "Safe within 30 m" in told[0] and "polynomial - zero" in told[0]
    assert (tmp_path / "one" / "scenario.toml").exists()
    assert summary["environment"]["python"] == platform.python_version()
    command = shlex.split(summary["command"])
    assert command == ["lunarsim", *words[:-1], str(tmp_path / "one")]


def test_columns_without_values_are_omitted():
    rows = fly(asked(), ["zero"], 4, jobs=1)
    headings = [column.header for column in agents_table(agent_metrics(rows, 1), 10.0).columns]
    assert not any("Safe within" in heading for heading in headings)
    rows = add_on_target(rows, 10.0)
    headings = [column.header for column in agents_table(agent_metrics(rows, 1), 10.0).columns]
    assert "Safe within 10 m" in headings


def test_an_environment_of_the_working_directory_is_found(tmp_path, monkeypatch):
    """Like agents: an installed command does not search the working directory."""
    (tmp_path / "found_beside.py").write_text(
        "import gymnasium\nfrom tests.envs.test_evaluation import Wanted\n"
        "gymnasium.register(id='beside/Wanted-v0', entry_point=Wanted)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(tmp_path)])
    study = evaluation_study("found_beside:beside/Wanted-v0", None, (), 1)
    assert len(fly(study, ["zero"], 2, jobs=1)) == 2


def test_a_scenario_is_required_if_an_environment_has_none():
    with pytest.raises(InputError, match="needs --scenario"):
        evaluation_study("tests/Wanted-v0", None, ["rocks.cover=0.1"], 1)


def test_agents_are_flown_on_the_perception_that_is_asked_for():
    given = evaluation_study("lunarsim_envs:Retarget-v1", None, [], 1, perception="truth")
    assert given.arguments == {"split": "test", "worlds": 16, "perception": "truth"}
    alone = evaluation_study("lunarsim_envs:Retarget-v1", None, [], 1)
    assert alone.arguments == {"split": "test", "worlds": 16}
    small = replace(given, scenario=SMALL, arguments=given.arguments | {"worlds": 1})
    assert small.make().unwrapped.perception == "truth"


def test_agents_are_shown_the_parts_that_are_asked_for():
    given = evaluation_study(
        "lunarsim_envs:Guidance-v1", None, [], 1, observation=["velocity", "rate"]
    )
    assert given.make().observation_space.shape == (12,)  # scaled in two ways
    with pytest.raises(InputError, match="does not apply to"):
        evaluation_study("tests/Wanted-v0", None, [], 1, observation=["velocity"])
    words = ["evaluate", "Guidance-v1", "--agent", "apollo", "--episodes", "1", "--jobs", "1"]
    done = CliRunner().invoke(main, [*words, "--observation", "velocity"])
    assert done.exit_code == 2 and "observation component 'position'" in done.output
    done = CliRunner().invoke(main, [*words, "--observation", "velocty"])
    assert done.exit_code == 2 and "Did you mean 'velocity'" in done.output


def test_one_episode_has_a_difference_without_an_interval():
    words = ["evaluate", "Guidance-v1", "--agent", "zero", "--agent", "polynomial"]
    for value in SETS:
        words += ["--set", value]
    done = CliRunner().invoke(main, [*words, "--episodes", "1", "--jobs", "1"])
    assert done.exit_code == 0 and "nan" not in done.output


@pytest.mark.slow
def test_any_number_of_processes_gives_the_same_rows():
    given = evaluation_study("lunarsim_envs:Guidance-v1", None, SETS, 3)
    agents = ["random", "polynomial"]
    assert fly(given, agents, 15, jobs=2) == fly(given, agents, 15, jobs=1)


def test_names_of_a_notebook_are_refused_before_processes_start(monkeypatch):
    monkeypatch.setitem(sys.modules, "__main__", types.ModuleType("__main__"))
    with pytest.raises(
        InputError,
        match=r"^--agent: uses Mine, which worker processes cannot import from a notebook",
    ):
        fly(asked(), ["__main__:Mine"], 11, jobs=2)
    monkeypatch.setattr(Wanted, "__module__", "__main__")
    with pytest.raises(InputError, match=r"^env: uses Wanted, .* or use jobs = 1"):
        fly(asked(), ["zero"], 11, jobs=2)
    assert len(fly(asked(), ["zero"], 11, jobs=1)) == 11
