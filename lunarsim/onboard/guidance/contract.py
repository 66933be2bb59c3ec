"""The contract of guidance laws, and the one object that says where a phase of flight ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhaseEnd:
    """Where a phase of flight ends, for one site or for many.

    What plans a path, what surveys paths to many sites and what flies one all take this object, so
    that the path flown is the one surveyed.

    Attributes
    ----------
    position
        Of the centre of mass (3,) or (n, 3), m.
    velocity, acceleration
        Wanted there (3,), m/s and m/s^2.
    frame
        Of all three: "local", where control lives; what is given in the site frame is moved by
        navigation's `site_to_local` first.

    Raises
    ------
    InputError
        If the frame is another.
    """

    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    acceleration: Array = field(default_factory=lambda: np.zeros(3))
    frame: Literal["local"] = "local"

    def __post_init__(self) -> None:
        if self.frame != "local":
            raise InputError("end.frame", self.frame, "'local'; navigation moves points to it")


def refuse_unknown(estimate: Estimate, end: PhaseEnd | None = None) -> None:
    """Refuse a state or an end that is no number.

    Raises
    ------
    InputError
        If position, velocity or mass, or the end's position or velocity is not finite.
    """
    told = [estimate.position, estimate.velocity]
    if end is not None:
        told += [end.position, end.velocity]
    if not (np.isfinite(estimate.mass) and all(np.isfinite(x).all() for x in told)):
        here = (estimate.position.tolist(), estimate.velocity.tolist(), estimate.mass)
        raise InputError("guidance.estimate", here, "finite coordinates and mass")


class GuidanceLaw(Protocol):
    """Anything that turns an estimate and the end of a phase into a thrust acceleration."""

    def command(self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2 (gravity already made up for).

        Parameters
        ----------
        estimate
            Where the lander is.
        end
            Of the phase, for one site.
        time, time_to_go
            Now, and what is left until the end is to be reached, s.
        """
        ...


@runtime_checkable
class PlansArrival(Protocol):
    """A law that chooses when it arrives, and reports what happens to it.

    Attributes
    ----------
    arrival
        When it means to be at the end of the phase, s; None: not known yet.
    events
        What happened so far: time (s), name, details.
    """

    arrival: float | None
    events: list[tuple[float, str, dict[str, Any]]]


@runtime_checkable
class SeesByMap(Protocol):
    """A law that plans by what is known of the ground.

    Attributes
    ----------
    belief
        Gives the map that decides as it stands, None for a lander without one: set by the computer.
    """

    belief: Callable[[], HazardMap | None] | None
