"""Interfaces of guidance laws, and the definition of a phase's end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite


@dataclass(frozen=True)
class PhaseEnd:
    """Required state at the end of a flight phase, for one site or for many.

    Path planning, cost estimates for many sites and guidance use the same object, so that the flown
    path is the evaluated one.

    Attributes
    ----------
    position
        Position of the centre of mass (3,) or (n, 3), m.
    velocity, acceleration
        Required velocity and acceleration (3,), m/s and m/s^2.
    frame
        Frame of position, velocity and acceleration: "local", the frame of guidance and control.
        Navigation's `site_to_local` converts from the site frame.

    Raises
    ------
    InputError
        If the frame is not "local".
    """

    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    acceleration: Array = field(default_factory=lambda: np.zeros(3))
    frame: Literal["local"] = "local"

    def __post_init__(self) -> None:
        if self.frame != "local":
            raise InputError(
                "end.frame",
                self.frame,
                "must be 'local'",
                "Convert the end with the method site_to_local of the navigation.",
            )


def require_finite_state(estimate: Estimate, end: PhaseEnd | None = None) -> None:
    """Raise InputError if an estimated state or a phase end is not finite.

    Raises
    ------
    InputError
        If the state's position, velocity or mass, or the end's position or velocity is not finite.
    """
    for name in ("position", "velocity", "mass"):
        check_finite(f"guidance.estimate.{name}", getattr(estimate, name))
    if end is not None:
        for name in ("position", "velocity"):
            check_finite(f"guidance.end.{name}", getattr(end, name))


class GuidanceLaw(Protocol):
    """Guidance law: thrust acceleration from a state estimate and a phase end."""

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        It is thrust over mass, which includes the compensation of gravity.

        Parameters
        ----------
        estimate
            Estimated state.
        end
            Required state at the end of the phase, for one site.
        time, time_to_go
            Current time, and time until the phase end, s.
        """
        ...


@runtime_checkable
class PlansArrival(Protocol):
    """Guidance law that plans its arrival time and reports events.

    Attributes
    ----------
    arrival
        Planned time of arrival at the phase end, s; None: not known yet. The onboard computer sets
        it to None when the approach begins again after a hover; earlier plans are then invalid.
    events
        Events so far: time (s), name, details.
    """

    arrival: float | None
    events: list[tuple[float, str, dict[str, Any]]]


@runtime_checkable
class UsesHazardMap(Protocol):
    """Guidance law that plans with the current hazard map.

    Attributes
    ----------
    hazard_map_source
        Function set by the onboard computer. It returns the hazard map used for site decisions, or
        None if the lander has no map.
    """

    hazard_map_source: Callable[[], HazardMap | None] | None
