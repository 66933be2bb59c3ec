"""Error parameters of inertial units, shared by sensor and navigation filter."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity

_DEG, _HOUR, _G = math.pi / 180.0, 3600.0, 9.80665
_COMMON_UNITS = {
    "scale_factor": {"ppm": 1e-6},
    "misalignment": {"mrad": 1e-3, "arcsec": _DEG / 3600.0},
}
_GYROSCOPE_RATES = {"deg/h": _DEG / _HOUR, "deg/s": _DEG}
_ACCELERATIONS = {"ug": 1e-6 * _G, "mg": 1e-3 * _G}
# Units of datasheets that texts such as "0.5 deg/h" may use, by key, and their size in SI units.
GYROSCOPE_UNITS: dict[str, dict[str, float]] = _COMMON_UNITS | {
    "bias": _GYROSCOPE_RATES,
    "bias_instability": _GYROSCOPE_RATES,
    "random_walk": {"deg/sqrt(h)": _DEG / math.sqrt(_HOUR)},
    "quantum": {"arcsec": _DEG / 3600.0},
}
ACCELEROMETER_UNITS: dict[str, dict[str, float]] = _COMMON_UNITS | {
    "bias": _ACCELERATIONS,
    "bias_instability": _ACCELERATIONS,
    "random_walk": {"m/s/sqrt(h)": 1.0 / math.sqrt(_HOUR), "ug/sqrt(Hz)": 1e-6 * _G},
}
# Decimal number in a text with a unit.
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
# Maximum Allan deviation of a first-order Gauss-Markov process over its standard deviation, at an
# averaging time of 1.89 correlation times (IEEE Std 952, annex B.4.5).
_GAUSS_MARKOV_ALLAN_MAXIMUM = 0.617


def in_si_units(table: Any, units: Mapping[str, Mapping[str, float]]) -> Any:
    """Return a table of a triad with texts such as "0.5 deg/h" converted to numbers.

    `units` are the allowed units of each key and their size in SI units. Other values, and a table
    that is none, are returned unchanged.

    Raises
    ------
    InputError
        If a text is not a number and one of the units of its key.
    """
    if not isinstance(table, Mapping):
        return table
    return {key: _number(key, value, units.get(key, {})) for key, value in table.items()}


def _number(key: str, value: Any, units: Mapping[str, float]) -> Any:
    """Return a text with a number and one of the `units` as a number in SI units."""
    if not isinstance(value, str):
        return value
    number, _, unit = value.strip().partition(" ")
    # `float` also accepts underscores, digits of other scripts, and names such as "nan".
    if not _DECIMAL.fullmatch(number) or unit.strip() not in units:
        example = " or ".join(f"'0.5 {one}'" for one in units)
        remedy = f"Texts for this key: {example}." if units else ""
        raise InputError(
            key, value, "must be a number in SI units, or a text with a number and its unit", remedy
        )
    return float(number) * units[unit.strip()]


@dataclass(frozen=True)
class TriadErrors:
    """Error model of three gyroscopes (u = rad) or accelerometers (u = m/s).

    Attributes
    ----------
    bias
        Bias at power-on, 1 sigma per axis, u/s.
    random_walk
        White noise of the rate, u/sqrt(s): angle or velocity random walk (N of an Allan plot).
    bias_walk
        Random walk of the bias, u/s per sqrt(s): rate random walk (K of an Allan plot).
    bias_instability
        Minimum of the Allan deviation, u/s: a Gauss-Markov error of the bias whose Allan deviation
        has this maximum. Its correlation time is `correlation_time`.
    scale_factor
        Relative scale factor error, 1 sigma per axis.
    misalignment
        Misalignment of each axis towards each other axis, 1 sigma, rad.
    quantum
        Quantization step, u; 0: none. The remainder is carried to the next sample.
    correlation_time
        Correlation time of the bias instability, s.
    """

    bias: float = quantity(
        0.0,
        ge=0,
        help="bias at power-on, 1 sigma per axis (gyroscopes: rad/s; accelerometers: m/s^2)",
    )
    random_walk: float = quantity(
        0.0,
        ge=0,
        help="white noise: angle random walk of gyroscopes (rad/sqrt(s)), velocity random walk of "
        "accelerometers (m/s/sqrt(s))",
    )
    bias_walk: float = quantity(
        0.0,
        ge=0,
        help="random walk of the bias (gyroscopes: rad/s per sqrt(s); accelerometers: m/s^2 per "
        "sqrt(s))",
    )
    scale_factor: float = quantity(0.0, ge=0, help="relative scale factor error, 1 sigma per axis")
    misalignment: float = quantity(
        0.0,
        ge=0,
        help="angle (rad, 1 sigma) by which each measurement axis is tilted towards either of the "
        "other two axes",
    )
    quantum: float = quantity(
        0.0,
        ge=0,
        help="quantization step of the increment in each sample (gyroscopes: angle, rad; "
        "accelerometers: velocity, m/s); 0: none",
    )
    bias_instability: float = quantity(
        0.0,
        ge=0,
        help="bias instability, the minimum of the Allan deviation (gyroscopes: rad/s; "
        "accelerometers: m/s^2); 0: none",
    )
    correlation_time: float = quantity(
        300.0, "s", gt=0, help="correlation time of the bias instability (Gauss-Markov process)"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "imu")

    @property
    def instability_sigma(self) -> float:
        """Standard deviation of the Gauss-Markov bias error, u/s."""
        return self.bias_instability / _GAUSS_MARKOV_ALLAN_MAXIMUM

    @property
    def total_bias_sigma(self) -> float:
        """Standard deviation of the bias at power-on with its instability, u/s."""
        return math.hypot(self.bias, self.instability_sigma)

    @property
    def total_bias_walk(self) -> float:
        """Random walk of the bias with that of its instability, u/s per sqrt(s)."""
        return math.hypot(
            self.bias_walk, self.instability_sigma * math.sqrt(2.0 / self.correlation_time)
        )


# Tactical-grade unit: 1 deg/h, 0.1 deg/sqrt(h), 100 ppm; 300 micro-g, 0.05 m/s/sqrt(h), 200 ppm.
TACTICAL_GYROSCOPES = TriadErrors(4.8e-6, 2.9e-5, 1e-7, 1e-4, 1e-4, 1e-6)
TACTICAL_ACCELEROMETERS = TriadErrors(2.9e-3, 8e-4, 1e-5, 2e-4, 1e-4, 1e-4)
