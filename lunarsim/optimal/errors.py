"""Errors of optimal planning: no feasible path, or no solution by the solver."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.typing import Array


class InfeasibleError(InputError):
    """Error: no feasible path exists, which is proven for every tried final time.

    Other final times are not examined.

    Attributes
    ----------
    nearest
        Nearest reachable end position found (3,), m, ENU; None if none was found.
    miss
        Distance of that position from the target, m; inf if none was found.
    """

    def __init__(
        self,
        target: Array,
        why: str,
        nearest: Array | None = None,
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
        return _restore, (
            self.field,
            self.value,
            self.problem,
            self.remedy,
            self.nearest,
            self.miss,
        )


def _restore(
    field: str, value: object, problem: str, remedy: str, nearest: object, miss: float
) -> InfeasibleError:
    """Restore an `InfeasibleError` after unpickling."""
    error = InfeasibleError.__new__(InfeasibleError)
    InputError.__init__(error, field, value, problem, remedy)
    error.nearest, error.miss = nearest, miss  # type: ignore[assignment]
    return error


class SolverError(RuntimeError):
    """Error: the solver ended without a solution, so that feasibility is unknown."""


class RelaxationError(SolverError):
    """Error: the solution of the relaxed problem violates the thrust limits.

    The convex relaxation of the thrust limits is not lossless in this case; feasibility is unknown.
    """
