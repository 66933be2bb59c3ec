"""Damages inputs on purpose, the same ones in every run."""

from __future__ import annotations

import copy
import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from lunarsim.errors import InputError, RenderingError

# Values that a damaged table has in place of its own.
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**64, -(2**63), 10**40, 0.0, -0.0, 5e-324, 1e308, -1e308,
    float("nan"), float("inf"), "", "x", "../../x", "/etc/passwd", "a:b", "\x00", "é\ud800",
    "9" * 50, [], {}, [None], [[]], {"": None}, {"kind": "x"}, [1.0, 2.0], [float("nan")] * 3,
)  # fmt: skip


def nested(depth: int) -> Any:
    """Return lists in each other."""
    found: Any = 1
    for _ in range(depth):
        found = [found]
    return found


def damaged_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with flipped bits, a part missing, doubled or overwritten, or none."""
    out, size = bytearray(data), len(data)
    at, length = int(rng.integers(size)), int(rng.integers(1, 64))
    match int(rng.integers(6)):
        case 0:
            out[at] ^= 1 << int(rng.integers(8))
        case 1:
            for place in rng.integers(size, size=16):
                out[place] ^= 1 << int(rng.integers(8))
        case 2:
            del out[at:]
        case 3:
            del out[at : at + length]
        case 4:
            out[at : at + length] = rng.bytes(length)
        case _:
            out[at:at] = data[at : at + length]
    return bytes(out)


def places(tables: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the steps to every value of nested tables."""
    items = tables.items() if isinstance(tables, dict) else enumerate(tables)
    for key, value in items:
        yield (*before, key)
        if isinstance(value, dict | list):
            yield from places(value, (*before, key))


def damaged_tables(tables: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return tables with a value that is gone, renamed, or of another type or size."""
    out: Any = copy.deepcopy(tables)
    known = list(places(out))
    for _ in range(int(rng.integers(1, 3))):
        *above, last = known[int(rng.integers(len(known)))]
        holder: Any = out
        try:
            for step in above:
                holder = holder[step]
            match int(rng.integers(5)):
                case 0:
                    del holder[last]
                case 1:
                    holder["renamed"] = holder.pop(last)
                case _:
                    holder[last] = ODD[int(rng.integers(len(ODD)))]
        except (KeyError, IndexError, TypeError, AttributeError):
            continue  # an earlier damage has taken the place away
    return dict(out)


def damaged_json(tables: dict[str, Any], rng: np.random.Generator) -> bytes:
    """Return the text of damaged tables; sometimes the text itself is damaged, or very deep."""
    draw = rng.random()
    if draw < 0.02:
        return b"[" * 100_000
    if draw < 0.04:
        return json.dumps(tables).replace(":", f": {'[' * 5000}", 1).encode()
    if draw < 0.25:
        return damaged_bytes(json.dumps(tables).encode(), rng)
    return json.dumps(damaged_tables(tables, rng)).encode()


class Hang(BaseException):
    """Too long: no `Exception`, which code that reads damaged files catches."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `Hang` if the inside takes longer."""

    def over(number: int, frame: Any) -> None:
        raise Hang(f"longer than {seconds:g} s")

    old = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def survives(read: Callable[[], Any], what: str) -> bool:
    """Return whether an input was accepted; fail on any error but the package's own."""
    try:
        with at_most(10.0):
            read()
    except (InputError, RenderingError):
        return False
    except BaseException as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
    return True
