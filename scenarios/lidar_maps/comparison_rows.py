"""Format the results of the mapper comparison as table rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

MAPPERS = {
    "calibrated": "Gaussian DEM, calibrated",
    "level": "Gaussian DEM, Eqs. 15-17",
    "quadtree": "quadtree",
}
WorldResults = dict[str, Any]
TableRow = list[str]


def number_text(value: float | None, format_spec: str) -> str:
    """Format a number by a format specification; a dash for None or NaN."""
    return "-" if value is None or not math.isfinite(value) else format(value, format_spec)


def interval_text(limits: Sequence[float | None]) -> str:
    """Format a metric with its 95 % interval; `limits` are value, low and high."""
    value, low, high = (number_text(v, ".3f") for v in limits)
    return value if value == "-" else f"{value} [{low}, {high}]"


def landing_rows(world: WorldResults) -> list[TableRow]:
    """Return the table rows of landing results by map and policy for one terrain."""
    out = []
    for n, (way, f) in enumerate(world["landings"].items()):
        low, high = f["interval"]
        against = "" if n == 0 else f"{f['won']}, {f['lost']} ({f['p_value']:.2f})"
        out.append([
            way, str(f["flights"]), f"{f['landed'] / f['flights']:.2f} [{low:.2f}, {high:.2f}]",
            against, f"{f['divert_median_m']:.1f}", f"{f['propellant_median_kg']:.1f}",
        ])  # fmt: skip
    return out


def map_rows(world: WorldResults) -> list[TableRow]:
    """Return the table rows of map quality at the first and last decision, by mapper.

    The rows also contain computing time and memory.
    """
    out = []
    for mapper, f in world["maps"].items():
        entries = [(moment, q) for moment in ("first", "last") if (q := f[moment])]
        for n, (moment, q) in enumerate(entries):
            top = n == 0
            out.append([
                MAPPERS[mapper] if top else "", moment, interval_text(q["precision"]),
                interval_text(q["recall"]), f"{q['claimed']:.2f}", number_text(q["ece"], ".3f"),
                number_text(q["skill"], "+.2f"), f"{f['seconds']:.2f}" if top else "",
                f"{f['megabytes']:.1f}" if top else "",
            ])  # fmt: skip
    return out


def stratum_rows(world: WorldResults) -> list[TableRow]:
    """Return the table rows of map quality at the last decision, by terrain class."""
    last = {MAPPERS[mapper]: f["last"] for mapper, f in world["maps"].items() if f["last"]}
    strata = dict.fromkeys(name for q in last.values() for name in q["strata"])
    out = []
    for stratum in strata:
        entries = {m: s for m, q in last.items() if (s := q["strata"][stratum])["cells"]}
        for n, (mapper, s) in enumerate(entries.items()):
            out.append([
                stratum if n == 0 else "", mapper, number_text(s["safe"], ".3f") if n == 0 else "",
                interval_text(s["precision"]), interval_text(s["recall"]),
                number_text(s["skill"], "+.2f"),
            ])  # fmt: skip
    return out


ROWS: dict[str, Callable[[WorldResults], list[TableRow]]] = {
    "landings": landing_rows, "maps": map_rows, "strata": stratum_rows,
}  # fmt: skip
