"""A statistical stand-in for a mapper: what it says of sites, given what is true of them.

Of each class of sites (see `hazard`), of each scan and of grounds with a share of safe sites the
distribution of the mapper's p_safe is kept as it was seen in flight. A map is drawn by a Gaussian
copula: a field of standard normal numbers, correlated in space as the mapper's own were, says which
quantile of its class each site is given. So calibration, missed and false rates follow from the
tables, and errors come in patches as the mapper's do.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.array_files import read_arrays
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.whole_arrays import write_arrays_whole
from lunarsim_envs.sites import hazard
from lunarsim_envs.sites._map_kernels import Errors
from lunarsim_envs.sites.view import deciding_mapper

Array = NDArray[np.float64]

_FORMAT = "lunarsim surrogate 1"
# The one that comes with the package.
SHIPPED = Path(__file__).parent / "gaussian_dem.npz"
# Standard normal numbers of the nodes of tables: evenly from -MOST to MOST.
MOST, NODES = 3.2, 33
# Lengths of the Gaussian correlations that are mixed, m; the first stands for none at all.
LENGTHS = np.array([0.0, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8])
# Fields of noise, and cells along a side of each.
_FIELDS, _SIDE = 6, 256


@dataclass(frozen=True)
class Surrogate:
    """Errors of a mapper.

    Attributes
    ----------
    shares
        Share of safe sites of the grounds that it was fitted on (grounds,), rising.
    tables
        p_safe (grounds, scans, classes, nodes).
    common
        Share of the variance of the normal numbers that a whole map has in common
        (grounds, scans).
    weights
        Of the correlations in space by `LENGTHS` (grounds, scans, lengths), that sum to 1.
    stretch
        By which those lengths are stretched (grounds, scans): patches of low p_safe are longer than
        a Gaussian copula of the normal numbers' own correlation makes them.
    kept
        Correlation of the normal numbers of a map with those of the scan before.
    drift
        Standard deviation of the velocity at which the lander drifts over its map, east and north
        (2,), m/s.
    claimed
        What navigation says of it, an axis, m/s.
    altitudes
        Of the scans, m.
    made_for
        Tables of the scenario that it stands for, as JSON.
    """

    shares: Array
    tables: Array
    common: Array
    weights: Array
    stretch: Array
    kept: float
    drift: Array
    claimed: float
    altitudes: Array
    made_for: str

    def save(self, path: Path) -> None:
        """Write it as ``.npz``, tables in half precision."""
        held: dict[str, Any] = {
            name: getattr(self, name)
            for name in (
                "shares",
                "common",
                "weights",
                "stretch",
                "kept",
                "drift",
                "claimed",
                "altitudes",
            )
        }
        held |= {"tables": self.tables.astype(np.float16), "made_for": self.made_for}
        write_arrays_whole(path, held | {"format": _FORMAT})

    @classmethod
    def load(cls, path: Path) -> Surrogate:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is something else.
        """
        try:
            held = read_arrays(path)
            if str(held["format"]) != _FORMAT:
                raise ValueError(f"its format is {held['format']}")
            made = cls(
                held["shares"], held["tables"].astype(np.float64), held["common"], held["weights"],
                held["stretch"], float(held["kept"]), held["drift"],
                float(held["claimed"]), held["altitudes"], str(held["made_for"]),
            )  # fmt: skip
            made._check()
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(
                "surrogate", str(path), f"a file of scenarios/learning/fit_surrogate.py ({error})"
            ) from None
        return made

    def _check(self) -> None:
        shape = (len(self.shares), len(self.altitudes), hazard.COUNT, NODES)
        if self.tables.shape != shape or self.common.shape != shape[:2]:
            raise ValueError(f"tables of shape {self.tables.shape}, not {shape}")
        if not ((self.tables >= 0.0) & (self.tables <= 1.0)).all():
            raise ValueError("probabilities that are none")
        if self.stretch.shape != shape[:2] or not (self.stretch > 0.0).all():
            raise ValueError("lengths that are none")
        wide = (*shape[:2], len(LENGTHS))
        if self.weights.shape != wide or np.abs(self.weights.sum(axis=2) - 1.0).max() > 1e-6:
            raise ValueError("weights that do not sum to 1")

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario whose mapper it does not stand for.

        One that takes only the first of the scans will do.

        Raises
        ------
        InputError
            Naming the table that differs.
        """
        mine, theirs = json.loads(self.made_for), stood_for(scenario)
        taken = theirs["tasking"].get("altitudes_m", [])
        if taken and taken == mine["tasking"]["altitudes_m"][: len(taken)]:
            mine["tasking"]["altitudes_m"] = taken
        for name in mine:
            if mine[name] != theirs[name]:
                raise InputError(
                    f"perception: [{name}]", theirs[name],
                    f"that of the surrogate, {mine[name]}; fit another by "
                    "scenarios/learning/fit_surrogate.py, or perception='gaussian-dem'",
                )  # fmt: skip

    def _noise(self, posting: float) -> NDArray[np.float32]:
        held = self.weights.tobytes(), self.stretch.astype(np.float64).tobytes()
        return noise(*held, self.weights.shape, posting)

    def errors(self, shares: Array, posting: float) -> Errors:
        """Return what kernels draw maps from.

        Parameters
        ----------
        shares
            Share of safe sites of each world (k,): tables lie between those of the nearest
            grounds.
        posting
            Of the maps, m.
        """
        at = np.clip(np.interp(shares, self.shares, np.arange(len(self.shares))), 0, None)
        low = np.minimum(at.astype(int), max(len(self.shares) - 2, 0))
        high = np.minimum(low + 1, len(self.shares) - 1)
        part = at - low

        def between(values: Array) -> Array:
            share = part.reshape(-1, *([1] * (values.ndim - 1)))
            return np.asarray((1.0 - share) * values[low] + share * values[high])

        return Errors(
            between(self.tables).astype(np.float32), MOST,
            self._noise(posting),
            np.round(at).astype(np.int64), between(self.common), self.kept, False,
        )  # fmt: skip


def stood_for(scenario: Scenario) -> dict[str, Any]:
    """Return the tables of a scenario that its maps hang on, besides the ground."""
    held, name = scenario.to_dict(), deciding_mapper(scenario)
    mapper = held["mappers"][name]
    sensor = mapper["sensor"]
    return {
        "mapper": mapper, "sensor": held["sensors"][sensor], "tasking": held["tasking"][sensor],
        "expected_rocks": held["expected_rocks"],
    }  # fmt: skip


@lru_cache(maxsize=4)
def noise(
    weights: bytes, stretch: bytes, shape: tuple[int, int, int], posting: float
) -> NDArray[np.float32]:
    """Return periodic fields of standard normal numbers (grounds, scans, fields, side, side).

    Their correlation at a distance is that of the mixture of `LENGTHS`, stretched (grounds, scans),
    by weight (grounds, scans, lengths); both are given as bytes.
    """
    mixed = np.frombuffer(weights).reshape(shape)
    longer = np.frombuffer(stretch).reshape(shape[:2])
    away = np.minimum(np.arange(_SIDE), _SIDE - np.arange(_SIDE)) * posting
    square = away[:, None] ** 2 + away[None, :] ** 2
    white = np.random.default_rng(0).standard_normal((shape[1], _FIELDS, _SIDE, _SIDE))
    seen = np.fft.rfft2(white)
    out = np.empty((*shape[:2], _FIELDS, _SIDE, _SIDE), np.float32)
    for g, scan in np.ndindex(shape[:2]):
        wanted = np.zeros((_SIDE, _SIDE))
        wanted[0, 0] = mixed[g, scan, 0]
        for weight, length in zip(mixed[g, scan, 1:], longer[g, scan] * LENGTHS[1:], strict=True):
            if weight > 0.0:
                wanted += weight * np.exp(-0.5 * square / length**2)
        spectrum = np.sqrt(np.maximum(np.fft.rfft2(wanted).real, 0.0))
        fields = np.fft.irfft2(seen[scan] * spectrum, s=(_SIDE, _SIDE))
        # The mean of a field is a whole map's own, which `common` tells.
        fields -= fields.mean(axis=(1, 2), keepdims=True)
        out[g, scan] = fields / fields.std(axis=(1, 2), keepdims=True)
    return out


def exact() -> Errors:
    """Return what draws the truth."""
    return Errors(
        np.zeros((1, 1, 1, 2), np.float32), MOST, np.zeros((1, 1, 1, 1, 1), np.float32),
        np.zeros(1, np.int64), np.zeros((1, 1)), 0.0, True,
    )  # fmt: skip
