"""What fails on the true vehicle; its computer is not told.

Thrusters fail on a lander that has them, an engine sticks on any.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class Faults:
    """Thrusters that stay shut or open, and an engine that sticks; the computer is not told.

    Attributes
    ----------
    jets_shut, jets_open
        Numbers of the thrusters, from 0 in the order of their layout.
    jets_from
        From when on, s.
    engine_stuck_from
        From when on the throttle no longer moves, s; None: never.
    engine_stuck_at
        Thrust that it sticks at, N; None: what it was asked for last, from the start: first.
    """

    jets_shut: tuple[int, ...] = quantity((), ge=0, help="thrusters that stay shut")
    jets_open: tuple[int, ...] = quantity((), ge=0, help="thrusters that stay open")
    jets_from: float = quantity(0.0, "s", ge=0, help="from when on")
    engine_stuck_from: float | None = quantity(
        None, "s", ge=0, help="from when on the throttle does not move; left out: never"
    )
    engine_stuck_at: float | None = quantity(
        None, "N", ge=0, help="thrust that it sticks at; left out: what it was asked for last"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "faults")
        both = set(self.jets_shut) & set(self.jets_open)
        if both:
            raise InputError("faults.jets_open", self.jets_open, f"without {min(both)}: it is shut")
        if self.engine_stuck_at is not None and self.engine_stuck_from is None:
            raise InputError(
                "faults.engine_stuck_at", self.engine_stuck_at, "engine_stuck_from too"
            )

    def throttle(self, time: float, last: float | None, wanted: float) -> float:
        """Return what becomes of a thrust asked for at a time (s), N.

        `last` stood before; None: nothing was asked for yet.
        """
        if self.engine_stuck_from is None or time < self.engine_stuck_from:
            return wanted
        if self.engine_stuck_at is not None:
            return self.engine_stuck_at
        return wanted if last is None else last

    def check_plain(self) -> None:
        """Raise `InputError` if a lander without valves cannot fail so."""
        for name in ("jets_shut", "jets_open"):
            if getattr(self, name):
                raise InputError(
                    f"faults.{name}", getattr(self, name),
                    "left out, or a vehicle of kind 'jet-lander': no other has thrusters",
                )  # fmt: skip

    def check_engine(self, thrust_min: float, thrust_max: float) -> None:
        """Raise `InputError` if an engine of a throttle range (N) cannot stick so."""
        stuck = self.engine_stuck_at
        if stuck and not thrust_min <= stuck <= thrust_max:
            raise InputError(
                "faults.engine_stuck_at_n", stuck,
                f"0 or within the throttle range of {thrust_min} to {thrust_max} N",
            )  # fmt: skip

    def check_count(self, count: int) -> None:
        """Raise `InputError` if a thruster is named that a layout of `count` has not."""
        for name in ("jets_shut", "jets_open"):
            for number in getattr(self, name):
                if number >= count:
                    raise InputError(f"faults.{name}", number, f"a number below {count}")
