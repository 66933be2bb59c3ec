"""The last stage of the Gaussian DEM's calibration, fitted to one scenario's own flights.

The packaged regression was fitted to a matrix of worlds. Where a scenario's own differ from these,
its log odds are stretched and shifted to how often sites are safe there: once for sites in the
regression's domain, and once for those outside of it, where it was never fitted. A stretch is never
negative, and outside the lower of both holds, so that worse ground is never called safer.
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

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.parts.quantity import quantity_of
from lunarsim.safety.domain import Domain
from lunarsim.safety.ensemble import Ensemble
from lunarsim.safety.logistic import Logistic
from lunarsim.whole_files import read_tagged, write_text_whole

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Figures = Mapping[str, Mapping[str, float | None]]

# What the safety of a site depends on.
_LANDER = ("legs", "leg_radius", "pad_diameter", "slope_limit", "roughness_limit")
_FORMAT = "lunarsim scenario calibration 1"
_COMMAND = "`lunarsim calibrate` writes such files"
_ADVICE = "fit it anew with `lunarsim calibrate`, or leave the calibration out"


# So many sites of either kind, at least, make a stage.
LEAST_SITES = 20


@dataclass(frozen=True)
class Stage:
    """``p = expit(intercept + slope * log_odds)``.

    Attributes
    ----------
    intercept, slope
        Of the log odds that the packaged regression gives; left out, they stay as they are.

    Raises
    ------
    InputError
        If a number is not finite, or `slope` negative.
    """

    intercept: float = 0.0
    slope: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.intercept):
            raise InputError("calibration.intercept", self.intercept, "a finite number")
        if not (np.isfinite(self.slope) and self.slope >= 0.0):
            raise InputError(
                "calibration.slope", self.slope,
                "a finite number, at least 0: better evidence never makes a site less safe",
            )  # fmt: skip

    @classmethod
    def fit(cls, log_odds: Array, safe: BoolArray) -> Stage:
        """Fit to sites (n,) by maximum likelihood; some are safe and some are not."""
        x = np.column_stack((np.ones_like(log_odds), log_odds))
        return cls(*Logistic.fit(x, safe, rising=1).weights)

    def probability(self, log_odds: Array) -> Array:
        """Return the probability of sites (n,)."""
        return np.asarray(expit(self.intercept + self.slope * log_odds))


@dataclass(frozen=True)
class ScenarioCalibration:
    """The last stage of the calibration, and what it was fitted to.

    Attributes
    ----------
    inside, outside
        Stage for sites in the domain of the packaged regression, and for others; for these the
        lower of both holds.
    domain
        Of the sites of the fit.
    lander
        Figures of the lander that sites were judged for, by key and unit of `[vehicle]`.
    regression
        `Ensemble.digest` of the regressions before it.
    scenario, mapper
        Names.
    flights, sites, seed
        Numbers of flights and sites of the fit, and root seed.
    before, after
        How good the packaged probability and this one are on the scenario's sites in either domain:
        each flight judged by a fit to the others. None: there is no such figure.
    """

    inside: Stage
    outside: Stage
    domain: Domain
    lander: Mapping[str, float]
    regression: str
    scenario: str = ""
    mapper: str = ""
    flights: int = 0
    sites: int = 0
    seed: int = 0
    before: Figures = field(default_factory=dict)
    after: Figures = field(default_factory=dict)

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

        Where too few sites of either kind lie in the regression's domain, its probabilities stay as
        they are there; where too few lie outside, the same stage serves for both.

        Parameters
        ----------
        log_odds, safe, known
            By the regression, whether safe exactly, and whether in the regression's domain, of
            sites in `domain` (n,).
        domain
            Where they lie.
        lander, model
            Whose safety it is, and the regression.

        Raises
        ------
        InputError
            If there are too few on either side.
        """
        fits = [
            Stage.fit(log_odds[of], safe[of]) if enough(safe[of]) else None
            for of in (known, ~known)
        ]
        if fits == [None, None]:
            raise InputError("sites", len(safe), f"{LEAST_SITES} safe and {LEAST_SITES} unsafe")
        inside = fits[0] or Stage()
        return cls(inside, fits[1] or inside, domain, lander_figures(lander), model.digest)

    def probability(self, log_odds: Array, known: BoolArray) -> Array:
        """Return the probability of sites (n,).

        Parameters
        ----------
        log_odds
            By the regression (n,).
        known
            Which lie in the domain of the regression (n,).
        """
        p = self.inside.probability(log_odds)
        return np.where(known, p, np.minimum(p, self.outside.probability(log_odds)))

    def check(self, lander: Lander, model: Ensemble) -> None:
        """Refuse another lander, and another regression.

        Raises
        ------
        InputError
            Naming the key of `[vehicle]` that differs, or the regression.
        """
        self.check_regression(model)
        for key, value in lander_figures(lander).items():
            if not np.isclose(value, self.lander[key], rtol=1e-9, atol=0.0):
                raise InputError(
                    f"vehicle.{key}", value,
                    f"{self.lander[key]:g}, for which the calibration of {self.scenario!r} was "
                    f"fitted; {_ADVICE}",
                )  # fmt: skip

    def check_regression(self, model: Ensemble) -> None:
        """Raise `InputError` for another regression than that of the fit."""
        if model.digest != self.regression:
            raise InputError(
                "calibration.regression", self.regression,
                f"{model.digest}, the regression of this version; {_ADVICE}",
            )  # fmt: skip

    # --- files ----------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write as JSON, whole or not at all.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        data = {"format": _FORMAT, **asdict(self)}
        text = json.dumps(data, indent=1, allow_nan=False) + "\n"
        write_text_whole(path, text)

    @classmethod
    def load(cls, path: Path) -> ScenarioCalibration:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, is another one, or a number in it will not do.
        """
        data = read_tagged(path, "calibration", _FORMAT, f"; {_COMMAND}")
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
            lander={key: _number(lander, key) for key in lander_figures(Lander())},
            before=_figures(data, "before"),
            after=_figures(data, "after"),
            **texts,
            **counts,
        )  # fmt: skip


def enough(safe: BoolArray) -> bool:
    """Tell whether there are enough sites (n,) of both kinds to fit a stage to."""
    return bool(min(safe.sum(), (~safe).sum()) >= LEAST_SITES)


def lander_figures(lander: Lander) -> dict[str, float]:
    """Return what the safety of a site depends on, by key and in the unit of `[vehicle]`."""
    found = {}
    for f in fields(lander):
        if f.name in _LANDER:
            q = quantity_of(f.metadata)
            value = getattr(lander, f.name)
            found[f.name + (q.suffix if q else "")] = float(q.from_si(value) if q else value)
    return found


def _entry(data: dict[str, Any], key: str, kind: type) -> Any:
    if key not in data:
        raise InputError("calibration", key, f"an entry of that name; {_COMMAND}")
    value = data[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        words = {str: "a text", int: "a whole number", dict: "a table"}
        raise InputError(f"calibration.{key}", value, words[kind])
    return value


def _table(data: dict[str, Any], key: str) -> dict[str, Any]:
    found: dict[str, Any] = _entry(data, key, dict)
    return found


def _number(data: dict[str, Any], key: str, value: Any = None) -> float:
    """Return the finite number of a key, or `value` in its place."""
    if value is None:
        if key not in data:
            raise InputError("calibration", key, f"an entry of that name; {_COMMAND}")
        value = data[key]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and abs(value) <= sys.float_info.max):  # NaN is not
        raise InputError(f"calibration.{key}", value, "a finite number")
    return float(value)


def _stage(data: dict[str, Any], key: str) -> Stage:
    table = _table(data, key)
    return Stage(_number(table, "intercept"), _number(table, "slope"))


def _range(data: dict[str, Any], key: str) -> tuple[float, float]:
    value = data.get(key)
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"calibration.{key}", value, "a list of a least and a greatest number")
    return _number(data, key, value[0]), _number(data, key, value[1])


def _figures(data: dict[str, Any], key: str) -> Figures:
    groups = _table(data, key)
    return {
        name: {k: None if v is None else _number(table, k) for k, v in table.items()}
        for name in groups
        for table in [_table(groups, name)]
    }
