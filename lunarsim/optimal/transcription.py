"""Transcription of the descent to a cone program with a fixed sparsity pattern.

Acikmese and Ploen, "Convex programming approach to powered descent guidance for Mars landing",
Journal of Guidance, Control, and Dynamics 30(5), 2007, with pointing as in Acikmese, Carson and
Blackmore, IEEE Transactions on Control Systems Technology 21(6), 2013.
`docs/explanation/theory/optimal.md` derives the differences from these papers:

- Thrust over mass is constant in each of N intervals. It is a difference of velocities, and its
  bound is a difference of logarithms of mass; neither is a variable. Seven variables per node
  remain.
- Time is scaled by the final time: no coefficient of the dynamics depends on the final time.
- Constraints hold between the nodes: the path over an interval is a parabola within the triangle of
  its nodes and its control point ``r + v h / 2``. A node is the midpoint of two control points. A
  convex set that contains all control points therefore contains the path.
- exp(-z) in the thrust bounds is linearised about the mass of the last solution, not about that of
  constant full thrust.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from lunarsim.errors import InputError
from lunarsim.optimal.cone_program import Program
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.validation import check_numbers
from lunarsim.typing import Array, IntArray

Indices = IntArray

_NODE = 7  # variables per node: position, velocity, logarithm of mass, all scaled


@dataclass(frozen=True)
class ProgramStructure:
    """Types and numbers of constraints, which determine a cone program's sparsity.

    Attributes
    ----------
    intervals
        Number of intervals of the path, N.
    tilt, glideslope
        Whether the tilt of the thrust is limited, and whether there is a glideslope.
    planes
        Number of half-spaces for each control point.
    free
        Whether the end lies in a disc, whose radius is a variable.
    thrust_slack
        Whether thrust above the maximum is available at a penalty; its fraction is a variable.

    Raises
    ------
    InputError
        If there are too few intervals, or both a disc and thrust slack.
    """

    intervals: int
    tilt: bool
    glideslope: bool
    planes: int
    free: bool
    thrust_slack: bool = False

    def __post_init__(self) -> None:
        if self.intervals < 4:
            raise InputError("optimal.intervals", self.intervals, "must be 4 or more")
        if self.free and self.thrust_slack:
            raise InputError("optimal.thrust_slack", True, "must be False if `free` is True")


@dataclass(frozen=True)
class HalfSpaces:
    """Half-spaces ``normals @ r >= offsets`` in which each interval's path must lie.

    They constrain the control point of each interval.

    Attributes
    ----------
    normals
        Normals of the half-spaces of each interval (N, planes, 3), ENU.
    offsets
        Offsets relative to the end of the descent (N, planes), m.
    moves
        Whether the half-spaces move with the end of the path if the end lies in a disc; False for
        terrain.

    Raises
    ------
    InputError
        If shapes are inconsistent, or a value is not finite.
    """

    normals: Array
    offsets: Array
    moves: bool = True

    def __post_init__(self) -> None:
        shape = np.shape(self.normals) if np.ndim(self.normals) == 3 else (1, 1, 3)
        for name, wanted in (("normals", (*shape[:2], 3)), ("offsets", shape[:2])):
            expected = "must have normals of shape (intervals, planes, 3) and offsets of shape "
            expected += "(intervals, planes)"
            found = check_numbers(f"half_spaces.{name}", getattr(self, name), wanted, expected)
            object.__setattr__(self, name, found)

    @classmethod
    def over(cls, descent: Descent, intervals: int) -> HalfSpaces | None:
        """Return a descent's cone as half-spaces of every interval; None without a cone."""
        if descent.cone is None:
            return None
        normals = np.broadcast_to(descent.cone.normals, (intervals, *descent.cone.normals.shape))
        return cls(normals, np.full(normals.shape[:2], -descent.cone.apex_depth))


@dataclass(frozen=True)
class ProgramScales:
    """Scales of the variables of a cone program.

    Attributes
    ----------
    length, time
        Scales of length (m) and time (s).
    kappa
        ln(mass) divided by its scaled variable.
    """

    length: float
    time: float
    kappa: float

    @classmethod
    def of(cls, descent: Descent, duration: float) -> ProgramScales:
        """Return scales in which a descent of a given duration (s) is of order 1.

        The length scale does not depend on the duration.
        """
        fall = float(descent.velocity @ descent.velocity) / (2.0 * descent.gravity)
        length = float(np.linalg.norm(descent.displacement)) + fall + 1.0
        return cls(length, duration, length / (duration * descent.exhaust_velocity))


class Transcription:
    """Builder of the cone programs of descents with one structure of constraints.

    Parameters
    ----------
    structure
        Types of constraints.
    """

    def __init__(self, structure: ProgramStructure) -> None:
        self.structure = s = structure
        n = s.intervals
        self.variables = _NODE * (n + 1) + (1 if s.free or s.thrust_slack else 0)
        self._node = _NODE * np.arange(n + 1)
        self.inner = np.arange(1, n - 1)  # the ends fix the first and last control point
        self.rows: dict[str, slice] = {}
        self._columns: dict[str, Indices] = {}
        self._set_columns()
        columns = [self._columns[name] for name in self.rows]
        self._height = sum(len(c) for c in columns)
        wide = np.concatenate([np.full(len(c), c.shape[1]) for c in columns])
        row = np.repeat(np.arange(self._height), wide)
        col = np.concatenate([c.ravel() for c in columns])
        order = np.arange(1, len(row) + 1)
        shape = (self._height, self.variables)
        pattern = sparse.csc_matrix((order, (row, col)), shape=shape)
        pattern.sort_indices()
        self._order, self._pattern = pattern.data - 1, pattern
        self._equalities = self._dynamics()

    # --- structure ------------------------------------------------------------------------

    def _set_columns(self) -> None:
        """Set the matrix columns of each group of constraints, first linear inequalities."""
        s, node = self.structure, self._node
        z0, z1 = node[:-1] + 6, node[1:] + 6
        last = np.full(s.intervals, self.variables - 1)
        self._add("high", np.column_stack((z0, z1, last) if s.thrust_slack else (z0, z1)))
        self._add("low", np.column_stack((z0, z1)))
        if s.tilt:
            self._add("tilt", np.column_stack((z0, z1, node[:-1] + 5, node[1:] + 5)))
        self._add("mass", np.array([[node[-1] + 6]]))
        if s.planes:
            self._add(
                "planes", np.repeat(self._control_point_columns(np.arange(3)), s.planes, axis=0)
            )
        if s.free:
            self._add("reach", np.array([[self.variables - 1]]))
        if s.thrust_slack:
            self._add("thrust_slack", np.full((2, 1), self.variables - 1))
        self.orthant = sum(len(c) for c in self._columns.values())
        speeds = [np.column_stack((node[1:] + c, node[:-1] + c)) for c in (3, 4, 5)]
        thrust = np.stack([np.column_stack((z0, z1)), *speeds], axis=1)
        self._add("thrust", thrust.reshape(-1, 2))
        cones = [4] * s.intervals
        if s.glideslope:
            axes = [self._control_point_columns(np.array([c])) for c in (2, 0, 1)]
            self._add("glideslope", np.stack(axes, axis=1).reshape(-1, axes[0].shape[1]))
            cones += [3] * len(self.inner)
            if s.free:  # the start must satisfy the glideslope of the chosen end
                ends = [[node[0] + c, node[-1] + c] for c in (2, 0, 1)]
                self._add("start", np.array(ends))
                cones += [3]
        if s.free:
            self._add("end", np.array([[self.variables - 1], [node[-1]], [node[-1] + 1]]))
            cones += [3]
        self.cones = tuple(cones)

    def _add(self, name: str, columns: Indices) -> None:
        """Append a group of constraints with the matrix columns of each row."""
        begin = max((r.stop for r in self.rows.values()), default=0)
        self.rows[name] = slice(begin, begin + len(columns))
        self._columns[name] = columns

    def _control_point_columns(self, axes: Indices) -> Indices:
        """Return the matrix columns of the coordinates `axes` of inner control points.

        The coordinates are relative to the end of the path; control points bound the path of an
        interval.
        """
        node = self._node[self.inner][:, None]
        parts = [node + axes, node + axes + 3]
        if self.structure.free:
            parts.append(np.broadcast_to(self._node[-1] + axes, parts[0].shape))
        return np.concatenate(parts, axis=1)

    def _dynamics(self) -> sparse.csc_matrix:
        """Return the matrix of the equality constraints: dynamics, then end states.

        The dynamics are positions as integrals of velocities; the end states are the initial and
        the final state.
        """
        n, node, s = self.structure.intervals, self._node, self.structure
        half = 0.5 / n
        row, col, value = [], [], []
        for c in range(3):
            for columns, v in (
                (node[1:] + c, 1.0), (node[:-1] + c, -1.0),
                (node[:-1] + c + 3, -half), (node[1:] + c + 3, -half),
            ):  # fmt: skip
                row.append(3 * np.arange(n) + c)
                col.append(columns)
                value.append(np.full(n, v))
        fixed = np.concatenate((np.arange(_NODE), node[-1] + np.arange(2 if s.free else 0, 6)))
        row.append(3 * n + np.arange(len(fixed)))
        col.append(fixed)
        value.append(np.ones(len(fixed)))
        entries = np.concatenate(value), (np.concatenate(row), np.concatenate(col))
        return sparse.csc_matrix(entries, shape=(3 * n + len(fixed), self.variables))

    # --- values ---------------------------------------------------------------------------

    def program(
        self,
        descent: Descent,
        duration: float,
        log_mass: Array,
        half_spaces: HalfSpaces | None = None,
        *,
        nearest: bool = False,
    ) -> Program:
        """Return the cone program of a landing problem with a given final time.

        Parameters
        ----------
        descent
            Landing problem.
        duration
            Final time, s.
        log_mass
            z = ln(mass / initial mass) at the interval centres (N,), about which exp(-z) is
            linearised.
        half_spaces
            Half-spaces in which the path must lie; their number is that of the structure.
        nearest
            Whether to minimise the landing error instead of propellant.
        """
        units = ProgramScales.of(descent, duration)
        families = self._constraint_values(descent, units, log_mass, half_spaces, nearest)
        if self.structure.thrust_slack:
            entries, h = families["high"]
            more = descent.thrust_slack * self._unit_force(descent, units) * np.exp(-log_mass)
            families["high"] = np.column_stack((entries, -more)), h
            families["thrust_slack"] = np.array([[1.0], [-1.0]]), np.array([1.0, 0.0])
        values = np.concatenate([families[name][0].ravel() for name in self.rows])
        h = np.concatenate([families[name][1] for name in self.rows])
        p = self._pattern
        g = sparse.csc_matrix((values[self._order], p.indices, p.indptr), shape=p.shape)
        c = np.zeros(self.variables)
        if self.structure.thrust_slack:
            c[-1] = descent.thrust_slack_penalty * units.time / units.length
        c[-1 if nearest else self._node[-1] + 6] = 1.0 if nearest else -1.0
        b = np.concatenate(
            (np.zeros(3 * self.structure.intervals), self._end_values(descent, units))
        )
        return Program(c, self._equalities, b, g, h, self.orthant, self.cones)

    def _end_values(self, descent: Descent, units: ProgramScales) -> Array:
        """Return the scaled initial and final state, as the right-hand side of equalities."""
        speed = units.time / units.length
        end = np.concatenate((np.zeros(3), descent.end_velocity * speed))
        start = (descent.displacement / units.length, descent.velocity * speed, [0.0])
        return np.concatenate((*start, end[2 if self.structure.free else 0 :]))

    def _constraint_values(
        self,
        descent: Descent,
        units: ProgramScales,
        log_mass: Array,
        half_spaces: HalfSpaces | None,
        nearest: bool,
    ) -> dict[str, tuple[Array, Array]]:
        """Return matrix entries and right-hand side of each group of constraints, by name.

        `log_mass` (N,) is the guess of ln(mass / initial mass); with `nearest`, the landing error
        is minimised.
        """
        s, n = self.structure, self.structure.intervals
        out = self._thrust_bounds(descent, units, log_mass)
        weight = descent.gravity * units.time**2 / units.length / n
        apex_depth = descent.apex_depth / units.length
        if s.tilt:
            # At interval centres, where thrust is bounded too.
            tilts = descent.tilts(units.time * (1.0 - (np.arange(n) + 0.5) / n))
            lean = np.cos(tilts if tilts is not None else np.zeros(n))
            ones = np.ones(n)
            out["tilt"] = np.column_stack((lean, -lean, ones, -ones)), np.full(n, weight)
        least = np.log(descent.dry_mass / descent.mass) / units.kappa
        out["mass"] = np.array([[-1.0]]), np.array([-least])
        if s.planes and half_spaces is not None:
            a = half_spaces.normals[self.inner].reshape(-1, 3)
            offsets = half_spaces.offsets[self.inner].ravel() / units.length
            rows = self._control_point_entries(-a)
            if s.free and not half_spaces.moves:
                rows[:, 6:] = 0.0
            out["planes"] = rows, -offsets
        if s.free:
            most = 2.0 if nearest else descent.region / units.length
            out["reach"] = np.array([[1.0]]), np.array([most])
            out["end"] = np.full((3, 1), -1.0), np.zeros(3)
        thrust = np.zeros((n, 4))
        thrust[:, 3] = weight
        out["thrust"] = np.broadcast_to([-1.0, 1.0], (4 * n, 2)), thrust.ravel()
        if s.glideslope:
            tan = np.tan(descent.glideslope if descent.glideslope is not None else 0.0)
            count = len(self.inner)
            row = self._control_point_entries(np.array([[-1.0], [-tan], [-tan]]))
            out["glideslope"] = np.tile(row, (count, 1)), np.tile([apex_depth, 0.0, 0.0], count)
            if s.free:
                start = np.array([[-1.0, 1.0], [-tan, tan], [-tan, tan]])
                out["start"] = start, np.array([apex_depth, 0.0, 0.0])
        return out

    def _control_point_entries(self, coefficients: Array) -> Array:
        """Return the matrix entries for constraints on control points.

        `coefficients` (n, k) multiply the coordinates of the control points. The result has n rows
        and 2 k columns, or 3 k columns if the end of the path is free.
        """
        half = 0.5 / self.structure.intervals
        parts = [coefficients, half * coefficients] + (
            [-coefficients] if self.structure.free else []
        )
        return np.concatenate(parts, axis=1)

    def _thrust_bounds(
        self, descent: Descent, units: ProgramScales, log_mass: Array
    ) -> dict[str, tuple[Array, Array]]:
        """Return entries and right-hand sides of maximum and minimum thrust constraints.

        They hold at the interval centres, and are linearised about `log_mass` (N,), ln(mass /
        initial mass).
        """
        k = units.kappa
        unit_acceleration = self._unit_force(descent, units) * np.exp(-log_mass)
        out = {}
        for name, sign, force in (
            ("high", 1.0, descent.thrust_max),
            ("low", -1.0, descent.thrust_min),
        ):
            most = force * unit_acceleration
            half = 0.5 * k * most
            entries = sign * np.column_stack((1.0 + half, half - 1.0))
            out[name] = entries, sign * most * (1.0 + log_mass)
        return out

    def _unit_force(self, descent: Descent, units: ProgramScales) -> float:
        """Return the scaled velocity change that 1 newton causes in one interval.

        The mass is the initial mass.
        """
        return units.time**2 / (units.length * self.structure.intervals * descent.mass)
