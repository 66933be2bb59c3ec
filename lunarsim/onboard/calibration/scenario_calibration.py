"""Last stage of the Gaussian DEM's calibration, fitted to one scenario.

The packaged regression was fitted to a set of worlds. For a scenario that differs from these, its
log odds are scaled and shifted to the observed frequencies: once for sites in the regression's
domain, and once for sites outside, where it was never fitted. The scale is non-negative, and
outside the domain the lower of both results is used, so that worse terrain never has a higher
probability.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibration_files import (
    CalibrationTable,
    StoredCalibration,
    check_number,
)
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.stage import CalibrationStage
from lunarsim.parts.quantity import quantity_of
from lunarsim.typing import Array, BoolArray

MetricTable = Mapping[str, Mapping[str, float | None]]

# Fields of the lander that affect the safety of a site.
_LANDER = ("legs", "leg_radius", "pad_diameter", "slope_limit", "roughness_limit")
_REFIT_REMEDY = (
    "Set it to the value of the calibration file, make a new calibration file with `lunarsim "
    "calibrate`, or delete the mapper's key calibration."
)


# Minimum number of safe and of unsafe sites for fitting a stage.
MIN_SITES_PER_CLASS = 20


@dataclass(frozen=True)
class ScenarioCalibration(StoredCalibration):
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

    file_format = "lunarsim scenario calibration 1"
    writer = "`lunarsim calibrate`"

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
        """Raise an `InputError` if the regression differs from the regression of the fit."""
        if model.digest != self.regression:
            raise InputError(
                "calibration.regression", self.regression,
                f"must be {model.digest}, the regression of this version of lunarsim",
                _REFIT_REMEDY,
            )  # fmt: skip

    @classmethod
    def _parsed(cls, table: CalibrationTable) -> ScenarioCalibration:
        lander = table.table("lander")
        return cls(
            inside=CalibrationStage.parsed(table.table("inside")),
            outside=CalibrationStage.parsed(table.table("outside")),
            domain=CalibrationDomain.parsed(table.table("domain")),
            lander={key: lander.number(key) for key in lander_safety_params(Lander())},
            before=_metrics(table.table("before")),
            after=_metrics(table.table("after")),
            **{key: table.value(key, str) for key in ("regression", "scenario", "mapper")},
            **{key: table.value(key, int) for key in ("flights", "sites", "seed")},
        )


def has_enough_sites(safe: BoolArray) -> bool:
    """Return whether `safe` (n,) has enough safe and unsafe sites to fit a stage.

    At least 20 of each are needed.
    """
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


def _metrics(groups: CalibrationTable) -> MetricTable:
    """Return the accuracy metrics stored in a table of a calibration file."""
    return {
        name: {
            k: None if v is None else check_number(k, v)
            for k, v in groups.value(name, dict).items()
        }
        for name in groups.data
    }
