"""Second-order cone program and its two solvers.

    minimise c x   subject to   A x = b,   G x + s = h,   s in the non-negative orthant x cones

QOCO (Chari and Acikmese 2025) is set up once and then updated; it is three to five times as fast
here as Clarabel (``scripts/bench.py optimal``). It gives no certificate of infeasibility; programs
that it does not solve go to Clarabel (Goulart and Chen 2024), which gives one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import clarabel
import numpy as np
import qoco
from scipy import sparse

from lunarsim.typing import Array

Status = Literal["solved", "infeasible", "unsolved", "failed"]

_INFEASIBLE_WIDENING = (
    1e-6  # minimum widening of the cones that proves infeasibility; lengths are about 1
)


@dataclass(frozen=True)
class Program:
    """Data of a second-order cone program: minimise ``c x`` under linear constraints.

    The constraints are ``a x = b`` and ``g x + s = h``, with s in the cones.

    Attributes
    ----------
    c, b, h
        Cost vector, and right-hand sides of equalities and of cone constraints.
    a, g
        Sparse matrices (CSC) of equalities and of cone constraints.
    orthant
        Number of leading rows of `g` with s >= 0.
    cones
        Dimensions of the second-order cones of the other rows; the first row of a cone is its
        bound.
    """

    c: Array
    a: Any
    b: Array
    g: Any
    h: Array
    orthant: int
    cones: tuple[int, ...]


@dataclass(frozen=True)
class SolverResult:
    """Solution and status of a second-order cone program.

    Attributes
    ----------
    status
        "solved"; "infeasible": proven to have no solution; "unsolved": either infeasible or failed;
        "failed": the solver ended without a result.
    x, y, z
        Variables, multipliers of the equalities, and multipliers of the cone constraints.
    iterations
        Number of iterations of the solver.
    solver
        Name of the solver.
    """

    status: Status
    x: Array
    y: Array
    z: Array
    iterations: int
    solver: str


class QocoSolver:
    """Solver QOCO for cone programs of one structure; only its data are updated.

    Parameters
    ----------
    max_iterations
        Maximum number of iterations.
    """

    def __init__(self, max_iterations: int = 60) -> None:
        self.max_iterations = max_iterations
        self._solver: Any = None

    def solve(self, program: Program) -> SolverResult:
        """Solve a cone program with the same sparsity pattern and cones as the first one.

        The status of the result is "solved" or "failed".
        """
        p = program
        if self._solver is None:
            self._solver = qoco.QOCO()
            self._solver.setup(
                len(p.c), len(p.h), len(p.b), None, p.c, p.a, p.b, p.g, p.h, p.orthant,
                len(p.cones), np.array(p.cones), max_iters=self.max_iterations,
            )  # fmt: skip
        else:
            self._solver.update_vector_data(p.c, p.b, p.h)
            self._solver.update_matrix_data(None, None, p.g.data)
        result = self._solver.solve()
        # An "inaccurate" result may be the best iterate of a previous program.
        is_solved = result.status == "QOCO_SOLVED" and bool(np.isfinite(result.x).all())
        status: Status = "solved" if is_solved else "failed"
        x, y, z = (np.array(v, dtype=np.float64) for v in (result.x, result.y, result.z))
        if not is_solved:
            # A failed solve may leave NaN behind: set up again.
            self._solver = None
        return SolverResult(status, x, y, z, int(result.iters), "qoco")


class ClarabelSolver:
    """Solver Clarabel for cone programs, without a warm start.

    Parameters
    ----------
    max_iterations
        Maximum number of iterations.
    """

    def __init__(self, max_iterations: int = 100) -> None:
        self.max_iterations = max_iterations

    def solve(self, program: Program) -> SolverResult:
        """Solve a cone program and return its solution, or a proof of infeasibility.

        The status of the result is "solved", "infeasible" or "failed".
        """
        p = program
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads, settings.max_iter = False, 1, self.max_iterations
        cones = [clarabel.ZeroConeT(len(p.b)), clarabel.NonnegativeConeT(p.orthant)]
        cones += [clarabel.SecondOrderConeT(n) for n in p.cones]
        rows = sparse.vstack([p.a, p.g], format="csc")
        nothing = sparse.csc_matrix((len(p.c), len(p.c)))
        both = np.concatenate((p.b, p.h))
        result = clarabel.DefaultSolver(nothing, p.c, rows, both, cones, settings).solve()
        solver_status = str(result.status)
        status: Status = "failed"
        if solver_status in ("Solved", "AlmostSolved"):
            status = "solved"
        elif solver_status == "PrimalInfeasible":
            status = "infeasible"
        split = len(p.b)
        multipliers = np.array(result.z, dtype=np.float64)
        x = np.array(result.x, dtype=np.float64)
        return SolverResult(
            status, x, multipliers[:split], multipliers[split:], int(result.iterations), "clarabel"
        )


def widening_program(program: Program) -> Program:
    """Return the program that finds the minimum widening of the cones of a program.

    It tests feasibility: the given program is infeasible if this minimum is positive. The last
    variable t >= -1 widens all cones: ``s + t`` replaces s in their bounds. The new program has a
    solution if the equalities of the given program have one.
    """
    p = program
    first = p.orthant + np.concatenate(([0], np.cumsum(p.cones)[:-1])).astype(np.int64)
    wide = np.zeros(len(p.h))
    wide[: p.orthant] = 1.0
    wide[first[: len(p.cones)]] = 1.0
    column = sparse.csc_matrix(-wide[:, None])
    floor = sparse.csc_matrix(([-1.0], ([0], [len(p.c)])), shape=(1, len(p.c) + 1))
    g = sparse.vstack([floor, sparse.hstack([p.g, column])], format="csc")
    a = sparse.hstack([p.a, sparse.csc_matrix((len(p.b), 1))], format="csc")
    c = np.concatenate((np.zeros(len(p.c)), [1.0]))
    return Program(c, a, p.b, g, np.concatenate(([1.0], p.h)), p.orthant + 1, p.cones)


class FallbackSolver:
    """Solver for cone programs: QOCO, then Clarabel if QOCO does not find a solution.

    If Clarabel neither solves a program nor proves it infeasible, the minimum widening of the cones
    (`widening_program`) decides whether the program is infeasible.

    Parameters
    ----------
    max_iterations
        Maximum number of iterations of QOCO.

    Attributes
    ----------
    fallback_count
        Number of programs that went to Clarabel.
    """

    def __init__(self, max_iterations: int = 40) -> None:
        self.fast, self.fallback = QocoSolver(max_iterations), ClarabelSolver()
        self.fallback_count = 0

    def solve(self, program: Program) -> SolverResult:
        """Solve a cone program with the same sparsity pattern and cones as the first one.

        The status of the result is "solved", "infeasible" or "failed".
        """
        answer = self.fast.solve(program)
        if answer.status == "solved":
            return answer
        self.fallback_count += 1
        answer = self.fallback.solve(program)
        if answer.status == "failed":
            wider = self.fallback.solve(widening_program(program))
            if wider.status == "solved" and wider.x[-1] > _INFEASIBLE_WIDENING:
                answer = replace(answer, status="infeasible")
        return answer


class QocoOnlySolver:
    """Solver of cone programs that uses QOCO alone.

    QOCO cannot prove infeasibility: each program that it does not solve, infeasible or not, has the
    status "unsolved".

    Parameters
    ----------
    max_iterations
        Maximum number of iterations.
    """

    def __init__(self, max_iterations: int = 30) -> None:
        self.fast = QocoSolver(max_iterations)

    def solve(self, program: Program) -> SolverResult:
        """Solve a cone program with the same sparsity pattern and cones as the first one.

        The status of the result is "solved" or "unsolved".
        """
        answer = self.fast.solve(program)
        return answer if answer.status == "solved" else replace(answer, status="unsolved")
