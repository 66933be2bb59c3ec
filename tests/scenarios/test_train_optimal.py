"""Training of a network on minimum-propellant descents."""

from __future__ import annotations

import json
import sys

import click
import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.onboard.guidance.optimal_network import OptimalNetwork
from tests.conftest import SCENARIOS

# Documented values of the shipped weights.
FIGURES = SCENARIOS.parent / "docs" / "results" / "learning" / "neural_optimal.json"


@pytest.fixture
def study(script):
    return script("learning", "train_optimal")


@pytest.fixture
def shards(script, tmp_path):
    """Write two shards of three descents."""
    descents = script("learning", "optimal_descents")
    folder = tmp_path / "set" / "shards"
    folder.mkdir(parents=True)
    for k in range(2):
        np.savez(
            folder / f"{k}.npz", **descents.solve_shard(descents.DescentShardTask(k, 3, 5, 12))
        )
    return tmp_path / "set"


def test_states_between_nodes_lie_on_the_descent(study, shards):
    descents = study.DescentNodes.load(sorted((shards / "shards").glob("*.npz")))
    gravity = study.problem_parameters()[0]
    start, wanted = descents.sample_intervals(np.zeros(descents.thrust_per_mass.shape[:2]), gravity)
    late = np.full(descents.thrust_per_mass.shape[:2], 1.0 - 1e-9)
    end, _ = descents.sample_intervals(late, gravity)
    first = descents.nodes[0]
    assert start[0, 0] == pytest.approx(np.hypot(*first[0, :2]))
    assert end[0, 0] == pytest.approx(np.hypot(*first[1, :2]), rel=1e-6)
    assert end[0, [1, 4, 5]] == pytest.approx(first[1, [2, 5, 6]], rel=1e-6)
    thrust = np.linalg.norm(descents.thrust_per_mass[0, 0])
    assert np.linalg.norm(wanted[0, :3]) == pytest.approx(thrust)
    assert wanted[0, 3] * 20.0 == pytest.approx(descents.duration[0])


def test_missing_extra_and_too_few_shards_are_reported(study, shards, tmp_path, monkeypatch):
    done = CliRunner().invoke(study.main, [str(tmp_path), "--out", str(tmp_path / "w.npz")])
    assert done.exit_code == 2
    assert "two or more shards" in done.output
    (tmp_path / "torch.py").write_text('raise ModuleNotFoundError("", name="torch")')
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    done = CliRunner().invoke(study.main, [str(shards), "--out", str(tmp_path / "w.npz")])
    assert done.exit_code == 2
    assert "needs the package torch, which is not installed" in done.output
    assert not (tmp_path / "w.npz").exists()


def test_incomplete_shard_is_reported(study, shards):
    files = sorted((shards / "shards").glob("*.npz"))
    files[0].write_bytes(files[0].read_bytes()[:500])
    with pytest.raises(click.UsageError, match="is not a complete shard"):
        study.DescentNodes.load(files)


def test_the_same_seed_gives_the_same_weights(study, shards, tmp_path):
    pytest.importorskip("torch")
    nets = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}.npz"
        told = tmp_path / f"{name}.json"
        given = [str(shards), "--epochs", "2", "--width", "8", "--out", str(path)]
        given += ["--json", str(told)]
        done = CliRunner().invoke(study.main, given)
        assert done.exit_code == 0, done.output
        nets.append(OptimalNetwork.load(path))
        figures = json.loads(told.read_text())
        assert figures.keys() == json.loads(FIGURES.read_text()).keys()
        assert (figures["shards"], figures["epochs"]) == (2, 2)
    for a, b in zip(nets[0].weights, nets[1].weights, strict=True):
        assert np.array_equal(a, b)
    assert np.array_equal(nets[0].problem, study.problem_parameters())


def test_shards_of_several_runs_are_rejected(study, script, shards):
    descents = script("learning", "optimal_descents")
    other = shards / "shards" / "other.npz"
    np.savez(other, **descents.solve_shard(descents.DescentShardTask(0, 3, 5, 10)))
    with pytest.raises(click.UsageError, match="numbers of intervals: 10, 12"):
        study.DescentNodes.load(sorted((shards / "shards").glob("*.npz")))


@pytest.mark.parametrize(
    ("text", "why"), [('{"max_tilt": 0.1}', "other limits"), ("{", "not a valid file of limits")]
)
def test_shards_of_another_problem_are_rejected(study, shards, text, why):
    """The weights store the problem of the current limits."""
    (shards / "shards" / "problem.json").write_text(text)
    done = CliRunner().invoke(study.main, [str(shards), "--out", str(shards / "w.npz")])
    assert done.exit_code == 2
    assert why in " ".join(done.output.split())


@pytest.mark.parametrize("given", [("--out", "none/w.npz"), ("--json", "none/w.json")])
def test_invalid_output_is_rejected_before_training(study, shards, tmp_path, given):
    options = {"--out": str(tmp_path / "w.npz"), given[0]: str(tmp_path / given[1])}
    told = [text for pair in options.items() for text in pair]
    done = CliRunner().invoke(study.main, [str(shards), *told])
    assert done.exit_code == 2
    assert "an existing folder" in " ".join(done.output.split())
