"""A second-order cone program, and the two solvers that it is given to.

    minimise c x   subject to   A x = b,   G x + s = h,   s in the non-negative orthant x cones

QOCO (Chari and Acikmese 2025) is built once and updated: three to five times as fast here as
Clarabel from nothing (``scripts/bench.py optimal``). It knows no certificate of infeasibility, so
what it does not solve is given to Clarabel (Goulart and Chen 2024), which has one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import clarabel
import numpy as np
import qoco
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]
Status = Literal["solved", "infeasible", "unsolved", "failed"]

_WIDER = 1e-6  # cones that must be widened by more hold nothing: lengths are scaled to about 1


@dataclass(frozen=True)
class Program:
    """A cone program.

    Attributes
    ----------
    c, b, h
        Vectors.
    a, g
        Sparse matrices, CSC.
    orthant
        Number of rows of G that come first and ask for s >= 0.
    cones
        Dimensions of the second-order cones of the other rows, the first of a cone its bound.
    """

    c: Array
    a: Any
    b: Array
    g: Any
    h: Array
    orthant: int
    cones: tuple[int, ...]


@dataclass(frozen=True)
class Answer:
    """What a solver gave.

    Attributes
    ----------
    status
        "infeasible" is proven, "unsolved" one or the other of it and "failed".
    x, y, z
        Variables, multipliers of the equalities and of the cones.
    iterations
        Of the solver.
    solver
        Its name.
    """

    status: Status
    x: Array
    y: Array
    z: Array
    iterations: int
    solver: str


class Qoco:
    """A program kept in QOCO: what it holds is overwritten, its structure stays.

    Parameters
    ----------
    most
        Iterations after which it gives up.
    """

    def __init__(self, most: int = 60) -> None:
        self.most = most
        self._held: Any = None

    def solve(self, program: Program) -> Answer:
        """Return the answer to a program of the same structure as the first."""
        p = program
        if self._held is None:
            self._held = qoco.QOCO()
            self._held.setup(
                len(p.c), len(p.h), len(p.b), None, p.c, p.a, p.b, p.g, p.h, p.orthant,
                len(p.cones), np.array(p.cones), max_iters=self.most,
            )  # fmt: skip
        else:
            self._held.update_vector_data(p.c, p.b, p.h)
            self._held.update_matrix_data(None, None, p.g.data)
        got = self._held.solve()
        # What it calls inaccurate may be the best iterate of a program before.
        good = got.status == "QOCO_SOLVED" and bool(np.isfinite(got.x).all())
        status: Status = "solved" if good else "failed"
        x, y, z = (np.array(v, dtype=np.float64) for v in (got.x, got.y, got.z))
        if not good:
            # What a failed solve leaves behind may be no number: the next one begins anew.
            self._held = None
        return Answer(status, x, y, z, int(got.iters), "qoco")


class Clarabel:
    """Programs solved by Clarabel, each from nothing.

    Parameters
    ----------
    most
        Iterations after which it gives up.
    """

    def __init__(self, most: int = 100) -> None:
        self.most = most

    def solve(self, program: Program) -> Answer:
        """Return the answer to a program."""
        p = program
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads, settings.max_iter = False, 1, self.most
        cones = [clarabel.ZeroConeT(len(p.b)), clarabel.NonnegativeConeT(p.orthant)]
        cones += [clarabel.SecondOrderConeT(n) for n in p.cones]
        rows = sparse.vstack([p.a, p.g], format="csc")
        nothing = sparse.csc_matrix((len(p.c), len(p.c)))
        both = np.concatenate((p.b, p.h))
        got = clarabel.DefaultSolver(nothing, p.c, rows, both, cones, settings).solve()
        said = str(got.status)
        status: Status = "failed"
        if said in ("Solved", "AlmostSolved"):
            status = "solved"
        elif said == "PrimalInfeasible":
            status = "infeasible"
        split = len(p.b)
        multipliers = np.array(got.z, dtype=np.float64)
        x = np.array(got.x, dtype=np.float64)
        return Answer(
            status, x, multipliers[:split], multipliers[split:], int(got.iterations), "clarabel"
        )


def relaxed(program: Program) -> Program:
    """Return the program of the least t by which all cones have to be widened: t > 0 is infeasible.

    It has a solution whenever the equalities have one.
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


class Judged:
    """QOCO first; what it does not solve goes to Clarabel, which tells why.

    Where Clarabel has no certificate either, the least t of `relaxed` is asked for.

    Parameters
    ----------
    most
        Iterations after which QOCO gives up.

    Attributes
    ----------
    referred
        How many programs went to Clarabel.
    """

    def __init__(self, most: int = 40) -> None:
        self.fast, self.judge = Qoco(most), Clarabel()
        self.referred = 0

    def solve(self, program: Program) -> Answer:
        """Return the answer to a program of the same structure as the first."""
        answer = self.fast.solve(program)
        if answer.status == "solved":
            return answer
        self.referred += 1
        answer = self.judge.solve(program)
        if answer.status == "failed":
            wider = self.judge.solve(relaxed(program))
            if wider.status == "solved" and wider.x[-1] > _WIDER:
                answer = replace(answer, status="infeasible")
        return answer


class Unjudged:
    """QOCO alone: what it does not solve in so many iterations is "unsolved", whatever the reason.

    Parameters
    ----------
    most
        Iterations after which it gives up.
    """

    def __init__(self, most: int = 30) -> None:
        self.fast = Qoco(most)

    def solve(self, program: Program) -> Answer:
        """Return the answer to a program of the same structure as the first."""
        answer = self.fast.solve(program)
        return answer if answer.status == "solved" else replace(answer, status="unsolved")
