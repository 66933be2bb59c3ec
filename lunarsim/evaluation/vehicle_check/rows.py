"""Rows of the design check: required and available value, margin and status."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

Status = Literal["ok", "marginal", "violated"]
Sense = Literal["at least", "at most"]
AT_LEAST: Sense = "at least"
AT_MOST: Sense = "at most"

FORMAT = "lunarsim vehicle check 1"
# Factors from SI units to the units of rows.
_PER_SI_UNIT = {unit: math.degrees(1.0) for unit in ("deg", "deg/s", "deg/s^2")}


@dataclass(frozen=True)
class CheckRow:
    """One requirement of the mission on the lander, and what the lander has.

    Attributes
    ----------
    name
        Identifier of the check, for example "divert-rotation-time".
    subject
        Subject to which the check belongs, for example "attitude".
    quantity
        What is compared, in words.
    required, available
        Required value, and value of the design, in `unit`.
    unit
        Unit of both values; empty for ratios.
    sense
        Whether the available value must be at least or at most the required value.
    wanted_margin
        Relative margin from which the status is "ok".
    advice
        Sentence that states what happens if the check is violated, and which keys to change.
    """

    name: str
    subject: str
    quantity: str
    required: float
    available: float
    unit: str
    advice: str
    sense: Sense
    wanted_margin: float

    @property
    def margin(self) -> float:
        """Difference of both values over the required value; negative: violated.

        It is infinite if the required value is 0.
        """
        spare = self.available - self.required
        if self.sense == "at most":
            spare = -spare
        if self.required == 0.0:
            return math.copysign(math.inf, spare) if spare != 0.0 else 0.0
        return spare / abs(self.required)

    @property
    def status(self) -> Status:
        """Status: "violated" below a margin of 0, "ok" from the wanted margin."""
        if not self.margin >= -1e-9:  # NaN is a violation
            return "violated"
        return "ok" if self.margin >= self.wanted_margin - 1e-9 else "marginal"

    def as_dict(self) -> dict[str, Any]:
        """Return the row for a JSON file; numbers that are not finite become None."""
        values = {**vars(self), "margin": self.margin, "status": self.status}
        return {k: _finite(v) if isinstance(v, float) else v for k, v in values.items()}

    def as_warning(self) -> str:
        """Return the row as one sentence pair: status, values, and advice."""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.status}: {self.quantity} must be {self.sense} {format_value(self.required)}"
            f"{unit}, got {format_value(self.available)}{unit}. {self.advice}"
        )


@dataclass(frozen=True)
class VehicleCheck:
    """Result of the design check of a scenario's lander.

    Attributes
    ----------
    scenario
        Name of the scenario.
    rows
        Checks, in the order of their subjects.
    not_checked
        Sentences that name what was not checked, and why.
    """

    scenario: str
    rows: tuple[CheckRow, ...]
    not_checked: tuple[str, ...]

    def named(self, name: str) -> CheckRow:
        """Return the row with a name.

        Raises
        ------
        KeyError
            If no row has this name.
        """
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)

    def with_status(self, status: Status) -> tuple[CheckRow, ...]:
        """Return the rows with a status."""
        return tuple(row for row in self.rows if row.status == status)

    def as_dict(self) -> dict[str, Any]:
        """Return the result for a JSON file."""
        return {
            "format": FORMAT,
            "scenario": self.scenario,
            "violated": [row.name for row in self.with_status("violated")],
            "marginal": [row.name for row in self.with_status("marginal")],
            "rows": [row.as_dict() for row in self.rows],
            "not_checked": list(self.not_checked),
        }


class Found(NamedTuple):
    """Required and available value of a row, SI, and the words for its texts."""

    required: float
    available: float
    words: dict[str, Any]


def one(required: float, available: float, **words: Any) -> list[Found]:
    """Return both values of a check, SI, and the words for its texts, as one row."""
    return [Found(float(required), float(available), words)]


class Check(NamedTuple):
    """Declaration of a check. `{word}` in its texts stands for a word of `Found`.

    Attributes
    ----------
    name, subject, unit, sense, wanted_margin, quantity
        Values of the rows, as in `CheckRow`.
    advice
        What happens if the check is violated, and which keys to change.
    values
        Function of the `Mission` that returns the values of each row; none if the check does not
        apply.
    """

    name: str
    subject: str
    unit: str
    sense: Sense
    wanted_margin: float
    values: Callable[[Any], Iterable[Found]]
    quantity: str
    advice: str

    def rows(self, mission: Any) -> list[CheckRow]:
        """Return the rows of a mission."""
        scale, rows = _PER_SI_UNIT.get(self.unit, 1.0), []
        for required, available, words in self.values(mission):
            texts = (self.name, self.quantity, f"Otherwise {self.advice}.")
            name, quantity, advice = (t.format(torque=mission.torque_keys, **words) for t in texts)
            rows.append(CheckRow(
                name, self.subject, quantity, scale * required, scale * available, self.unit,
                advice, self.sense, self.wanted_margin,
            ))  # fmt: skip
        return rows


def format_value(value: float) -> str:
    """Return a number with three significant digits; an integer from 1000 on."""
    if math.isfinite(value) and abs(value) >= 1000.0:
        return f"{value:.0f}"
    return f"{value:.3g}"


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
