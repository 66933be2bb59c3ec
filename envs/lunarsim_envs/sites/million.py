"""Very many descents: guidance, perception by a surrogate, vehicle and verdict in kernels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.descent.lanes import LATE, LIMITS
from lunarsim_envs.sites import _sparse_kernels as k
from lunarsim_envs.sites.lanes import Mask, SiteLanes
from lunarsim_envs.sites.perception import lanes_of

# Lanes that fly side by side, which nothing depends on; cells between two sites of the lattice,
# half a side of it, m.
LANES, _EVERY, _REACH = 4096, 8, 24.0


@dataclass(frozen=True)
class Tally:
    """What came of flights.

    Attributes
    ----------
    flights, safe
        Numbers.
    failed
        Of each limit of `LIMITS`, and of the time limit.
    seconds
        Flown, all together, s.
    propellant
        Burnt by safe ones, all together, kg.
    told, told_safe
        By tenths of the p_safe that the lander was told of its site: flights, and those of them
        that landed safe.
    """

    flights: int
    safe: int
    failed: dict[str, int]
    seconds: float
    propellant: float
    told: NDArray[np.int64]
    told_safe: NDArray[np.int64]

    def __add__(self, other: Tally) -> Tally:
        """Return the tally of both."""
        return Tally(
            self.flights + other.flights, self.safe + other.safe,
            {name: self.failed[name] + other.failed[name] for name in self.failed},
            self.seconds + other.seconds, self.propellant + other.propellant,
            self.told + other.told, self.told_safe + other.told_safe,
        )  # fmt: skip


def batches(
    scenario: Scenario,
    flights: int,
    seed: int,
    worlds: int,
    lanes: int = LANES,
    surrogate: Any = None,
) -> Iterator[Tally]:
    """Yield what came of each batch of flights.

    Flight i is the same for any number of lanes and threads.

    Parameters
    ----------
    scenario
        What flies; every scan is followed by a decision, the nearest site that will do.
    flights, seed
        How many, and their root seed.
    worlds
        Of the pool.
    lanes
        That fly side by side.

    Raises
    ------
    InputError
        If there are none, or the scenario cannot be flown so.
    """
    if flights < 1:
        raise InputError("--flights", flights, "at least 1")
    one = lanes_of(1, "surrogate", scenario, worlds, 0, surrogate)
    many = SparseLanes(
        min(lanes, flights), without_decisions(scenario), one.pool, errors=one.errors,
        view=one.view, drift=one.drift, claimed=float(one.maps.stated[1]),
        posting=one.maps.posting,
    )  # fmt: skip
    keys = np.random.default_rng(seed).integers(2**64, size=flights, dtype=np.uint64)
    for first in range(0, flights, many.count):
        own = keys[first : first + many.count]
        mask = np.arange(many.count) < len(own)
        many.ended[:] = LATE
        many.seed(mask, own)
        many.begin(mask)
        yield many.tally(mask)


class SparseLanes(SiteLanes):
    """Lanes whose perception is a lattice of sites; they decide after every scan, and then only.

    Attributes
    ----------
    said
        p_safe of the site that each flies to (n,); NaN: it has not been seen.
    """

    keeps_maps = False

    def begin(self, mask: Mask) -> None:
        """Fly every lane of `mask` (n,) from its start to its end."""
        self.said = np.full(self.count, np.nan)
        super().begin(mask)

    def scan(self, due: Mask) -> None:
        """Let the lanes of `due` take the scan that is due."""
        side = int(2.0 * _REACH / self.maps.posting) + 1
        self._run(
            k.choose, 200.0 * self.count, due, self._keys, self._begun, self.y, self.time,
            self.world, self.target, self.course, self.law, side, _EVERY, self.maps.posting,
            self.pool.layers, self.errors, self.view, self.said,
        )  # fmt: skip

    def tally(self, mask: Mask) -> Tally:
        """Return what came of the lanes of `mask` (n,)."""
        safe = self.safe & mask
        failed = {
            name: int(((self.failed >> bit & 1).astype(bool) & mask).sum())
            for bit, name in enumerate(LIMITS)
        }
        failed["time-limit"] = int(((self.ended == LATE) & mask).sum())
        known = mask & np.isfinite(self.said)
        tenth = np.minimum((np.nan_to_num(self.said) * 10).astype(int), 9)
        return Tally(
            int(mask.sum()), int(safe.sum()), failed, float(self.time[mask].sum()),
            float(self.burnt[safe].sum()), np.bincount(tenth[known], minlength=10),
            np.bincount(tenth[known & safe], minlength=10),
        )  # fmt: skip


def without_decisions(scenario: Scenario) -> Scenario:
    """Return a scenario whose window of decisions lies under the ground."""
    return scenario.changed(decisions={"first_altitude_m": 2e-4, "last_altitude_m": 1e-4})
