"""Compare p_safe of the Gaussian DEM with a small neural network on the same evidence.

The network has two hidden layers and the features of the calibrated probability, without its
constraints: it may use each feature with any sign. It is fitted with the log loss to the sites of
the calibration study, once to all scenes and once without each relief, rock law, lander and range.
The result is a bound from below for what a map can claim from this evidence.

python scenarios/lidar_maps/network.py --scenes 1000 --sites 1000 --jobs 2

It needs the extra `rl` (PyTorch).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import click
import numpy as np
from calibration import AXES, PooledSites, evaluate_scene, predict_safety, sample_scenes
from rich.table import Table
from scene_cache import SceneSites, load_or_evaluate
from scipy.special import expit

from lunarsim.console import plain_console
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim_envs.training.optional_packages import imports_of_extra

with imports_of_extra("rl"):
    import torch
    from torch import nn

UNITS, EPOCHS, BATCH, RATE = 64, 5, 2048, 5e-3
# Divisors of the odds that a site is safe.
MARGINS = (1, 4, 16)
# Worlds with fewer claims are not counted.
MIN_CLAIMS = 100
CLAIMS = (0.95, 0.99)

Predictor = Callable[[np.ndarray], np.ndarray]


def fit_network(x: np.ndarray, safe: np.ndarray, seed: int = 0) -> Predictor:
    """Fit a network to features (n, f) and the true safety (n,); return its log odds."""
    torch.manual_seed(seed)
    middle, scale = x.mean(axis=0), x.std(axis=0) + 1e-3

    def tensor(features: np.ndarray) -> torch.Tensor:
        return torch.tensor((features - middle) / scale, dtype=torch.float32)

    model = nn.Sequential(
        nn.Linear(x.shape[1], UNITS), nn.SiLU(), nn.Linear(UNITS, UNITS), nn.SiLU(),
        nn.Linear(UNITS, 1),
    )  # fmt: skip
    inputs, wanted = tensor(x), torch.tensor(safe, dtype=torch.float32)
    steps = EPOCHS * (len(x) // BATCH)
    optimiser = torch.optim.AdamW(model.parameters(), weight_decay=1e-3)
    rates = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps + 1)
    order = torch.Generator().manual_seed(seed)
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(x), generator=order)[: steps // EPOCHS * BATCH].split(BATCH):
            odds = model(inputs[rows])[:, 0]
            loss = nn.functional.binary_cross_entropy_with_logits(odds, wanted[rows])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            rates.step()

    def predict(features: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(model(tensor(features))[:, 0], dtype=np.float64)

    return predict


def scenes_of(scenes: list[SceneSites]) -> np.ndarray:
    """Return the number of the scene of each site (n,)."""
    return np.repeat(np.arange(len(scenes)), [len(j.safe) for j in scenes])


def held_out_log_odds(scenes: list[SceneSites], sites: PooledSites, axis: str) -> np.ndarray:
    """Return log odds (n,) of sites by networks that were fitted without their kind of scene."""
    of = next(of for name, _, of in AXES if name == axis)
    kind = np.array([of(j.scene) for j in scenes])[scenes_of(scenes)]
    odds = np.empty(len(kind))
    for one in np.unique(kind):
        held_out = kind == one
        model = fit_network(sites.features[~held_out], sites.safe[~held_out])
        odds[held_out] = model(sites.features[held_out])
    return odds


def add_row(
    table: Table, name: tuple[str, str], p: np.ndarray, safe: np.ndarray, scene: np.ndarray
) -> None:
    """Add the claims of probabilities `p` (n,) on sites of numbered scenes (n,) to a table.

    `name` is the probability and the divisor of its odds.
    """
    cells = []
    for limit in CLAIMS:
        claim = p > limit
        count = np.bincount(scene[claim], minlength=scene.max() + 1)
        right = np.bincount(scene[claim & safe], minlength=scene.max() + 1)
        many = count >= MIN_CLAIMS
        share = right[many] / count[many]
        cells += [
            f"{claim[safe].mean():.3f}", f"{safe[claim].mean():.4f}" if claim.any() else "-",
            f"{(share < CLAIMS[0]).sum()} of {many.sum()}",
        ]  # fmt: skip
    table.add_row(*name, f"{np.mean((p - safe) ** 2):.4f}", *cells)


@click.command()
@click.option(
    "--scenes",
    "count",
    type=click.IntRange(min=8),
    default=1000,
    show_default=True,
    help="Number of scenes of the fit.",
)
@click.option(
    "--new-scenes",
    "new_count",
    type=click.IntRange(min=1),
    default=480,
    show_default=True,
    help="Number of new scenes for the test.",
)
@click.option(
    "--sites",
    type=click.IntRange(min=1),
    default=1000,
    show_default=True,
    help="Number of sites of each scene.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=5,
    show_default=True,
    help="Random seed of the scenes.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of parallel processes; it does not change the results.",
)
@click.option(
    "--scenes-file",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="File of the scenes of the fit (.npz): read if it exists, otherwise written.",
)
def main(
    count: int, new_count: int, sites: int, seed: int, jobs: int, scenes_file: Path | None
) -> None:  # fmt: skip
    """Compare p_safe of the Gaussian DEM with a small neural network on the same evidence."""
    torch.set_num_threads(1)
    console = plain_console(150)
    evaluate = partial(evaluate_scene, count=sites)
    fitted = load_or_evaluate(evaluate, sample_scenes(count, seed), scenes_file, jobs, console)
    new = load_or_evaluate(evaluate, sample_scenes(new_count, seed + 1), None, jobs, console)
    table = Table(title=f"Claims; worlds with at least {MIN_CLAIMS} claims are counted")
    for heading in ("Probability", "odds over", "Brier score", *(
        f"p > {limit}: {name}" for limit in CLAIMS
        for name in ("recall", "precision", "worlds below 0.95")
    )):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "Probability" else "right")
    known, tested = PooledSites.of(fitted), PooledSites.of(new)
    p, claimed = predict_safety(GAUSSIAN_DEM.packaged, tested)
    add_row(table, ("packaged, in domain", "-"), np.where(claimed, p, np.minimum(p, CLAIMS[0])),
            tested.safe, scenes_of(new))  # fmt: skip
    console.print(f"{len(known.safe)} sites of the fit, {len(tested.safe)} of new scenes")
    odds = fit_network(known.features, known.safe)(tested.features)
    add_network(table, "network, new scenes", odds, tested, new)
    for axis, _, _ in AXES:
        odds = held_out_log_odds(fitted, known, axis)
        add_network(table, f"network, {axis} held out", odds, known, fitted)
    console.print(table)


def add_network(
    table: Table, name: str, odds: np.ndarray, sites: PooledSites, scenes: list[SceneSites]
) -> None:  # fmt: skip
    """Add rows for a network's log odds (n,) with each margin, and the bound of the map."""
    for margin in MARGINS:
        p = np.minimum(expit(odds - np.log(margin)), sites.observed_terrain_bound)
        add_row(table, (name, f"{margin}"), p, sites.safe, scenes_of(scenes))


if __name__ == "__main__":
    main()
