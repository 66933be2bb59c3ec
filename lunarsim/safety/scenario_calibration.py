"""Last stage of the Gaussian DEM's calibration, fitted to one scenario.

The packaged regression was fitted to a set of worlds. For a scenario that differs from these, its
log odds are scaled and shifted to the observed frequencies: once for sites in the regression's
domain, and once for sites outside, where it was never fitted. The scale is non-negative, and
outside the domain the lower of both results is used, so that worse terrain never has a higher
probability.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from lunarsim.atomic_files import atomic_write_text, read_json_with_format
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.parts.quantity import quantity_of
from lunarsim.safety.domain import Domain
from lunarsim.safety.ensemble import Ensemble
from lunarsim.safety.logistic import Logistic

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
MetricTable = Mapping[str, Mapping[str, float | None]]

# Fields of the lander that affect the safety of a site.
_LANDER = ("legs", "leg_radius", "pad_diameter", "slope_limit", "roughness_limit")
_FORMAT = "lunarsim scenario calibration 1"
_WRITE_REMEDY = "Write such a file with `lunarsim calibrate`."
_REFIT_REMEDY = "Fit it again with `lunarsim calibrate`, or omit the calibration."


# Minimum number of safe and of unsafe sites for fitting a stage.
MIN_SITES_PER_CLASS = 20


@dataclass(frozen=True)
class CalibrationStage:
    """Last stage of the calibration: ``p = expit(intercept + slope * log_odds)``.

    Attributes
    ----------
    intercept, slope
        Coefficients for the log odds of the packaged regression; the defaults do not change them.

    Raises
    ------
    InputError
        If a number is not finite, or `slope` is negative.
    """

    intercept: float = 0.0
    slope: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.intercept):
            raise InputError("calibration.intercept", self.intercept, "must be finite")
        if not (np.isfinite(self.slope) and self.slope >= 0.0):
            raise InputError(
                "calibration.slope", self.slope,
                "must be finite and 0 or more: better evidence must not make a site less safe",
            )  # fmt: skip

    @classmethod
    def fit(cls, log_odds: Array, safe: BoolArray) -> CalibrationStage:
        """Fit to safe and unsafe sites (n,) by maximum likelihood."""
        x = np.column_stack((np.ones_like(log_odds), log_odds))
        return cls(*Logistic.fit(x, safe, rising=1).weights)

    def probability(self, log_odds: Array) -> Array:
        """Return the probability of sites (n,)."""
        return np.asarray(expit(self.intercept + self.slope * log_odds))


@dataclass(frozen=True)
class ScenarioCalibration:
    """Last stage of the calibration, and the data it was fitted to.

    Attributes
    ----------
    inside, outside
        Stage for sites in the domain of the packaged regression, and for others; for these the
        lower of both results is used.
    domain
        Domain of the sites of the fit.
    lander
        Parameters of the lander that affect safety, by key and in the unit of `[vehicle]`.
    regression
        `Ensemble.digest` of the packaged regressions.
    scenario, mapper
        Names of the scenario and the mapper.
    flights, sites, seed
        Numbers of flights and sites of the fit, and root seed.
    before, after
        Accuracy metrics of the packaged probability and of this one on the scenario's sites in
        either domain; each flight is evaluated with a fit to the others. None: not available.
    """

    inside: CalibrationStage
    outside: CalibrationStage
    domain: Domain
    lander: Mapping[str, float]
    regression: str
    scenario: str = ""
    mapper: str = ""
    flights: int = 0
    sites: int = 0
    seed: int = 0
    before: MetricTable = field(default_factory=dict)
    after: MetricTable = field(default_factory=dict)

    @classmethod
    def fit(
        cls,
        log_odds: Array,
        safe: BoolArray,
        known: BoolArray,
        domain: Domain,
        lander: Lander,
        model: Ensemble,
    ) -> ScenarioCalibration:
        """Fit the last stage by maximum likelihood.

        If too few safe or unsafe sites lie in the regression's domain, its probabilities there do
        not change; if too few lie outside, the same stage is used for both.

        Parameters
        ----------
        log_odds, safe, known
            Log odds by the regression, exact safety, and whether in the regression's domain, of
            sites in `domain` (n,).
        domain
            Domain of the sites.
        lander, model
            Lander of the sites, and the regressions.

        Raises
        ------
        InputError
            If both groups have too few safe or unsafe sites.
        """
        fits = [
            CalibrationStage.fit(log_odds[of], safe[of]) if has_enough_sites(safe[of]) else None
            for of in (known, ~known)
        ]
        if fits == [None, None]:
            raise InputError(
                "sites",
                len(safe),
                f"must include at least {MIN_SITES_PER_CLASS} safe and {MIN_SITES_PER_CLASS} "
                f"unsafe sites",
            )
        inside = fits[0] or CalibrationStage()
        return cls(inside, fits[1] or inside, domain, lander_safety_params(lander), model.digest)

    def probability(self, log_odds: Array, known: BoolArray) -> Array:
        """Return the probability of sites (n,).

        Parameters
        ----------
        log_odds
            Log odds by the regression (n,).
        known
            Whether each site is in the domain of the regression (n,).
        """
        p = self.inside.probability(log_odds)
        return np.where(known, p, np.minimum(p, self.outside.probability(log_odds)))

    def check(self, lander: Lander, model: Ensemble) -> None:
        """Refuse another lander or another regression.

        Raises
        ------
        InputError
            Names the key of `[vehicle]` that differs, or the regression.
        """
        self.check_regression(model)
        for key, value in lander_safety_params(lander).items():
            if not np.isclose(value, self.lander[key], rtol=1e-9, atol=0.0):
                raise InputError(
                    f"vehicle.{key}", value,
                    f"must be {self.lander[key]:g}, as in the calibration of {self.scenario!r}",
                    _REFIT_REMEDY,
                )  # fmt: skip

    def check_regression(self, model: Ensemble) -> None:
        """Refuse another regression than that of the fit."""
        if model.digest != self.regression:
            raise InputError(
                "calibration.regression", self.regression,
                f"must be {model.digest}, the regression of this version", _REFIT_REMEDY,
            )  # fmt: skip

    # --- files ----------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write the calibration as JSON, atomically.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        data = {"format": _FORMAT, **asdict(self)}
        text = json.dumps(data, indent=1, allow_nan=False) + "\n"
        atomic_write_text(path, text)

    @classmethod
    def load(cls, path: Path) -> ScenarioCalibration:
        """Read a file written by `save`.

        Raises
        ------
        InputError
            If the file is missing, is not a calibration, or has an invalid number.
        """
        data = read_json_with_format(
            path, "calibration", _FORMAT, " (written by `lunarsim calibrate`)"
        )
        return cls._parsed(data)

    @classmethod
    def _parsed(cls, data: dict[str, Any]) -> ScenarioCalibration:
        domain = _table(data, "domain")
        lander = _table(data, "lander")
        texts = {key: _entry(data, key, str) for key in ("regression", "scenario", "mapper")}
        counts = {key: _entry(data, key, int) for key in ("flights", "sites", "seed")}
        return cls(
            inside=_stage(data, "inside"),
            outside=_stage(data, "outside"),
            domain=Domain(
                _number(domain, "hazards"), _number(domain, "tilting"),
                _range(domain, "noise"), _range(domain, "spacing"),
            ),
            lander={key: _number(lander, key) for key in lander_safety_params(Lander())},
            before=_figures(data, "before"),
            after=_figures(data, "after"),
            **texts,
            **counts,
        )  # fmt: skip


def has_enough_sites(safe: BoolArray) -> bool:
    """Return whether there are enough safe and unsafe sites (n,) to fit a stage."""
    return bool(min(safe.sum(), (~safe).sum()) >= MIN_SITES_PER_CLASS)


def lander_safety_params(lander: Lander) -> dict[str, float]:
    """Return the parameters that affect safety, by key and in the unit of `[vehicle]`."""
    found = {}
    for f in fields(lander):
        if f.name in _LANDER:
            q = quantity_of(f.metadata)
            value = getattr(lander, f.name)
            found[f.name + (q.suffix if q else "")] = float(q.from_si(value) if q else value)
    return found


def _entry(data: dict[str, Any], key: str, kind: type) -> Any:
    if key not in data:
        raise InputError("calibration", key, "must have an entry of that name", _WRITE_REMEDY)
    value = data[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        words = {str: "must be a text", int: "must be an integer", dict: "must be a table"}
        raise InputError(f"calibration.{key}", value, words[kind])
    return value


def _table(data: dict[str, Any], key: str) -> dict[str, Any]:
    found: dict[str, Any] = _entry(data, key, dict)
    return found


def _number(data: dict[str, Any], key: str, value: Any = None) -> float:
    """Return the finite number of a key, or `value` if given."""
    if value is None:
        if key not in data:
            raise InputError("calibration", key, "must have an entry of that name", _WRITE_REMEDY)
        value = data[key]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and abs(value) <= sys.float_info.max):  # also refuses NaN
        raise InputError(f"calibration.{key}", value, "must be a finite number")
    return float(value)


def _stage(data: dict[str, Any], key: str) -> CalibrationStage:
    table = _table(data, key)
    return CalibrationStage(_number(table, "intercept"), _number(table, "slope"))


def _range(data: dict[str, Any], key: str) -> tuple[float, float]:
    value = data.get(key)
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"calibration.{key}", value, "must be a list of minimum and maximum")
    return _number(data, key, value[0]), _number(data, key, value[1])


def _figures(data: dict[str, Any], key: str) -> MetricTable:
    groups = _table(data, key)
    return {
        name: {k: None if v is None else _number(table, k) for k, v in table.items()}
        for name in groups
        for table in [_table(groups, name)]
    }
