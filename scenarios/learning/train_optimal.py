"""Distil descents of least propellant into the network of the law `neural-optimal`.

Reads the shards that `optimal_descents.py` solved: within every interval of constant thrust the
state is known exactly, so that states at a random time within each are shown anew in every epoch.
Shards are kept out to judge by, whole descents at a time.

    python scenarios/learning/train_optimal.py build/descents --out optimal.npz
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import time as clock
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from optimal_descents import PROBLEM, check_problem, problem_of, read_shard
from rich.console import Console

from lunarsim.console import plain_console
from lunarsim.errors import InputError, check_output
from lunarsim.onboard.guidance.neural_law import NeuralOptimalLaw
from lunarsim.onboard.guidance.optimal_network import (
    INPUTS,
    OUTPUTS,
    SHIPPED,
    OptimalNetwork,
    reduced,
)
from lunarsim.scenario import Scenario
from lunarsim.whole_files import write_text_whole

Array = NDArray[np.float64]

FAR = np.array([300.0, 300.0, 15.0, 5.0, 15.0, 1500.0])
NEAR = np.array([10.0, 10.0, 1.0, 0.5, 2.0, 1500.0])
SCALE = np.array([1.0, 1.0, 1.0, 20.0])
_BATCH = 4096
_BEYOND = 0.01  # share of the range of what was shown by which its bounds are wider
_LEAST_LEFT = 1.0  # states later than that are not shown, s: the law hands over before


@dataclass(frozen=True)
class Descents:
    """Nodes of k descents in N intervals; see `optimal_descents.solve`."""

    seen: Array
    done: Array
    duration: Array

    @classmethod
    def load(cls, files: list[Path]) -> Descents:
        """Read shards."""
        held = [read_shard(file) for file in files]
        counts = sorted({h["actions"].shape[1] for h in held})
        if len(counts) > 1:
            raise click.UsageError(
                f"shards in {files[0].parent} have {counts} intervals: leave those of one run there"
            )
        return cls(
            *(np.concatenate([h[n] for h in held]) for n in ("observations", "actions", "duration"))
        )

    def within(self, share: Array, gravity: float) -> tuple[Array, Array]:
        """Return what is shown (n, 6) and wanted (n, 4) at a share (k, N) of each interval."""
        step = (self.duration / self.done.shape[1])[:, None]
        t = (share * step)[..., None]
        state, push = self.seen[:, :-1], self.done
        move = push - [0.0, 0.0, gravity]
        r, v = state[..., :3], state[..., 3:6]
        mass = state[..., 6] + share * np.diff(self.seen[..., 6], axis=1)
        shown, axes = reduced(r + t * (v + 0.5 * t * move), v + t * move, mass)
        left = self.duration[:, None] - step * (np.arange(push.shape[1]) + share)
        turned = np.einsum("...ij,...j->...i", axes, push)
        # Without a speed across, either side is as good: none is wanted.
        turned[..., 1] = np.where(shown[..., 3] < 1e-6, 0.0, turned[..., 1])
        wanted = np.concatenate((turned, left[..., None]), axis=-1) / SCALE
        used = left.ravel() > _LEAST_LEFT
        return shown.reshape(-1, INPUTS)[used], wanted.reshape(-1, OUTPUTS)[used]


def trained(
    learnt: Descents, gravity: float, minutes: float, epochs: int, width: int, seed: int,
    console: Console,
) -> tuple[list[tuple[Array, Array]], int]:  # fmt: skip
    """Return weights and biases of the layers, and how many epochs it took."""
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    sizes = [2 * INPUTS, width, width, width, OUTPUTS]
    linear = [torch.nn.Linear(a, b) for a, b in itertools.pairwise(sizes)]
    model = torch.nn.Sequential(*[m for one in linear for m in (one, torch.nn.Tanh())][:-1])
    optimiser = torch.optim.Adam(model.parameters(), 2e-3)
    began = clock.monotonic()
    for epoch in range(epochs):
        shown, wanted = learnt.within(rng.random(learnt.done.shape[:2]), gravity)
        order = rng.permutation(len(shown))
        features = np.concatenate((shown / FAR, np.arcsinh(shown / NEAR)), axis=1)[order]
        x, y = (torch.from_numpy(np.float32(a)) for a in (features, wanted[order]))
        past = (clock.monotonic() - began) / (60.0 * minutes) if minutes else epoch / epochs
        for group in optimiser.param_groups:
            group["lr"] = 2e-3 * 0.5 * (1.0 + np.cos(np.pi * min(past, 1.0))) + 1e-6
        total = 0.0
        for first in range(0, len(x), _BATCH):
            off = model(x[first : first + _BATCH]) - y[first : first + _BATCH]
            loss = torch.nn.functional.huber_loss(off, torch.zeros_like(off), delta=0.2)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            total += float(loss.detach()) * len(off)
        if epoch % 10 == 0:
            console.print(f"epoch {epoch}: loss {total / len(x):.6f}")
        if past >= 1.0:
            break
    layers = [(m.weight.detach().double(), m.bias.detach().double()) for m in linear]
    return [(weight.numpy(), bias.numpy()) for weight, bias in layers], epoch + 1


def judged(network: OptimalNetwork, kept: Descents, gravity: float) -> dict[str, Any]:
    """Return errors on descents that were kept out, and what breaks the law's limits there."""
    shown, wanted = kept.within(np.full(kept.done.shape[:2], 0.5), gravity)
    told = network(shown)
    off = told - wanted * SCALE
    law, lander = NeuralOptimalLaw(), Scenario.from_dict({"name": "descents"}).vehicle.make()
    force = np.linalg.norm(told[:, :3], axis=1) * shown[:, 5]
    tilt = np.arctan2(np.hypot(told[:, 0], told[:, 1]), told[:, 2])
    beyond = np.maximum(force - lander.thrust_max, lander.thrust_min - force)
    broken = (beyond > law.thrust_slack * lander.thrust_max) | (
        tilt > network.problem[5] + law.tilt_slack
    )
    push = np.linalg.norm(off[:, :3], axis=1)
    return {
        "descents": len(kept.duration),
        "infeasible": float(np.mean(broken | (told[:, 3] <= 0.0))),
        "thrust_m_s2": [float(v) for v in np.percentile(push, (50, 95))],
        "time_to_go_s": [float(v) for v in np.percentile(np.abs(off[:, 3]), (50, 95))],
    }


def problem_figures() -> Array:
    """Return the figures of the problem that the descents solve; see `OptimalNetwork.problem`."""
    gap, velocity = np.array([100.0, 0.0, 100.0]), np.array([0.0, 0.0, -5.0])
    d = problem_of(gap, velocity, 1.0)
    return np.array(
        [
            d.gravity, d.thrust_min, d.thrust_max, d.exhaust_velocity, -d.end_velocity[2],
            d.max_tilt, d.glideslope,
        ]
    )  # fmt: skip


@click.command()
@click.argument("descents", type=click.Path(exists=True, path_type=Path, file_okay=False))
@click.option("--epochs", type=click.IntRange(min=1), default=100, show_default=True, help="Most.")
@click.option("--minutes", type=click.FloatRange(min=0.0), default=0.0, show_default=True,
              help="Most; 0: all epochs, and the same seed gives the same weights.")  # fmt: skip
@click.option("--width", type=click.IntRange(8, 256), default=96, show_default=True,
              help="Of three layers.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=SHIPPED,
              show_default="the one that comes along", help="Weights.")  # fmt: skip
@click.option("--json", "told", type=click.Path(path_type=Path, dir_okay=False), help="Figures.")
def main(
    descents: Path, epochs: int, minutes: float, width: int, seed: int, out: Path, told: Path | None
) -> None:
    """Train a network on the shards of a folder."""
    console = plain_console(110, soft_wrap=True)
    files = sorted((descents / "shards").glob("*.npz"))
    if len(files) < 2:
        raise click.UsageError(
            f"DESCENTS = '{descents}': two shards at least, of optimal_descents.py; one is kept out"
        )
    if (descents / "shards" / PROBLEM).exists():
        check_problem(descents / "shards", "solve them anew, or weights would be told for these")
    try:
        check_output("--out", out, ".npz")
        if told is not None:
            check_output("--json", told, ".json")
    except InputError as error:
        raise click.UsageError(str(error)) from None
    if importlib.util.find_spec("torch") is None:
        raise click.UsageError("torch is missing: the extra `rl` installs it")
    out_of = max(len(files) // 20, 1)
    learnt, kept = Descents.load(files[:-out_of]), Descents.load(files[-out_of:])
    gravity = Scenario.from_dict({"name": "descents"}).gravity_m_s2
    layers, done = trained(learnt, gravity, minutes, epochs, width, seed, console)
    shown, _ = learnt.within(np.zeros(learnt.done.shape[:2]), gravity)
    low, high = shown.min(axis=0), shown.max(axis=0)
    beyond = _BEYOND * (high - low)  # a start with full tanks is at an edge
    network = OptimalNetwork(
        FAR, NEAR, low - beyond, high + beyond, SCALE,
        tuple(w for w, _ in layers), tuple(b for _, b in layers), problem_figures(),
    )  # fmt: skip
    network.save(out)
    figures = judged(OptimalNetwork.load(out), kept, gravity)
    figures |= {
        "learnt": len(learnt.duration), "shards": len(files), "epochs": done,
        "bytes": out.stat().st_size, "seed": seed,
    }  # fmt: skip
    console.print(json.dumps(figures))
    if told is not None:
        write_text_whole(told, json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
