"""Successive convexification: the same descent by a row of quadratic programs.

Motion and limits are replaced by their tangents at the last path, what they miss is taken up by
virtual controls at a high price, and steps are kept short by a quadratic price (penalised trust
region; Szmuk, Reynolds and Acikmese 2020). Limits are asked for after every step of an interval, by
their tangents there, so that they hold between the nodes (as the continuous-time form of Elango and
others 2024 has it, at points in place of an integral). The programs have one structure: built once
and updated, solved by QOCO.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import qoco
from numpy.typing import NDArray

from lunarsim.optimal.checks import count
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.six_dof.guess import Guess, guess_of
from lunarsim.optimal.six_dof.linearised import Point
from lunarsim.optimal.six_dof.path import RigidPath
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.six_dof.program import Filled, Layout
from lunarsim.optimal.six_dof.scale import Scale

Array = NDArray[np.float64]

# Prices of steps, against the mass at the end as a share of the start's: at first, and bounds.
_FIRST, _CHEAPEST, _DEAREST, _JOINING = 1e-5, 1e-5, 1e-1, 1e-2
# Of what a program foresees to gain, the share below which its path is not taken, and above which
# steps may be longer.
_POOR, _GOOD = 0.1, 0.5
# Gains are counted from the worst of so many last paths.
_MEMORY = 3
# Two paths burn alike when they differ by less than this share of the propellant, and are nearly
# joined when no interval ends farther than this from the next one's start, in units. Then a program
# with dear steps joins them, unless steps were dear before.
_SAVED, _NEAR, _LONG = 5e-4, 5e-3, 1e-4
# Joined: gaps, and limits passed in all, are no more than these.
_JOINED, _PASSED = 2e-5, 5e-3


class Successive:
    """Programs of one structure, kept and updated.

    Parameters
    ----------
    intervals
        N, of held thrust and torques.
    most
        Programs after which it gives up.

    Raises
    ------
    InputError
        If there are under 4 intervals, or no program.
    """

    def __init__(self, intervals: int = 30, most: int = 40) -> None:
        self.intervals, self.most = count("intervals", intervals, 4), count("most", most, 1)
        self._layout = Layout(self.intervals)
        self._held: Any = None

    def solve(self, descent: RigidDescent, guess: Guess | None = None) -> RigidPath:
        """Return the path of least propellant of a rigid body.

        Parameters
        ----------
        descent
            The problem.
        guess
            Where to begin; None: at the optimum of a point mass.

        Raises
        ------
        InfeasibleError
            If a point mass cannot land either.
        SolverError
            If a program has no solution, or the row of them does not settle.
        """
        n, begun = self.intervals, time.perf_counter()
        guess = guess_of(descent, n) if guess is None else guess.on(n)
        scale = Scale.of(descent, guess)
        x, v, total = scale.split(scale.start(guess), n)
        path, programs = self.settled(scale, Point.at(x, v, total / n, scale))
        states, controls, duration = scale.read(
            np.concatenate((path.x.ravel(), path.v.ravel(), [n * path.length])), n
        )
        return RigidPath(
            descent, duration, states, controls[:, 0], controls[:, 1:], programs,
            time.perf_counter() - begun,
        )  # fmt: skip

    def settled(self, scale: Scale, point: Point) -> tuple[Point, int]:
        """Return the path at which programs save no more, and how many there were."""
        price, joining = _FIRST, False
        merits = [point.merit]
        for programs in range(1, self.most + 1):
            program = self._layout.fill(scale, point, _JOINING if joining else price)
            z = self._solved(program)
            if z is None:
                price, joining = 6.0 * price, False
                continue
            new = Point.at(*self._layout.read(z, point.x[0]), scale)
            if joining and new.apart < _JOINED and new.passed < _PASSED:
                return new, programs
            bar = max(merits[-_MEMORY:])
            foreseen = bar - new.burnt
            ratio = (bar - new.merit) / max(foreseen, 1e-12)
            if not joining and ratio < _POOR and foreseen > 0.0:
                price = min(6.0 * price, _DEAREST)
                joining = price > _LONG and point.apart < _NEAR
                continue
            settles = abs(new.burnt - point.burnt) < _SAVED * new.burnt and new.apart < _NEAR
            joining = settles and (joining or price <= _LONG)
            if ratio > _GOOD:
                price = max(price / 3.0, _CHEAPEST)
            point = new
            merits.append(new.merit)
        raise SolverError(
            f"not settled in {self.most} programs: intervals {point.apart:.1e} apart, limits "
            f"passed by {point.passed:.1e}"
        )

    def _solved(self, filled: Filled) -> Array | None:
        """Return the variables of a program; None if QOCO fails."""
        f = filled
        if self._held is None:
            self._held = qoco.QOCO()
            self._held.setup(
                len(f.c), len(f.h), len(f.b), f.p, f.c, f.a, f.b, f.g, f.h, len(f.h), 0,
                np.zeros(0, dtype=np.int32), max_iters=100,
            )  # fmt: skip
        else:
            self._held.update_vector_data(f.c, f.b, f.h)
            self._held.update_matrix_data(f.p.data, f.a.data, f.g.data)
        got = self._held.solve()
        x = np.array(got.x, dtype=np.float64)
        if not str(got.status).startswith("QOCO_SOLVED") or not np.isfinite(x).all():
            self._held = None  # what a failed solve leaves behind may be no number
            return None
        return x
