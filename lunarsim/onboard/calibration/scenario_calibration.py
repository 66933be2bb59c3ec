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
from scipy.special import expit

from lunarsim.atomic_files import atomic_write_text, read_json_with_format
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.logistic import Logistic
from lunarsim.parts.quantity import quantity_of
from lunarsim.typing import Array, BoolArray

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
    """Last stage of the safety calibration: scales and shifts log odds of safety.

    The probability is ``expit(intercept + slope * log_odds)``.

    Attributes
    ----------
    intercept, slope
        Coefficients for the log odds of the regression supplied with lunarsim; the defaults do not
        change these log odds.

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
                "must be 0 or more and finite",
            )  # fmt: skip

    @classmethod
    def fit(cls, log_odds: Array, safe: BoolArray) -> CalibrationStage:
        """Fit the last stage of the calibration to safe and unsafe sites (n,).

        `log_odds` are from the regression; the fit is by maximum likelihood.
        """
        x = np.column_stack((np.ones_like(log_odds), log_odds))
        return cls(*Logistic.fit(x, safe, rising=1).weights)

    def probability(self, log_odds: Array) -> Array:
        """Return the probability of safety (n,) from the log odds of the regression (n,)."""
        return np.asarray(expit(self.intercept + self.slope * log_odds))


@dataclass(frozen=True)
class ScenarioCalibration:
    """Last stage of the safety calibration fitted to one scenario, and its data.

    Attributes
    ----------
    inside, outside
        Stages for sites inside and outside the domain of the regression supplied with lunarsim.
        Outside, the probability is the lower one of both stages.
    domain
        Range of the sites to which the stages were fitted.
    lander
        Parameters of the lander that affect safety, by key and in the unit of `[vehicle]`.
    regression
        `Ensemble.digest` of the regressions supplied with lunarsim.
    scenario, mapper
        Names of the scenario and the mapper.
    flights, sites, seed
        Numbers of flights and sites of the fit, and root seed.
    before, after
        Accuracy metrics of the supplied calibration, and of this calibration by cross-validation:
        each flight is evaluated with a fit to the other flights. Both are given for the sites in
        the domain of the supplied calibration ("packaged_domain") and in that of this one
        ("refit_domain"). None: not available.
    """

    inside: CalibrationStage
    outside: CalibrationStage
    domain: CalibrationDomain
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
        in_domain: BoolArray,
        domain: CalibrationDomain,
        lander: Lander,
        model: Ensemble,
    ) -> ScenarioCalibration:
        """Fit the last stage of the calibration to sites of one scenario.

        The fit is by maximum likelihood.

        If too few safe or unsafe sites lie in the regression's domain, its probabilities there do
        not change; if too few lie outside, the same stage is used for both.

        Parameters
        ----------
        log_odds, safe, in_domain
            For each site in `domain` (n,): log odds by the regression, whether it is safe by the
            exact test, and whether it is in the regression's domain.
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
            for of in (in_domain, ~in_domain)
        ]
        if fits == [None, None]:
            raise InputError(
                "sites",
                len(safe),
                f"must include {MIN_SITES_PER_CLASS} or more safe and {MIN_SITES_PER_CLASS} or "
                "more "
                f"unsafe sites, but include {int(safe.sum())} safe and {int((~safe).sum())} unsafe",
                show_value=False,
            )
        inside = fits[0] or CalibrationStage()
        return cls(inside, fits[1] or inside, domain, lander_safety_params(lander), model.digest)

    def probability(self, log_odds: Array, in_domain: BoolArray) -> Array:
        """Return the probability of safety of sites (n,) by the last stage.

        Parameters
        ----------
        log_odds
            Log odds by the regression (n,).
        in_domain
            Whether each site is in the domain of the regression (n,).
        """
        p = self.inside.probability(log_odds)
        return np.where(in_domain, p, np.minimum(p, self.outside.probability(log_odds)))

    def check(self, lander: Lander, model: Ensemble) -> None:
        """Raise an error if the lander or the regression differs from those of the fit.

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
                    f"must be {self.lander[key]:g}, as in the calibration file",
                    _REFIT_REMEDY,
                )  # fmt: skip

    def check_regression(self, model: Ensemble) -> None:
        """Raise an error if the regression differs from the regression of the fit."""
        if model.digest != self.regression:
            raise InputError(
                "calibration.regression", self.regression,
                f"must be {model.digest}, the regression of this version of lunarsim",
                _REFIT_REMEDY,
            )  # fmt: skip

    # --- files ----------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write the calibration to a JSON file, atomically (complete or absent).

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
        """Read a scenario's calibration from a JSON file written by `save`.

        Raises
        ------
        InputError
            If the file is missing, is not a calibration, or has an invalid number.
        """
        data = read_json_with_format(
            path, "calibration", _FORMAT, " written by `lunarsim calibrate`"
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
            domain=CalibrationDomain(
                _number(domain, "hazards"), _number(domain, "tilting"),
                _range(domain, "noise"), _range(domain, "spacing"),
            ),
            lander={key: _number(lander, key) for key in lander_safety_params(Lander())},
            before=_metrics(data, "before"),
            after=_metrics(data, "after"),
            **texts,
            **counts,
        )  # fmt: skip


def has_enough_sites(safe: BoolArray) -> bool:
    """Return whether `safe` (n,) has enough safe and unsafe sites to fit a stage."""
    return bool(min(safe.sum(), (~safe).sum()) >= MIN_SITES_PER_CLASS)


def lander_safety_params(lander: Lander) -> dict[str, float]:
    """Return the lander's parameters that affect safety, by key of `[vehicle]`.

    Each value is in the unit of its key.
    """
    found = {}
    for f in fields(lander):
        if f.name in _LANDER:
            q = quantity_of(f.metadata)
            value = getattr(lander, f.name)
            found[f.name + (q.suffix if q else "")] = float(q.from_si(value) if q else value)
    return found


def _entry(data: dict[str, Any], key: str, kind: type) -> Any:
    """Return the value under a key of a calibration file, of the type `kind`."""
    if key not in data:
        raise InputError(
            f"calibration.{key}", None, "is missing from the calibration file", _WRITE_REMEDY, False
        )
    value = data[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        words = {str: "must be a text", int: "must be an integer", dict: "must be a table"}
        raise InputError(f"calibration.{key}", value, words[kind])
    return value


def _table(data: dict[str, Any], key: str) -> dict[str, Any]:
    """Return the table under a key of a calibration file; reject other types."""
    found: dict[str, Any] = _entry(data, key, dict)
    return found


def _number(data: dict[str, Any], key: str, value: Any = None) -> float:
    """Return the finite number under a key of a calibration file.

    If `value` is given, it is checked instead.
    """
    if value is None:
        if key not in data:
            raise InputError(
                f"calibration.{key}",
                None,
                "is missing from the calibration file",
                _WRITE_REMEDY,
                False,
            )
        value = data[key]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and abs(value) <= sys.float_info.max):  # also refuses NaN
        raise InputError(f"calibration.{key}", value, "must be a finite number")
    return float(value)


def _stage(data: dict[str, Any], key: str) -> CalibrationStage:
    """Return the calibration stage stored under a key of a calibration file."""
    table = _table(data, key)
    return CalibrationStage(_number(table, "intercept"), _number(table, "slope"))


def _range(data: dict[str, Any], key: str) -> tuple[float, float]:
    """Return minimum and maximum stored under a key of a calibration file."""
    value = data.get(key)
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"calibration.{key}", value, "must be a list of minimum and maximum")
    return _number(data, key, value[0]), _number(data, key, value[1])


def _metrics(data: dict[str, Any], key: str) -> MetricTable:
    """Return the accuracy metrics stored under a key of a calibration file."""
    groups = _table(data, key)
    return {
        name: {k: None if v is None else _number(table, k) for k, v in table.items()}
        for name in groups
        for table in [_table(groups, name)]
    }
