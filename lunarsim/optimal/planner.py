"""Minimum-propellant or minimum-landing-error paths of a given final time."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from lunarsim.errors import InputError
from lunarsim.optimal.cone_program import FallbackSolver, Program, SolverResult
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.path import OptimalPath
from lunarsim.optimal.path_reconstruction import build_path
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.transcription import HalfSpaces, ProgramStructure, Transcription
from lunarsim.optimal.validation import LARGEST, check_count, check_numbers, is_number
from lunarsim.typing import Array

# exp(-z) is linearised: a relative mass error of this size causes a thrust error of 2e-4.
_MAX_LOG_MASS_ERROR = 0.02


class ConeSolver(Protocol):
    """Interface of solvers for second-order cone programs of one structure."""

    def solve(self, program: Program) -> SolverResult:
        """Solve a second-order cone program."""
        ...


class Planner:
    """Compute optimal descent paths of a given final time by cone programs.

    Programs with a known structure are updated instead of built.

    Parameters
    ----------
    intervals
        Number of intervals of the paths, N.
    solver
        Class of the solver; each structure gets one instance.

    Raises
    ------
    InputError
        If the number of intervals is not an integer of at least 4.

    Attributes
    ----------
    solves, iterations
        Total numbers of solved programs and of solver iterations so far.
    """

    def __init__(self, intervals: int = 40, solver: type[ConeSolver] = FallbackSolver) -> None:
        self.intervals = check_count("intervals", intervals, 4)
        self.solves = self.iterations = 0
        self._solver = solver
        self._programs: dict[ProgramStructure, tuple[Transcription, ConeSolver]] = {}

    def at_time(
        self,
        descent: Descent,
        duration: float,
        *,
        log_mass: Array | None = None,
        half_spaces: HalfSpaces | None = None,
        nearest: bool = False,
    ) -> OptimalPath | None:
        """Return the optimal path of a given final time, or None if no path exists.

        None proves that no path exists, unless the solver does not give proofs. The path's `loss`
        and `excess` state whether the engine can fly it.

        Parameters
        ----------
        descent
            Landing problem.
        duration
            Final time, s.
        log_mass
            Guess of ln(mass / initial mass) at the interval centres (N,).
        half_spaces
            Half-spaces in which the path must lie; they replace the cone of `descent`.
        nearest
            Whether to minimise the landing error instead of propellant.

        Raises
        ------
        InputError
            If the final time is not positive, or masses or half-spaces do not have N intervals.
        SolverError
            If the solver fails.
        """
        if not (is_number(duration) and 0.0 < duration <= LARGEST):
            problem = f"must be a positive number of at most {LARGEST:g} s"
            raise InputError("optimal.duration", duration, problem)
        if descent.violates_glideslope and not nearest:
            return None
        if half_spaces is None:
            half_spaces = HalfSpaces.over(descent, self.intervals)
        elif len(half_spaces.normals) != self.intervals:
            raise InputError(
                "optimal.half_spaces",
                half_spaces.normals.shape,
                f"must have half-spaces for {self.intervals} intervals, but has them for "
                f"{len(half_spaces.normals)}",
                show_value=False,
            )
        if log_mass is None:
            log_mass = self._guess_log_mass(descent, duration)
        else:
            expected = f"must be {self.intervals} finite numbers, one per interval"
            log_mass = check_numbers("log_mass", log_mass, (self.intervals,), expected)
        path = self._solve(descent, duration, log_mass, half_spaces, nearest)
        if path is not None and np.abs(path.log_mass - log_mass).max() > _MAX_LOG_MASS_ERROR:
            again = self._solve(descent, duration, path.log_mass, half_spaces, nearest)
            path = None if again is None else replace(again, solves=2)
        return path

    def _guess_log_mass(self, descent: Descent, duration: float) -> Array:
        """Guess ln(mass / initial mass) at the interval centres (N,).

        The guess assumes constant consumption for gravity and the velocity change over `duration`
        s.
        """
        change = descent.end_velocity - descent.velocity
        change = change + np.array([0.0, 0.0, descent.gravity * duration])
        rates = np.array([descent.thrust_min, descent.thrust_max]) / descent.mass
        wanted = np.clip(np.linalg.norm(change), *(rates * duration))
        spent = min(float(wanted), descent.delta_v_available) / descent.exhaust_velocity
        return np.asarray(-spent * (np.arange(self.intervals) + 0.5) / self.intervals)

    def _solve(
        self,
        descent: Descent,
        duration: float,
        log_mass: Array,
        half_spaces: HalfSpaces | None,
        nearest: bool,
    ) -> OptimalPath | None:
        """Solve the cone program for `log_mass` once; None if no path is found.

        The arguments are those of `at_time`. Raise SolverError if the solver fails.
        """
        structure = ProgramStructure(
            self.intervals,
            descent.max_tilt is not None or descent.max_final_tilt is not None,
            descent.glideslope is not None,
            0 if half_spaces is None else half_spaces.normals.shape[1],
            nearest or descent.region > 0.0,
            descent.thrust_slack > 0.0 and not nearest,
        )
        if structure not in self._programs:
            self._programs[structure] = Transcription(structure), self._solver()
        transcription, solver = self._programs[structure]
        program = transcription.program(descent, duration, log_mass, half_spaces, nearest=nearest)
        answer = solver.solve(program)
        self.solves += 1
        self.iterations += answer.iterations
        if answer.status in ("infeasible", "unsolved"):
            return None
        if answer.status == "failed":
            raise SolverError(
                f"{answer.solver} fails after {answer.iterations} iterations for a descent of "
                f"{duration:.1f} s."
            )
        return build_path(transcription, program, answer, descent, duration)
