"""Measure the solvers of optimal descents at fixed and free final time."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from bench_parts.common import median_ms

_G = 1.622


def _descent(rng: Any = None, **changes: Any) -> Any:
    """Return the default approach as an optimal descent problem.

    The start state is dispersed if `rng` is given; `changes` replaces fields.
    """
    from lunarsim.models.lander import Lander
    from lunarsim.optimal.problem import Descent

    lander = Lander()
    margin = 0.08 * (lander.thrust_max - lander.thrust_min)
    position, velocity = np.array([-600.0, 0.0, 500.0]), np.array([28.0, 0.0, -18.0])
    if rng is not None:
        position = position + rng.normal(0.0, 20.0, 3)
        velocity = velocity + rng.normal(0.0, 1.5, 3)
    given = {"position": position, "velocity": velocity, "mass": lander.wet_mass, **changes}
    return Descent(
        end_position=np.array([0.0, 0.0, 11.6]), end_velocity=np.array([0.0, 0.0, -2.0]),
        gravity=_G, thrust_min=lander.thrust_min + margin, thrust_max=lander.thrust_max - margin,
        exhaust_velocity=lander.exhaust_velocity, dry_mass=lander.dry_mass + 15.0,
        max_tilt=np.deg2rad(40.0), glideslope=np.deg2rad(8.0), apex_depth=0.5, **given,
    )  # fmt: skip


def _fixed() -> float:
    """Print solver times of descents with fixed final time, relative to Clarabel.

    Returns the time of Clarabel from a cold start, ms.
    """
    from lunarsim.optimal.cone_program import ClarabelSolver, QocoSolver
    from lunarsim.optimal.transcription import ProgramStructure, Transcription

    made = Transcription(ProgramStructure(40, True, True, 0, False))
    masses = -0.025 * (np.arange(40) + 0.5) / 40
    descents = [_descent(np.random.default_rng(n)) for n in range(8)]
    programs = [made.program(d, 30.0, masses) for d in descents]
    kept, counts = QocoSolver(), []
    kept.solve(programs[0])

    def each(solve: Any) -> float:
        counts.append([solve(p).iterations for p in programs])
        return median_ms(lambda: [solve(p) for p in programs], 7) / len(programs)

    clarabel = each(ClarabelSolver().solve)
    updated = each(kept.solve)
    cold = each(lambda p: QocoSolver().solve(p))
    filled = median_ms(lambda: [made.program(d, 30.0, masses) for d in descents], 7) / len(descents)
    print(
        f"  40 intervals, fixed final time: {made.variables} variables, "
        f"{len(programs[0].h)} cone rows; iterations {np.median(counts[0]):.0f} and "
        f"{np.median(counts[1]):.0f}"
    )
    print(f"    Clarabel, cold start            {clarabel:7.2f} ms")
    print(f"    QOCO, cold start                {cold:7.2f} ms  {cold / clarabel:5.2f} x")
    print(f"    QOCO updated and solved         {updated:7.2f} ms  {updated / clarabel:5.2f} x")
    total = updated + filled
    print(f"    with setup of the matrices      {total:7.2f} ms  {total / clarabel:5.2f} x")
    return clarabel


def _network(clarabel: float) -> None:
    """Print the evaluation time of the network of `neural-optimal` guidance.

    `clarabel` is the reference time, ms.
    """
    from lunarsim.onboard.guidance.optimal_network import OptimalNetwork, reduce_state

    network, here = OptimalNetwork.load(), _descent()
    many = 200

    def answer() -> None:
        for _ in range(many):
            network(reduce_state(here.displacement, here.velocity, here.mass)[0])

    took = median_ms(answer, 7) / many
    print(f"    network of `neural-optimal`     {took:7.3f} ms  {took / clarabel:6.4f} x")


def _free(clarabel: float) -> None:
    """Print times of the search for the optimal final time, from warm and cold starts.

    A warm start uses the solution of 1 s before. `clarabel` is the reference time, ms.
    """
    from lunarsim.optimal.final_time import minimize_propellant
    from lunarsim.optimal.planner import Planner

    planner = Planner(40)
    first = minimize_propellant(planner, _descent())
    r, v, _ = first.at(1.0)
    mass = float(first.mass_at(1.0))
    warm, cold, solves, colds = [], [], [], []
    for n in range(12):
        rng = np.random.default_rng(n)
        here = _descent(
            position=r + rng.normal(0.0, 0.5, 3), velocity=v + rng.normal(0.0, 0.1, 3), mass=mass
        )
        for times, counts, last in ((warm, solves, first), (cold, colds, None)):
            began = time.perf_counter()
            found = minimize_propellant(planner, here, last=last, elapsed=1.0)
            times.append(1e3 * (time.perf_counter() - began))
            counts.append(found.solves)
    for name, times, counts in (("1 s later", warm, solves), ("cold start", cold, colds)):
        took = float(np.median(times))
        print(
            f"  free final time, {name:15s}{took:9.2f} ms  {took / clarabel:5.2f} x; solves "
            f"{np.median(counts):.0f}, maximum {max(counts)}"
        )


def _rigid() -> None:
    """Print solver times of a rigid-body descent by convexification and by IPOPT."""
    from scipy.spatial.transform import Rotation

    from lunarsim.evaluation.open_loop import simulate_open_loop
    from lunarsim.models.lander import Lander
    from lunarsim.optimal.six_dof import (
        RigidDescent,
        SuccessiveConvexification,
        remaining_guess,
        shoot,
    )
    from lunarsim.vehicle.state import State

    programs, cold, warm, counts, by_ipopt, more = SuccessiveConvexification(30), [], [], [], [], []
    for n in range(8):
        point = _descent(np.random.default_rng(n))
        lean = Rotation.from_euler("y", -15.0, degrees=True).as_quat()
        rigid = RigidDescent(
            Lander(), State(point.position, point.velocity, lean, np.zeros(3), point.mass, 2400.0),
            point.end_position, point.end_velocity, thrust_min=point.thrust_min,
            thrust_max=point.thrust_max, max_tilt=point.max_tilt, max_rate=np.deg2rad(15.0),
            glideslope=point.glideslope,
        )  # fmt: skip
        first = programs.solve(rigid)
        times, states = simulate_open_loop(first)
        after = State.from_vector(states[np.searchsorted(times, 1.0)])
        later = programs.solve(replace(rigid, start=after), remaining_guess(first, 1.0))
        cold.append(1e3 * first.seconds)
        warm.append(1e3 * later.seconds)
        counts.append(later.iterations)
        if n < 3:
            other = shoot(rigid, 30)
            by_ipopt.append(1e3 * other.seconds)
            more.append(first.propellant / other.propellant - 1.0)
    print(
        f"  rigid body, 30 intervals: quadratic programs {np.median(cold[1:]):.0f} ms cold, "
        f"{np.median(warm):.0f} ms 1 s later ({np.median(counts):.0f} programs); IPOPT "
        f"{np.median(by_ipopt):.0f} ms, {1e2 * np.max(np.abs(more)):.2f} % maximum difference"
    )


def optimal() -> None:
    """Time solvers of optimal descents, relative to Clarabel from a cold start."""
    from lunarsim.optimal.collocation import collocate
    from lunarsim.optimal.final_time import minimize_propellant
    from lunarsim.optimal.planner import Planner

    clarabel = _fixed()
    _network(clarabel)
    _free(clarabel)
    path = minimize_propellant(Planner(40), _descent())
    began = time.perf_counter()
    other = collocate(_descent(), 40)
    took = 1e3 * (time.perf_counter() - began)
    print(
        f"  collocation by IPOPT, free final time {took:7.0f} ms; propellant {path.propellant:.3f} "
        f"and {other.propellant:.3f} kg"
    )
    _rigid()
