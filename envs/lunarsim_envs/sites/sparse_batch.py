"""Fly millions of descents in kernels, with a surrogate for perception."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.core.touchdown import CAUSES
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.typing import BoolArray, IntArray
from lunarsim_envs.descent.batch import LATE
from lunarsim_envs.sites import _sparse_kernels as k
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.perception import create_batch

# Number of parallel lanes (results do not depend on it); spacing of the site lattice, cells; half
# side of the lattice, m.
LANES, _EVERY, _REACH = 4096, 8, 24.0


@dataclass(frozen=True)
class FlightSummary:
    """Numbers of flights and safe landings, failures and propellant of many flights.

    Attributes
    ----------
    flights, safe
        Number of flights, and of safe landings.
    failed
        Number of violations of each limit in `core.touchdown.CAUSES` and of the time limit.
    seconds
        Total flight time, s.
    propellant
        Total propellant used by safe landings, kg.
    by_p_safe, safe_by_p_safe
        Number of flights, and of safe landings, by tenths of the p_safe that the map predicted for
        the site (10,).
    """

    flights: int
    safe: int
    failed: dict[str, int]
    seconds: float
    propellant: float
    by_p_safe: IntArray
    safe_by_p_safe: IntArray

    def __add__(self, other: FlightSummary) -> FlightSummary:
        """Return the summary of the flights in this summary and another one."""
        return FlightSummary(
            self.flights + other.flights, self.safe + other.safe,
            {name: self.failed[name] + other.failed[name] for name in self.failed},
            self.seconds + other.seconds, self.propellant + other.propellant,
            self.by_p_safe + other.by_p_safe, self.safe_by_p_safe + other.safe_by_p_safe,
        )  # fmt: skip


def batches(
    scenario: Scenario,
    flights: int,
    seed: int,
    worlds: int,
    lanes: int = LANES,
    surrogate: Any = None,
) -> Iterator[FlightSummary]:
    """Fly many descents in parallel batches and yield the summary of each batch.

    Flight i does not depend on the number of parallel flights and threads.

    Parameters
    ----------
    scenario
        Scenario of the flights. After every scan, the lander diverts to the nearest site that is
        safe enough.
    flights, seed
        Number of flights, and root seed.
    worlds
        Number of worlds in the pool.
    lanes
        Number of parallel flights.
    surrogate
        `Surrogate` or the path of its file; None is the surrogate supplied with lunarsim_envs.

    Raises
    ------
    InputError
        If `flights` is less than 1, or kernels do not support the scenario.
    """
    if flights < 1:
        raise InputError("--flights", flights, "must be 1 or more")
    one = create_batch(1, "surrogate", scenario, worlds, 0, surrogate)
    many = SparseDescentBatch(
        min(lanes, flights), without_site_decisions(scenario), one.pool, errors=one.errors,
        view=one.view, drift_sigma=one.drift_sigma,
        reported_velocity_sigma=float(one.maps.miss_params[1]), posting=one.maps.posting,
    )  # fmt: skip
    keys = np.random.default_rng(seed).integers(2**64, size=flights, dtype=np.uint64)
    for first in range(0, flights, many.count):
        own = keys[first : first + many.count]
        mask = np.arange(many.count) < len(own)
        many.ended[:] = LATE
        many.seed(mask, own)
        many.begin(mask)
        yield many.tally(mask)


class SparseDescentBatch(SiteDescentBatch):
    """Landers that evaluate a sparse lattice of sites and divert after every scan.

    No complete hazard maps are computed, so that millions of flights are feasible.

    Attributes
    ----------
    site_p_safe
        Predicted p_safe of the current site (n,); NaN if it was not observed.
    """

    keeps_maps = False

    def begin(self, mask: BoolArray) -> None:
        """Start new flights of the landers of `mask` (n,) and fly them to their end."""
        self.site_p_safe = np.full(self.count, np.nan)
        super().begin(mask)

    def scan(self, due: BoolArray) -> None:
        """Take a scan for the landers of `due` (n,) and divert to the best lattice site."""
        side = int(2.0 * _REACH / self.maps.posting) + 1
        k.scan_and_divert.run_loop(
            self.count, 200.0, due, self._keys, self._flight_counts, self.y,
            self.time, self.world, self.target, self.guidance, self.law, side, _EVERY,
            self.maps.posting, self.pool.layers, self.errors, self.view, self.site_p_safe,
        )  # fmt: skip

    def tally(self, mask: BoolArray) -> FlightSummary:
        """Return the summary of the ended flights of the landers of `mask` (n,)."""
        safe = self.safe & mask
        failed = {
            name: int(((self.failed >> bit & 1).astype(bool) & mask).sum())
            for bit, name in enumerate(CAUSES)
        }
        failed["time-limit"] = int(((self.ended == LATE) & mask).sum())
        known = mask & np.isfinite(self.site_p_safe)
        tenth = np.minimum((np.nan_to_num(self.site_p_safe) * 10).astype(int), 9)
        return FlightSummary(
            int(mask.sum()), int(safe.sum()), failed, float(self.time[mask].sum()),
            float(self.propellant_used[safe].sum()), np.bincount(tenth[known], minlength=10),
            np.bincount(tenth[known & safe], minlength=10),
        )  # fmt: skip


def without_site_decisions(scenario: Scenario) -> Scenario:
    """Return a copy of a scenario in which the onboard computer decides on no site.

    Decisions are permitted only below an altitude of 0.2 mm.
    """
    return scenario.changed(decisions={"first_altitude_m": 2e-4, "last_altitude_m": 1e-4})
