"""Train the guidance law `neural-optimal` on minimum-propellant descents.

The input is the files (shards) of solved descents of `optimal_descents.py`. Within each
constant-thrust interval the state is known exactly, so every epoch uses new states at a random time
within each interval. Complete shards are held out for validation.

    python scenarios/learning/train_optimal.py build/descents --out optimal.npz
"""

from __future__ import annotations

import itertools
import json
import time as clock
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from optimal_descents import PROBLEM, check_limits, problem_of, read_shard
from rich.console import Console

from lunarsim import InputError, Scenario
from lunarsim.atomic_files import atomic_write_text
from lunarsim.console import plain_console
from lunarsim.errors import check_output
from lunarsim.onboard.guidance.neural_law import NeuralOptimalLaw
from lunarsim.onboard.guidance.optimal_network import (
    DEFAULT_NETWORK_PATH,
    INPUTS,
    OUTPUTS,
    OptimalNetwork,
    reduce_state,
)
from lunarsim_envs.training.optional_packages import imports_of_extra

Array = NDArray[np.float64]

WIDE_SCALE = np.array([300.0, 300.0, 15.0, 5.0, 15.0, 1500.0])
FINE_SCALE = np.array([10.0, 10.0, 1.0, 0.5, 2.0, 1500.0])
OUTPUT_SCALE = np.array([1.0, 1.0, 1.0, 20.0])
_BATCH = 4096
_BOUND_MARGIN = 0.01  # extension of the input bounds, as a fraction of the training range
_MIN_TIME_TO_GO_S = 1.0  # minimum time to go of training states, s: below it another law takes over


@dataclass(frozen=True)
class DescentNodes:
    """States and thrusts of k minimum-propellant descents with N intervals each.

    `nodes` (k, N + 1, 7) are position (m), velocity (m/s) and mass (kg) at the ends of the
    intervals, `thrust_per_mass` (k, N, 3) is in m/s^2 and `duration` (k,) in s.
    """

    nodes: Array
    thrust_per_mass: Array
    duration: Array

    @classmethod
    def load(cls, files: list[Path]) -> DescentNodes:
        """Read files (shards) of `optimal_descents.py`; concatenate their descents."""
        held = [read_shard(file) for file in files]
        counts = sorted({h["actions"].shape[1] for h in held})
        if len(counts) > 1:
            raise click.UsageError(
                f"The shards in {files[0].parent} have different numbers of intervals: "
                f"{', '.join(map(str, counts))}. Keep the shards of one run only."
            )
        return cls(
            *(np.concatenate([h[n] for h in held]) for n in ("observations", "actions", "duration"))
        )

    def sample_intervals(self, elapsed_fraction: Array, gravity: float) -> tuple[Array, Array]:
        """Return network inputs (n, 6) and targets (n, 4) at one time in each interval.

        The time is given by `elapsed_fraction` (k, N) of each interval; `gravity` is in m/s^2.
        States near the end of the descent are omitted.
        """
        step = (self.duration / self.thrust_per_mass.shape[1])[:, None]
        t = (elapsed_fraction * step)[..., None]
        state, push = self.nodes[:, :-1], self.thrust_per_mass
        move = push - [0.0, 0.0, gravity]
        r, v = state[..., :3], state[..., 3:6]
        mass = state[..., 6] + elapsed_fraction * np.diff(self.nodes[..., 6], axis=1)
        shown, axes = reduce_state(r + t * (v + 0.5 * t * move), v + t * move, mass)
        left = self.duration[:, None] - step * (np.arange(push.shape[1]) + elapsed_fraction)
        turned = np.einsum("...ij,...j->...i", axes, push)
        # Without a cross speed, both sides are equivalent; the target is zero.
        turned[..., 1] = np.where(shown[..., 3] < 1e-6, 0.0, turned[..., 1])
        wanted = np.concatenate((turned, left[..., None]), axis=-1) / OUTPUT_SCALE
        used = left.ravel() > _MIN_TIME_TO_GO_S
        return shown.reshape(-1, INPUTS)[used], wanted.reshape(-1, OUTPUTS)[used]


def train_network(
    training: DescentNodes, gravity: float, minutes: float, epochs: int, width: int, seed: int,
    console: Console,
) -> tuple[list[tuple[Array, Array]], int]:  # fmt: skip
    """Train the network on descents; return its layers and the number of epochs.

    `gravity` is in m/s^2, `minutes` the time limit (0: none), `epochs` the maximum number of epochs
    and `width` the width of the hidden layers. The layers are pairs of weights and biases.
    """
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
        fractions = rng.random(training.thrust_per_mass.shape[:2])
        shown, wanted = training.sample_intervals(fractions, gravity)
        order = rng.permutation(len(shown))
        features = np.concatenate((shown / WIDE_SCALE, np.arcsinh(shown / FINE_SCALE)), axis=1)[
            order
        ]
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


def evaluate_network(
    network: OptimalNetwork, held_out: DescentNodes, gravity: float
) -> dict[str, Any]:
    """Return errors and infeasible fraction of a network on held-out descents.

    `gravity` is in m/s^2. Errors are the median and 95th percentile of
    thrust over mass (m/s^2) and time to go (s).
    """
    shown, wanted = held_out.sample_intervals(
        np.full(held_out.thrust_per_mass.shape[:2], 0.5), gravity
    )
    outputs = network(shown)
    off = outputs - wanted * OUTPUT_SCALE
    law, lander = NeuralOptimalLaw(), Scenario.from_dict({"name": "descents"}).vehicle.make()
    force = np.linalg.norm(outputs[:, :3], axis=1) * shown[:, 5]
    tilt = np.arctan2(np.hypot(outputs[:, 0], outputs[:, 1]), outputs[:, 2])
    beyond = np.maximum(force - lander.thrust_max, lander.thrust_min - force)
    broken = (beyond > law.thrust_tolerance * lander.thrust_max) | (
        tilt > network.problem[5] + law.tilt_tolerance
    )
    push = np.linalg.norm(off[:, :3], axis=1)
    return {
        "descents": len(held_out.duration),
        "infeasible": float(np.mean(broken | (outputs[:, 3] <= 0.0))),
        "thrust_m_s2": [float(v) for v in np.percentile(push, (50, 95))],
        "time_to_go_s": [float(v) for v in np.percentile(np.abs(off[:, 3]), (50, 95))],
    }


def problem_parameters() -> Array:
    """Return the parameters of the descent problem that the network is valid for (7,).

    They are gravity (m/s^2), minimum and maximum thrust (N), exhaust velocity and final descent
    rate (m/s), maximum tilt and glideslope (rad).
    """
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
@click.option(
    "--epochs",
    type=click.IntRange(min=1),
    default=100,
    show_default=True,
    help="Maximum number of training epochs.",
)
@click.option("--minutes", type=click.FloatRange(min=0.0), default=0.0, show_default=True,
              help="Time limit of the training (min); 0: no limit, so that the weights are "
              "reproducible.")  # fmt: skip
@click.option("--width", type=click.IntRange(8, 256), default=96, show_default=True,
              help="Number of neurons in each of the three hidden layers.")  # fmt: skip
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False),
default=DEFAULT_NETWORK_PATH,
              show_default="the file supplied with lunarsim",
              help="File for the weights of the network (.npz).")  # fmt: skip
@click.option(
    "--json",
    "metrics",
    type=click.Path(path_type=Path, dir_okay=False),
    help="JSON file for the metrics. Default: none.",
)
def main(
    descents: Path,
    epochs: int,
    minutes: float,
    width: int,
    seed: int,
    out: Path,
    metrics: Path | None,
) -> None:
    """Train the network on the shards in the folder DESCENTS."""
    console = plain_console(110, soft_wrap=True)
    files = sorted((descents / "shards").glob("*.npz"))
    if len(files) < 2:
        raise click.UsageError(
            f"DESCENTS: must contain two or more shards of optimal_descents.py, got '{descents}'"
        )
    if (descents / "shards" / PROBLEM).exists():
        check_limits(descents / "shards", "Solve the descents again.")
    try:
        check_output("--out", out, ".npz")
        if metrics is not None:
            check_output("--json", metrics, ".json")
    except InputError as error:
        raise click.UsageError(str(error)) from None
    with imports_of_extra("rl"):
        import torch  # noqa: F401  (checked before the descents are read)
    out_of = max(len(files) // 20, 1)
    learnt, kept = DescentNodes.load(files[:-out_of]), DescentNodes.load(files[-out_of:])
    gravity = Scenario.from_dict({"name": "descents"}).gravity_m_s2
    layers, done = train_network(learnt, gravity, minutes, epochs, width, seed, console)
    shown, _ = learnt.sample_intervals(np.zeros(learnt.thrust_per_mass.shape[:2]), gravity)
    low, high = shown.min(axis=0), shown.max(axis=0)
    beyond = _BOUND_MARGIN * (high - low)  # a start with full tanks lies on the bound
    network = OptimalNetwork(
        WIDE_SCALE, FINE_SCALE, low - beyond, high + beyond, OUTPUT_SCALE,
        tuple(w for w, _ in layers), tuple(b for _, b in layers), problem_parameters(),
    )  # fmt: skip
    network.save(out)
    figures = evaluate_network(OptimalNetwork.load(out), kept, gravity)
    figures |= {
        "learnt": len(learnt.duration), "shards": len(files), "epochs": done,
        "bytes": out.stat().st_size, "seed": seed,
    }  # fmt: skip
    console.print(json.dumps(figures))
    if metrics is not None:
        atomic_write_text(metrics, json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
