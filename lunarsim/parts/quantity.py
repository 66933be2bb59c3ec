"""Settings of scenario components: default, unit, bounds and meaning in one place."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any

import numpy as np

from lunarsim.errors import InputError, check_types

# Suffix of the scenario key for each unit. Scenario files give angles in degrees.
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
    "rad/s^2": "_rad_s2",
    "N/m": "_n_m1",
    "N s/m": "_n_s_m1",
    "1/s": "_per_s",
}
_METADATA_KEY = "lunarsim"


@dataclass(frozen=True)
class Quantity:
    """Description of a scenario setting: default, unit, bounds and meaning.

    Attributes
    ----------
    default
        Default in the unit of the scenario file: angles in degrees.
    unit
        Unit of the scenario value; "" or "1" for a dimensionless number.
    gt, ge, lt, le
        Bounds of the scenario value, or of each of its elements.
    help
        Meaning in a few words.
    hidden
        Whether scenarios cannot set the field.
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
        """Suffix of the scenario key, such as ``_m``."""
        return _SUFFIXES[self.unit]

    @property
    def expected(self) -> str:
        """Bounds and unit in words, for error messages: "between 0 and 1 m"."""
        unit = "" if self.unit in ("", "1") else f" {self.unit}"

        def bound(value: float) -> str:
            return f"{value:g}{unit}" if value else "0"

        if self.ge is not None and self.le is not None:
            return f"between {self.ge:g} and {bound(self.le)}"
        limits = []
        if self.gt is not None:
            limits.append(f"above {bound(self.gt)}" if self.gt else "positive")
        if self.ge is not None:
            limits.append(f"{bound(self.ge)} or more")
        if self.lt is not None:
            limits.append(f"less than {bound(self.lt)}")
        if self.le is not None:
            limits.append(f"at most {bound(self.le)}")
        return " and ".join(limits) or "a finite number"

    def allows(self, value: float) -> bool:
        """Return whether a number in the scenario's unit is finite and within bounds."""
        return bool(
            np.isfinite(value)
            and (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.lt is None or value < self.lt)
            and (self.le is None or value <= self.le)
        )

    def to_si(self, value: Any) -> Any:
        """Convert a scenario value, or a tuple of values, to SI units and radians."""
        if self.unit in ("deg", "deg/s"):
            return _map_nested(lambda v: float(np.deg2rad(v)), value)
        if self.unit == "mrad":
            return _map_nested(lambda v: 1e-3 * v, value)
        return value

    def from_si(self, value: Any) -> Any:
        """Convert a value in SI units and radians to the unit of the scenario file.

        The default is returned exactly, without rounding errors.
        """
        if value == self.to_si(self.default):
            return self.default
        if self.unit in ("deg", "deg/s"):
            return _map_nested(lambda v: round(float(np.rad2deg(v)), 12), value)
        if self.unit == "mrad":
            return _map_nested(lambda v: 1e3 * v, value)
        return value


def _map_nested(function: Any, value: Any) -> Any:
    if isinstance(value, list | tuple):
        return tuple(_map_nested(function, v) for v in value)
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
    """Define a dataclass field that scenarios can set: default, unit, bounds, meaning.

    Parameters
    ----------
    default
        Default in the unit of the scenario file: ``quantity(10.0, "deg")`` is 0.1745 rad in the
        object.
    unit
        Unit of the default, which sets the suffix of the scenario key: ``quantity(0.2, "m")`` for
        a field ``posting`` gives the key ``posting_m``.
    gt, ge, lt, le
        Bounds of the value, or of each element of a sequence.
    help
        Meaning in a few words.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Limits:
    ...     altitude: float = quantity(50.0, "m", gt=0, help="minimum altitude of a divert")
    ...     tilt: float = quantity(10.0, "deg", ge=0, lt=90, help="maximum tilt")
    >>> Limits().altitude, round(Limits().tilt, 4)
    (50.0, 0.1745)
    """
    if unit not in _SUFFIXES:
        raise ValueError(f"unit: must be one of {', '.join(map(repr, _SUFFIXES))}, got {unit!r}.")
    q = Quantity(default, unit, gt, ge, lt, le, help)
    return field(default=q.to_si(default), metadata={_METADATA_KEY: q})


def hidden(default: Any) -> Any:
    """Define a dataclass field with a default that scenarios cannot set.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class FirstCome:
    ...     name: str = hidden("first-come")
    >>> FirstCome().name
    'first-come'
    """
    return field(default=default, metadata={_METADATA_KEY: Quantity(default, hidden=True)})


def quantity_of(metadata: Any) -> Quantity | None:
    """Return the description of a setting from the metadata of its dataclass field.

    None if the field was not defined by `quantity` or `hidden`.
    """
    found = metadata.get(_METADATA_KEY)
    return found if isinstance(found, Quantity) else None


def check_direction(field: str, vector: Any) -> None:
    """Raise InputError unless a value is a unit vector (3,).

    Raises
    ------
    InputError
        If `vector` is not a unit vector; the error names `field`.
    """
    if np.shape(vector) != (3,) or not np.isclose(np.linalg.norm(vector), 1.0, atol=1e-6):
        raise InputError(field, vector, "must be a unit vector of three numbers")


def check_bounds(part: Any, table: str) -> None:
    """Raise InputError if a number of a dataclass violates the bounds of its field.

    Values of scenario files are checked earlier; this function also checks objects created in
    Python.

    Parameters
    ----------
    part
        Object of a dataclass whose fields are defined by `quantity`; angles in radians.
    table
        Prefix of the field name in the message.

    Raises
    ------
    InputError
        For the first invalid field; value and bounds are in the unit of the scenario.
    """
    for f in fields(part):
        q = quantity_of(f.metadata)
        value = getattr(part, f.name)
        if q is None or q.hidden or value is None:
            continue
        if str(f.type).startswith(("float", "int")) and isinstance(value, str | bytes):
            raise InputError(f"{table}.{f.name}", value, "must be a number")
        given = q.from_si(tuple(value) if isinstance(value, list | np.ndarray) else value)
        for i, one in enumerate(given if isinstance(given, tuple) else (given,)):
            if isinstance(one, Real) and not q.allows(float(one)):
                index = f"[{i}]" if isinstance(given, tuple) else ""
                expected = q.expected if np.isfinite(float(one)) else "finite"
                # Objects created in Python take angles in radians.
                si = {"deg": "rad", "deg/s": "rad/s", "mrad": "rad"}.get(q.unit)
                problem = f"must be {expected}"
                if si:
                    own = value[i] if isinstance(given, tuple) else value
                    problem += f", got {own:.6g} {si} ({one:.6g} {q.unit})"
                raise InputError(f"{table}.{f.name}{index}", one, problem, show_value=si is None)
    check_types(table, part)
