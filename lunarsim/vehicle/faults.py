"""Faults of the true vehicle, unknown to the onboard computer.

Thruster faults need a lander with thrusters; an engine fault is possible on every lander.
"""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class Faults:
    """Settings of stuck thrusters, a stuck throttle and lost engines.

    The faults are unknown to the onboard computer.

    Attributes
    ----------
    jets_stuck_shut, jets_stuck_open
        Indices of the thrusters, from 0 in the order of their layout.
    jets_stuck_from
        Start of the thruster faults, s.
    engine_stuck_from
        Time from which the throttle is stuck, s; None: never.
    engine_stuck_at
        Thrust of the stuck engine, N; None: the last commanded thrust, or the first if stuck from
        the start.
    engine_loss_from, engine_loss
        Time from which a fraction of the thrust is lost, s; None: never. The fraction.
    occurs
        Whether the faults occur; false is a flight without them.
    """

    jets_stuck_shut: tuple[int, ...] = quantity(
        (), ge=0, help="indices of the thrusters that are stuck shut, counted from 0; empty: none"
    )
    jets_stuck_open: tuple[int, ...] = quantity(
        (), ge=0, help="indices of the thrusters that are stuck open, counted from 0; empty: none"
    )
    jets_stuck_from: float = quantity(
        0.0, "s", ge=0, help="time in the flight at which the thruster faults begin"
    )
    engine_stuck_from: float | None = quantity(
        None,
        "s",
        ge=0,
        help="time in the flight from which the engine's throttle is stuck; omitted: never",
    )
    engine_stuck_at: float | None = quantity(
        None,
        "N",
        ge=0,
        help="thrust of the engine while its throttle is stuck; omitted: the last thrust before "
        "the fault",
    )

    engine_loss_from: float | None = quantity(
        None,
        "s",
        ge=0,
        help="time in the flight from which a fraction of the engine thrust is lost, as by a lost "
        "engine of several; omitted: never",
    )
    engine_loss: float = quantity(
        0.5, gt=0, le=1, help="fraction of the thrust lost from engine_loss_from_s; 0.5: one of two"
    )

    occurs: bool = quantity(
        True, help="whether the faults occur; campaigns and environments can draw it per flight"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "faults")
        both = set(self.jets_stuck_shut) & set(self.jets_stuck_open)
        if both:
            raise InputError(
                "faults.jets_stuck_open", self.jets_stuck_open,
                f"must not contain thruster {min(both)}, which is also in jets_stuck_shut",
            )  # fmt: skip
        if self.engine_stuck_at is not None and self.engine_stuck_from is None:
            raise InputError(
                "faults.engine_stuck_at",
                self.engine_stuck_at,
                "must be omitted unless engine_stuck_from_s is set",
            )

    def throttle(
        self, time: float, previous_setting: float | None, commanded_thrust: float
    ) -> float:
        """Return the throttle setting, N, for a commanded thrust, N, at a time, s.

        A stuck throttle keeps its `previous_setting`, N (None: no command yet), or the thrust set
        by `engine_stuck_at`.
        """
        if self.engine_stuck_from is None or time < self.engine_stuck_from:
            return commanded_thrust
        if self.engine_stuck_at is not None:
            return self.engine_stuck_at
        return commanded_thrust if previous_setting is None else previous_setting

    def delivered(self, time: float, thrust: float) -> float:
        """Return the thrust that the engines deliver, N.

        `time` is in s, and `thrust` the throttle setting, N.
        """
        lost = self.engine_loss_from is not None and time + 1e-9 >= self.engine_loss_from
        return thrust * (1.0 - self.engine_loss) if lost else thrust

    def check_plain(self) -> None:
        """Raise `InputError` if thruster faults are set for a lander without thrusters."""
        for name in ("jets_stuck_shut", "jets_stuck_open"):
            if getattr(self, name):
                raise InputError(
                    f"faults.{name}", getattr(self, name),
                    "must be empty for a vehicle without thrusters",
                    "Otherwise use a vehicle of kind 'jet-lander'.",
                )  # fmt: skip

    def check_engine(self, thrust_min: float, thrust_max: float) -> None:
        """Raise `InputError` if the stuck thrust is outside the throttle range (N)."""
        stuck = self.engine_stuck_at
        if stuck and not thrust_min <= stuck <= thrust_max:
            raise InputError(
                "faults.engine_stuck_at_n", stuck,
                f"must be 0, or between vehicle.thrust_min_n ({thrust_min}) and "
                f"vehicle.thrust_max_n ({thrust_max})",
            )  # fmt: skip

    def check_count(self, count: int) -> None:
        """Raise `InputError` if a thruster index is not below the number of thrusters."""
        for name in ("jets_stuck_shut", "jets_stuck_open"):
            for number in getattr(self, name):
                if number >= count:
                    raise InputError(
                        f"faults.{name}",
                        number,
                        f"must be less than {count}, the number of thrusters",
                    )
