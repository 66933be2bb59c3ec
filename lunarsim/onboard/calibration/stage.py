"""Last stages of a calibration: they scale and shift log odds of safety."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.onboard.calibration.calibration_files import CalibrationTable, check_number
from lunarsim.onboard.calibration.logistic import Logistic
from lunarsim.typing import Array, BoolArray


@dataclass(frozen=True)
class StageWeights:
    """Weights of a last stage: all except the intercept are non-negative.

    Attributes
    ----------
    intercept, slope
        Weights of 1 and of the log odds; the defaults do not change the log odds.

    Raises
    ------
    InputError
        If a weight is not a finite number, or a weight other than `intercept` is negative.
    """

    intercept: float = 0.0
    slope: float = 1.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = check_number(f.name, getattr(self, f.name))
            if f.name != "intercept" and value < 0.0:
                raise InputError(
                    f"calibration.{f.name}", value, "must be 0 or more",
                    "A negative weight would make a site less safe if an input map is safer.",
                )  # fmt: skip


class CalibrationStage(StageWeights):
    """Last stage of the safety calibration of one map.

    The probability is ``expit(intercept + slope * log_odds)``, where the log odds are those of the
    regression supplied with lunarsim.
    """

    @classmethod
    def fit(cls, log_odds: Array, safe: BoolArray) -> CalibrationStage:
        """Fit the last stage of the calibration to safe and unsafe sites (n,).

        `log_odds` are from the regression; the fit is by maximum likelihood.
        """
        x = np.column_stack((np.ones_like(log_odds), log_odds))
        return cls(*Logistic.fit(x, safe, rising=1).weights)

    @classmethod
    def parsed(cls, table: CalibrationTable) -> CalibrationStage:
        """Return the stage stored in a table of a calibration file."""
        return cls(table.number("intercept"), table.number("slope"))

    def probability(self, log_odds: Array) -> Array:
        """Return the probability of safety (n,) from the log odds of the regression (n,)."""
        return np.asarray(expit(self.intercept + self.slope * log_odds))
