"""What can go wrong with an optimal path: there is none, or the solver did not find it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError


class InfeasibleError(InputError):
    """No path keeps all that is asked: proven by the solver for every final time that was tried.

    Final times between and beyond those are not looked at.

    Attributes
    ----------
    nearest
        The nearest end found that can be reached (3,), m, ENU; None where none was found.
    miss
        How far that is off, m.
    """

    def __init__(
        self,
        target: NDArray[np.float64],
        why: str,
        nearest: NDArray[np.float64] | None = None,
    ) -> None:
        self.nearest = nearest
        self.miss = np.inf if nearest is None else float(np.linalg.norm(nearest - target))
        remedy = ""
        if nearest is not None:
            at = ", ".join(f"{x:.1f}" for x in nearest)
            remedy = f"The nearest reachable end position found is ({at}), {self.miss:.1f} m away."
        super().__init__(
            "optimal.end_position",
            target.tolist(),
            f"must be reachable within thrust, tilt, glideslope and propellant ({why})",
            remedy,
        )

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return _again, (self.field, self.value, self.problem, self.remedy, self.nearest, self.miss)


def _again(
    field: str, value: object, problem: str, remedy: str, nearest: object, miss: float
) -> InfeasibleError:
    """Return an error as it was before it was sent to another process."""
    made = InfeasibleError.__new__(InfeasibleError)
    InputError.__init__(made, field, value, problem, remedy)
    made.nearest, made.miss = nearest, miss  # type: ignore[assignment]
    return made


class SolverError(RuntimeError):
    """The solver ended without an answer: whether there is a path is not known."""


class RelaxationError(SolverError):
    """The relaxed problem has an answer that the engine cannot fly: relaxing was not lossless.

    Whether there is a path is not known.
    """
