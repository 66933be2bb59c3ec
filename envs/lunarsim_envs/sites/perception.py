"""Create flights and batches of ``Retarget-v1`` for each kind of perception."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.arguments import check_no_dispersions, checked_covers
from lunarsim_envs.descent.worlds import scenarios_by_cover
from lunarsim_envs.dispersions import dispersions_argument
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.field_of_view import fov_and_footprint
from lunarsim_envs.sites.flights import KernelFlight, OnboardFlight, SiteFlight
from lunarsim_envs.sites.mapped_batch import MappedDescentBatch, gaussian_dem_of
from lunarsim_envs.sites.perception_scenarios import MAPPER_OF
from lunarsim_envs.sites.pool import SiteWorldPool
from lunarsim_envs.sites.surrogate import SHIPPED, Surrogate, exact_errors

# Perceptions that the full simulation flies, and those that kernels fly.
FULL_SIMULATION = ("onboard", *MAPPER_OF)
KERNELS = ("truth", "surrogate", "gaussian-dem")
PERCEPTIONS = ("onboard", *KERNELS, *MAPPER_OF)
# Cell size of maps in kernels, m.
_POSTING = 0.4


def create_flight(
    perception: str, scenario: Scenario, worlds: int, world_seed: int, surrogate: Any,
    covers: Sequence[float] = (), split: str = "train", dispersions: Any = None,
) -> SiteFlight:  # fmt: skip
    """Create the simulated flight of a single ``Retarget-v1`` environment.

    The arguments are described in `RetargetEnv`. The full simulation flies ``"onboard"``,
    ``"shadows"``, ``"quadtree"`` and ``"fused"``; kernels fly the other perceptions.

    Raises
    ------
    InputError
        If the perception is unknown, or does not support the scenario or the dispersions.
    """
    if perception in FULL_SIMULATION:
        # The full simulation generates worlds per flight; this call only checks the covers.
        scenarios_by_cover(scenario, checked_covers(covers))
        return OnboardFlight(scenario, split, dispersions_argument(dispersions, scenario))
    check_no_dispersions(dispersions)
    return KernelFlight(
        create_batch(1, perception, scenario, worlds, world_seed, surrogate, covers, split)
    )


def create_batch(
    count: int, perception: str, scenario: Scenario, worlds: int, world_seed: int, surrogate: Any,
    covers: Sequence[float] = (), split: str = "train",
) -> SiteDescentBatch:  # fmt: skip
    """Create a batch of landers for site decisions, flown by compiled kernels.

    Parameters
    ----------
    count
        Number of landers.
    perception
        One of `KERNELS`.
    scenario
        Scenario of the flights.
    worlds, world_seed
        Number of worlds in the pool per cover, and root seed.
    surrogate
        `Surrogate` or the path of its file; None is the surrogate supplied with lunarsim_envs.
    covers
        Additional rock covers, area fractions.
    split
        Split of the worlds, one of `lunarsim.rng.SPLITS`.

    Raises
    ------
    InputError
        If the perception is unknown, or kernels do not support the scenario.
    """
    if not isinstance(perception, str) or perception not in KERNELS:
        remedy = (
            "Use a single environment (gymnasium.make) for this perception."
            if perception in FULL_SIMULATION
            else ""
        )
        raise InputError(
            "perception", perception,
            f"must be one of {', '.join(KERNELS)} in a vector environment", remedy,
        )  # fmt: skip
    if isinstance(surrogate, Surrogate):
        model = surrogate
    elif not isinstance(surrogate, str | Path | None):
        raise InputError(
            "surrogate", surrogate, "must be a Surrogate, the path of its file, or None"
        )
    else:
        model = Surrogate.load(SHIPPED if surrogate is None else Path(surrogate))
    view = fov_and_footprint(scenario)
    if perception == "surrogate":
        model.check(scenario)
    elif perception == "gaussian-dem":
        gaussian_dem_of(scenario)
    pool = SiteWorldPool.of(scenario, worlds, world_seed, checked_covers(covers), split)
    if perception == "truth":
        return SiteDescentBatch(
            count, scenario, pool, errors=exact_errors(), view=view, drift_sigma=np.zeros(2),
            reported_velocity_sigma=0.0, posting=_POSTING,
        )  # fmt: skip
    errors = exact_errors() if perception == "gaussian-dem" else model.errors(pool.shares, _POSTING)
    kind = MappedDescentBatch if perception == "gaussian-dem" else SiteDescentBatch
    return kind(
        count, scenario, pool, errors=errors, view=view, drift_sigma=model.drift,
        reported_velocity_sigma=model.reported_velocity_sigma, posting=_POSTING,
    )  # fmt: skip
