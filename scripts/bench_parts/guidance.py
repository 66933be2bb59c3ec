"""Measure the guidance laws: command time, reach time, landing errors."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np

from bench_parts.common import median_ms

_STATES, _G = 200, 1.622


def _states(lander: Any) -> list[Any]:
    """Return random start states, as state estimates, to compare guidance laws."""
    from lunarsim.onboard.navigation.estimate import Estimate

    rng = np.random.default_rng(11)
    out = []
    for _ in range(_STATES):
        height = rng.uniform(150.0, 600.0)
        r = np.array([*rng.uniform(-1.0, 1.0, 2) * height, height])
        v = np.array([*(-0.05 * r[:2] + rng.normal(0.0, 4.0, 2)), rng.uniform(-25.0, -5.0)])
        upright = np.array([0.0, 0.0, 0.0, 1.0])
        out.append(Estimate(0.0, r, v, upright, np.zeros(3), lander.wet_mass, np.eye(9)))
    return out


def _fly_law(
    law: Any, start: Any, end: Any, time_to_go: float, exhaust: float
) -> tuple[float, ...]:
    """Fly a point mass with a guidance law whose commands are held for 0.1 s.

    `start` and `end` are the states, `time_to_go` the duration, s, and `exhaust` the exhaust
    velocity, m/s. Returns propellant (kg), miss (m) and velocity error (m/s).
    """
    from dataclasses import replace

    cycle = 0.1
    flight = law.build(SimpleNamespace(surface_gravity=_G, nonuniform_gravity=None), 0.0)
    r, v, mass, at = start.position.copy(), start.velocity.copy(), start.mass, 0.0
    while at < time_to_go - 1e-9:
        step = min(cycle, time_to_go - at)
        here = replace(start, position=r, velocity=v, mass=mass)
        thrust = flight.command(here, end, at, time_to_go - at)
        a = thrust - np.array([0.0, 0.0, _G])
        r, v = r + step * v + 0.5 * step**2 * a, v + step * a
        mass *= np.exp(-step * float(np.linalg.norm(thrust)) / exhaust)
        at += step
    return (
        start.mass - mass,
        float(np.linalg.norm(r - end.position)),
        float(np.linalg.norm(v - end.velocity)),
    )


def _optima(starts: list[Any], end: Any, lander: Any) -> Any:
    """Return the minimum propellant from each start to `end`, kg; NaN if infeasible."""
    from lunarsim.onboard.guidance.divert_cost import PathLimits
    from lunarsim.optimal.errors import InfeasibleError
    from lunarsim.optimal.final_time import minimize_propellant
    from lunarsim.optimal.planner import Planner
    from lunarsim.optimal.problem import Descent

    limits, planner = PathLimits(), Planner(40)
    least = np.full(len(starts), np.nan)
    for n, start in enumerate(starts):
        descent = Descent(
            start.position, start.velocity, start.mass, end.position, end.velocity, _G,
            *limits.thrust_range(lander), lander.exhaust_velocity,
            lander.dry_mass + limits.reserve, limits.max_tilt, limits.glideslope, 0.5,
        )  # fmt: skip
        try:
            least[n] = minimize_propellant(planner, descent).propellant
        except InfeasibleError:
            continue
    return least


def _min_cpu_ms(work: Callable[[], object]) -> float:
    """Return the minimum thread CPU time of nine calls of `work`, ms.

    The minimum excludes the effect of other processes.
    """
    work()
    spent = []
    for _ in range(9):
        began = time.thread_time()
        work()
        spent.append(time.thread_time() - began)
    return 1e3 * min(spent)


def guidance() -> None:
    """Time command and reach map of each guidance law; print propellant and errors."""
    from lunarsim.models.lander import Lander
    from lunarsim.onboard.guidance import PhaseEnd
    from lunarsim.parts.registry import kinds, resolve

    lander = Lander()
    end = PhaseEnd(np.array([0.0, 0.0, 12.0]), np.array([0.0, 0.0, -2.0]))
    # The optimal law is not a closed form: `bench.py optimal` measures it.
    laws = {
        k: resolve("guidance", k)() for k in kinds("guidance", with_files=False) if k != "optimal"
    }
    starts = _states(lander)
    line = np.linspace(-200.0, 200.0, 100)
    cells = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    field = PhaseEnd(np.column_stack((cells, np.full(len(cells), 12.0))), end.velocity)
    threads = numba.get_num_threads()
    optima = _optima(starts, end, lander)
    print(f"  feasible starts of the optimum: {np.isfinite(optima).sum()} of {len(starts)}")
    print(
        "  law                    command (us)  reach (ms): CPU, 1, all threads  reachable  "
        "propellant, kg (median, 95th pct.)  excess, % (median, 95th pct.)  miss, m (95th pct.)  "
        "speed, m/s (95th pct.)"
    )
    for kind, law in laws.items():
        began = time.perf_counter()
        flight = law.build(SimpleNamespace(surface_gravity=_G, nonuniform_gravity=None), 0.4)
        for n in range(2000):
            flight.command(starts[n % 20], end, 0.1 * n, 30.0)
        took = (time.perf_counter() - began) / 2000 * 1e6
        numba.set_num_threads(1)
        times = [_min_cpu_ms(lambda law=law: law.cost(starts[3], field, lander, _G))]
        for count in (1, threads):
            numba.set_num_threads(count)
            times.append(median_ms(lambda law=law: law.cost(starts[3], field, lander, _G), 5))
        rows, least = [], []
        for start, optimum in zip(starts, optima, strict=True):
            to_go = float(law.cost(start, end, lander, _G).time_to_go[0])
            if np.isfinite(to_go):
                rows.append(_fly_law(law, start, end, to_go, lander.exhaust_velocity))
                least.append(optimum)
        figures = np.array(rows)
        spent = np.percentile(figures[:, 0], [50, 95])
        over = np.nanpercentile(100.0 * (figures[:, 0] / least - 1.0), [50, 95])
        worst = np.percentile(figures[:, 1:], 95, axis=0)
        print(
            f"  {kind:22s} {took:14.1f} {times[0]:12.1f} {times[1]:10.1f} {times[2]:8.1f} "
            f"{len(rows):12d} "
            f"{spent[0]:14.1f} {spent[1]:7.1f} {over[0]:19.2f} {over[1]:7.2f} "
            f"{worst[0]:22.3f} {worst[1]:14.3f}"
        )
