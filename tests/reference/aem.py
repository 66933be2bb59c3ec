"""Plain reader of a CCSDS AEM in keyword-value notation, from the standard alone."""

from __future__ import annotations

from datetime import datetime


def read_aem(text):
    """Return keywords, and rows of seconds since the first state with four numbers."""
    keywords, rows, in_data = {}, [], False
    for line in map(str.strip, text.splitlines()):
        if not line or line.startswith("COMMENT"):
            continue
        if line in ("DATA_START", "DATA_STOP"):
            in_data = line == "DATA_START"
        elif in_data:
            date, *numbers = line.split()
            rows.append((date, [float(n) for n in numbers]))
        elif "=" in line:
            key, value = (part.strip() for part in line.split("=", 1))
            keywords[key] = value
    start = _seconds(keywords["START_TIME"])
    return keywords, [[_seconds(date) - start, *numbers] for date, numbers in rows]


def _seconds(date):
    whole, _, fraction = date.partition(".")
    since = datetime.fromisoformat(whole) - datetime(2000, 1, 1)
    return since.total_seconds() + float(f"0.{fraction or 0}")
