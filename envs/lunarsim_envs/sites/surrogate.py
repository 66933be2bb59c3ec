"""Surrogate (statistical substitute) of a mapper: random p_safe maps of a terrain.

For each site class (see `hazard`), scan and fraction of safe terrain, tables store the distribution
of the mapper's p_safe in simulated flights. A Gaussian copula draws the maps: a standard normal
field with the spatial correlation of the mapper's errors selects the quantile of each site in its
class. Calibration and false rates therefore follow from the tables, and errors occur in patches as
those of the mapper.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write_arrays
from lunarsim.errors import InputError, error_reason
from lunarsim.scenario import Scenario
from lunarsim.typing import Array
from lunarsim.untrusted_files import read_arrays
from lunarsim_envs.sites import hazard
from lunarsim_envs.sites._map_kernels import MapErrorModel
from lunarsim_envs.sites.field_of_view import deciding_mapper

_FORMAT = "lunarsim surrogate 1"
# File of the packaged surrogate.
SHIPPED = Path(__file__).parent / "gaussian_dem.npz"
# Nodes of the tables: evenly spaced normal scores from -MOST to MOST.
MOST, NODES = 3.2, 33
# Correlation lengths of the Gaussian mixture, m; the first means uncorrelated noise.
LENGTHS = np.array([0.0, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8])
# Number of noise fields, and cells per side.
_FIELDS, _SIDE = 6, 256


@dataclass(frozen=True)
class Surrogate:
    """Statistical model of the p_safe maps that a mapper makes of known true terrain.

    p_safe is the probability of safe terrain at a site. A class groups sites by true hazard size
    and distance to the safety edge (`hazard`).

    Attributes
    ----------
    shares
        Safe fraction of the fitted terrains, ascending (terrains,).
    tables
        Quantiles of p_safe at evenly spaced normal scores (terrains, scans, classes, nodes).
    common
        Fraction of the variance of normal scores that all cells of a map share (terrains, scans).
    weights
        Weights of the correlation `LENGTHS` (terrains, scans, lengths), which sum to 1.
    stretch
        Factor on the correlation lengths (terrains, scans). Patches of low p_safe are longer than a
        Gaussian copula with the correlation of the normal scores gives.
    kept
        Correlation of normal scores between consecutive scans.
    drift
        Standard deviation of the drift velocity of the lander over its map, east and north (2,),
        m/s.
    reported_velocity_sigma
        Standard deviation of velocity that navigation reports, per axis, m/s.
    altitudes
        Altitudes of the scans, m.
    made_for
        Scenario tables for which the surrogate holds, as JSON.
    """

    shares: Array
    tables: Array
    common: Array
    weights: Array
    stretch: Array
    kept: float
    drift: Array
    reported_velocity_sigma: float
    altitudes: Array
    made_for: str

    def save(self, path: Path) -> None:
        """Write the surrogate to a ``.npz`` file, with tables in half precision."""
        held: dict[str, Any] = {
            name: getattr(self, name)
            for name in (
                "shares",
                "common",
                "weights",
                "stretch",
                "kept",
                "drift",
                "reported_velocity_sigma",
                "altitudes",
            )
        }
        held |= {"tables": self.tables.astype(np.float16), "made_for": self.made_for}
        atomic_write_arrays(path, held | {"format": _FORMAT})

    @classmethod
    def load(cls, path: Path) -> Surrogate:
        """Read a surrogate written by `save`.

        Raises
        ------
        InputError
            If the file is not a surrogate, or its arrays are inconsistent.
        """
        try:
            held = read_arrays(path)
            if str(held["format"]) != _FORMAT:
                raise ValueError(f"the format must be {_FORMAT}, not {held['format']}")
            made = cls(
                held["shares"], held["tables"].astype(np.float64), held["common"], held["weights"],
                held["stretch"], float(held["kept"]), held["drift"],
                float(held["reported_velocity_sigma"]), held["altitudes"], str(held["made_for"]),
            )  # fmt: skip
            made._check()
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            array = "the array " if isinstance(error, KeyError) else ""
            raise InputError(
                "surrogate",
                str(path),
                "must be a file written by scenarios/learning/fit_surrogate.py "
                f"({array}{error_reason(error)})",
            ) from None
        return made

    def _check(self) -> None:
        shape = (len(self.shares), len(self.altitudes), hazard.COUNT, NODES)
        if self.tables.shape != shape or self.common.shape != shape[:2]:
            raise ValueError(f"tables must have shape {shape}, not {self.tables.shape}")
        if not ((self.tables >= 0.0) & (self.tables <= 1.0)).all():
            raise ValueError("values of tables must be between 0 and 1")
        if self.stretch.shape != shape[:2] or not (self.stretch > 0.0).all():
            raise ValueError("stretch must have the shape of tables and positive values")
        wide = (*shape[:2], len(LENGTHS))
        if self.weights.shape != wide or np.abs(self.weights.sum(axis=2) - 1.0).max() > 1e-6:
            raise ValueError("weights must have the shape of tables and a sum of 1")

    def check(self, scenario: Scenario) -> None:
        """Check that the surrogate holds for the mapper and sensor of a scenario.

        A scenario with fewer scans is accepted if their altitudes are the first ones of the fit.

        Raises
        ------
        InputError
            If a scenario table differs from those of the fit.
        """
        mine, theirs = json.loads(self.made_for), surrogate_tables(scenario)
        taken = theirs["tasking"].get("altitudes_m", [])
        if taken and taken == mine["tasking"]["altitudes_m"][: len(taken)]:
            mine["tasking"]["altitudes_m"] = taken
        mapper = deciding_mapper(scenario)
        sensor = scenario.mappers[mapper].make().sensor
        tables = {"mapper": f"mappers.{mapper}", "sensor": f"sensors.{sensor}"}
        tables |= {"tasking": f"tasking.{sensor}", "expected_rocks": "expected_rocks"}
        for name, table in tables.items():
            for key in sorted(mine[name].keys() | theirs[name].keys()):
                own, other = mine[name].get(key), theirs[name].get(key)
                if own != other:
                    raise InputError(
                        f"{table}.{key}", other,
                        f"must be {own!r}, for which the perception surrogate was fitted",
                        "Fit a surrogate for this scenario with scenarios/learning/"
                        "fit_surrogate.py, or use perception='gaussian-dem'.",
                    )  # fmt: skip

    def _noise(self, posting: float) -> NDArray[np.float32]:
        held = self.weights.tobytes(), self.stretch.astype(np.float64).tobytes()
        return correlated_noise(*held, self.weights.shape, posting)

    def errors(self, shares: Array, posting: float) -> MapErrorModel:
        """Interpolate the error model to worlds, in the form that kernels use.

        Parameters
        ----------
        shares
            Safe fraction of each world (k,); tables are interpolated between the fitted terrains.
        posting
            Cell size of the maps, m.
        """
        at = np.clip(np.interp(shares, self.shares, np.arange(len(self.shares))), 0, None)
        low = np.minimum(at.astype(int), max(len(self.shares) - 2, 0))
        high = np.minimum(low + 1, len(self.shares) - 1)
        part = at - low

        def between(values: Array) -> Array:
            share = part.reshape(-1, *([1] * (values.ndim - 1)))
            return np.asarray((1.0 - share) * values[low] + share * values[high])

        return MapErrorModel(
            between(self.tables).astype(np.float32), MOST,
            self._noise(posting),
            np.round(at).astype(np.int64), between(self.common), self.kept, False,
        )  # fmt: skip


def surrogate_tables(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario tables on which maps depend, except the terrain, by name."""
    held, name = scenario.to_dict(), deciding_mapper(scenario)
    mapper = held["mappers"][name]
    sensor = mapper["sensor"]
    return {
        "mapper": mapper, "sensor": held["sensors"][sensor], "tasking": held["tasking"][sensor],
        "expected_rocks": held["expected_rocks"],
    }  # fmt: skip


@lru_cache(maxsize=4)
def correlated_noise(
    weights: bytes, stretch: bytes, shape: tuple[int, int, int], posting: float
) -> NDArray[np.float32]:
    """Generate periodic standard normal fields (terrains, scans, fields, side, side).

    Their spatial correlation is a mixture of Gaussians with the lengths `LENGTHS` times `stretch`
    (terrains, scans) and `weights` (terrains, scans, lengths). `weights` and `stretch` are passed
    as bytes, so that the result can be cached.
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
        # The mean is removed, because `common` models the variance between maps.
        fields -= fields.mean(axis=(1, 2), keepdims=True)
        out[g, scan] = fields / fields.std(axis=(1, 2), keepdims=True)
    return out


def exact_errors() -> MapErrorModel:
    """Return the error model of perfect perception, whose maps are the true safety."""
    return MapErrorModel(
        np.zeros((1, 1, 1, 2), np.float32), MOST, np.zeros((1, 1, 1, 1, 1), np.float32),
        np.zeros(1, np.int64), np.zeros((1, 1)), 0.0, True,
    )  # fmt: skip
