"""Scripts that train agents: trainings of a few thousand steps, and missing packages."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys

import pytest

from tests.conftest import ROOT, SCENARIOS

FOLDER = SCENARIOS / "learning"
NO_EXTRA = "the extra `rl` is not installed"


@pytest.mark.parametrize(
    ("script", "package", "arguments"),
    [
        ("single_file_ppo", "onnxscript", ["--help"]),
        ("masked_ppo", "torch", ["--help"]),
        ("minimal_ppo", "torch", ["1"]),
        ("train_descents", "torch", ["--out", "agents", "--steps", "1"]),
        ("learning_curves", "sb3_contrib", ["--seeds", "1", "--steps", "1"]),
    ],
)  # fmt: skip
def test_a_missing_package_is_reported_in_one_line(
    script, package, arguments, monkeypatch, capsys, tmp_path
):
    error = f'raise ModuleNotFoundError("not installed", name="{package}")'
    (tmp_path / f"{package}.py").write_text(error, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("sys.argv", [f"{script}.py", *arguments])
    for imported in (package, "lunarsim_envs.training.descents"):
        monkeypatch.delitem(sys.modules, imported, raising=False)
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(FOLDER / f"{script}.py"), run_name="__main__")
    assert end.value.code == 2
    message = capsys.readouterr().err.strip()
    assert message.count(script) and f"needs the package {package}, which is not" in message
    assert "Install the extra `rl`" in message and "Traceback" not in message
    assert not (tmp_path / "agents").exists()


def _train(script, out, *arguments):
    """Run a training as a command; return its output."""
    command = [sys.executable, str(FOLDER / script), "--out", str(out), *arguments]
    done = subprocess.run(command, cwd=out.parent, check=True, capture_output=True, text=True)
    assert done.stdout.endswith(f"written: {out}\n")
    return done.stdout


def _fly(environment, agent, *arguments):
    """Fly 20 episodes of an agent as a command; return its metrics."""
    out = agent.parent / "flights"
    command = [sys.executable, "-m", "lunarsim", "evaluate", environment, "--agent", str(agent)]
    subprocess.run(
        [*command, "--episodes", "20", "--out", str(out), *arguments],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    return json.loads((out / "summary.json").read_text(encoding="utf-8"))["agents"][0]


def test_advantages_are_discounted_sums_of_errors_up_to_the_end_of_the_episode(script):
    """Each error weighs GAMMA * LAMBDA per step; no error after an end counts."""
    for package in ("onnxscript", "torch"):
        pytest.importorskip(package, reason=NO_EXTRA)
    import torch

    ppo = script("learning", "single_file_ppo")
    rewards, values = torch.randn(12, 3), torch.randn(13, 3)
    ends = torch.zeros(12, 3)
    ends[4, 0] = ends[11, 1] = ends[0, 2] = ends[1, 2] = 1.0
    found = ppo.advantages(rewards, values, ends)
    for lane in range(3):
        for first in range(12):
            wanted, weight = 0.0, 1.0
            for n in range(first, 12):
                later = 0.0 if ends[n, lane] else values[n + 1, lane]
                wanted += weight * (rewards[n, lane] + ppo.GAMMA * later - values[n, lane])
                if ends[n, lane]:
                    break
                weight *= ppo.GAMMA * ppo.LAMBDA
            assert float(found[first, lane]) == pytest.approx(float(wanted), abs=1e-5)


@pytest.mark.slow
def test_the_agent_of_the_training_in_one_file_flies(tmp_path):
    for package in ("onnxscript", "torch"):
        pytest.importorskip(package, reason=NO_EXTRA)
    pytest.importorskip("onnxruntime", reason="the extra `onnx` is not installed")
    sizes = ["--lanes", "64", "--horizon", "8", "--batch", "128", "--steps", "10240"]
    printed = _train("single_file_ppo.py", tmp_path / "ppo.onnx", *sizes)
    assert "10240 steps, " in printed and "safe in the last 500 flights" in printed
    metrics = _fly("Guidance-v1", tmp_path / "ppo.onnx")
    assert (metrics["name"], metrics["episodes"]) == ("ppo", 20)
    assert metrics["score"]["value"] > -13.0  # a flight without touchdown has -15


@pytest.mark.slow
def test_the_agent_of_the_training_with_masks_flies(tmp_path):
    pytest.importorskip("sb3_contrib", reason=NO_EXTRA)
    printed = _train("masked_ppo.py", tmp_path / "masked.npz", "--steps", "8192")
    assert "split validation: safe" in printed and "split test: safe" in printed
    metrics = _fly("Retarget-v1", tmp_path / "masked.npz", "--scenario", "few_sites")
    assert (metrics["name"], metrics["episodes"]) == ("masked", 20)
    assert metrics["safe"]["count"] >= 6  # 14 at the time of writing
