"""Fields of parts: default, unit, bounds and meaning in one place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

# Unit to the ending of the scenario's key. Radians are degrees in scenarios.
_SUFFIXES = {
    "": "",
    "1": "",
    "m": "_m",
    "s": "_s",
    "kg": "_kg",
    "N": "_n",
    "m/s": "_m_s",
    "m/s^2": "_m_s2",
    "m/s^3": "_m_s3",
    "m/s^4": "_m_s4",
    "m^2": "_m2",
    "1/m^2": "_per_m2",
    "Hz": "_hz",
    "deg": "_deg",
    "deg/s": "_deg_s",
    "mrad": "_mrad",
    "N m": "_n_m",
    "kg m^2": "_kg_m2",
    "px": "_px",
    "e-": "_electrons",
    "e-/s": "_electrons_s",
    "rad/s": "_rad_s",
    "1/s": "_per_s",
}
_KEY = "lunarsim"


@dataclass(frozen=True)
class Quantity:
    """What a field says of itself.

    Attributes
    ----------
    default
        As a scenario file would give it: angles in degrees.
    unit
        Of the scenario's value; "" or "1" for a number without one.
    gt, ge, lt, le
        Bounds of the scenario's value, or of each of its elements.
    help
        Meaning in a few words.
    hidden
        Not to be set from a scenario.
    """

    default: Any
    unit: str = ""
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    help: str = ""
    hidden: bool = False

    @property
    def suffix(self) -> str:
        """Ending of the scenario's key."""
        return _SUFFIXES[self.unit]

    def to_si(self, value: Any) -> Any:
        """Return the scenario's value as the part wants it: angles in radians."""
        if self.unit in ("deg", "deg/s"):
            return _each(lambda v: float(np.deg2rad(v)), value)
        if self.unit == "mrad":
            return _each(lambda v: 1e-3 * v, value)
        return value

    def from_si(self, value: Any) -> Any:
        """Return a part's value as a scenario would give it; the default itself for the default."""
        if value == self.to_si(self.default):
            return self.default
        if self.unit in ("deg", "deg/s"):
            return _each(lambda v: round(float(np.rad2deg(v)), 12), value)
        if self.unit == "mrad":
            return _each(lambda v: 1e3 * v, value)
        return value


def _each(function: Any, value: Any) -> Any:
    if isinstance(value, list | tuple):
        return tuple(_each(function, v) for v in value)
    return None if value is None else function(value)


def quantity(
    default: Any,
    unit: str = "",
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    help: str = "",
) -> Any:
    """Return a dataclass field that says default, unit, bounds and meaning of a setting.

    Parameters
    ----------
    default
        As a scenario file would give it: ``quantity(10.0, "deg")`` is 0.1745 rad in the object.
    unit
        Of that value; it ends the scenario's key: ``quantity(0.2, "m")`` of a field ``posting`` is
        ``posting_m``.
    gt, ge, lt, le
        Bounds, of each element where there are several.
    help
        Meaning in a few words.
    """
    if unit not in _SUFFIXES:
        raise ValueError(f"unit {unit!r}: known are {', '.join(map(repr, _SUFFIXES))}")
    q = Quantity(default, unit, gt, ge, lt, le, help)
    return field(default=q.to_si(default), metadata={_KEY: q})


def hidden(default: Any) -> Any:
    """Return a dataclass field that scenarios cannot set."""
    return field(default=default, metadata={_KEY: Quantity(default, hidden=True)})


def quantity_of(metadata: Any) -> Quantity | None:
    """Return what a field says of itself, None for a plain one."""
    found = metadata.get(_KEY)
    return found if isinstance(found, Quantity) else None
