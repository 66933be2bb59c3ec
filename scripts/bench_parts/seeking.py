"""Measure information-seeking guidance: scoring of thousands of paths, and a plan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench_parts.common import ROOT, alternating_medians

_PATHS = 3000


def _planning_problem(changes: dict[str, Any]) -> tuple[Any, Any, float]:
    """Return path planner, planning problem and time-to-go, s, at a descent's start.

    `changes` are changed tables of the scenario.
    """
    from lunarsim.onboard.guidance.divert_cost import divert_cost
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    scenario = Scenario.load(ROOT / "scenarios" / "shadow_nominal.toml").changed(
        guidance={"kind": "information-seeking"}, **changes
    )
    computer = Simulation(scenario, 3).computer
    law, end = computer.guidance, computer.approach.end(computer.site, computer.lander)
    problem = law.problem(computer.estimate, end, computer.site)
    one = replace(end, position=end.position[None, :])
    cost = divert_cost(computer.estimate, one, law.lander, law.gravity, limits=law.limits)
    return law.planner, problem, float(cost.time_to_go[0])


def _reach(problem: Any) -> Any:
    """Return a function that computes the propellant to 10,000 sites; it is timed too."""
    from lunarsim.onboard.guidance.divert_cost import divert_cost

    side = np.linspace(-300.0, 300.0, 100)
    offset = np.dstack((*np.meshgrid(side, side), np.zeros((100, 100)))).reshape(-1, 3)
    ends = replace(problem.end, position=problem.end.position + offset)
    return lambda: divert_cost(
        problem.estimate, ends, problem.lander, problem.gravity, limits=problem.limits
    )


def seeking() -> None:
    """Time the planner of information-seeking guidance, by camera only and with LiDAR."""
    small = {"terrain": {"size_m": 80.0}, "rocks": {"min_diameter_m": 0.6}}
    flash = {
        "sensors": {"flash": {"kind": "flash-lidar"}},
        "tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": [300.0, 200.0, 130.0, 80.0]}},
        "mappers": {"dem": {"kind": "gaussian-dem", "sensor": "flash"}},
        "decisions": {"map": "rocks"},
    }
    for name, more in (("camera", {}), ("camera and LiDAR", flash)):
        planner, problem, expected = _planning_problem(small | more)
        plans = planner.sample_plans(problem, expected, _PATHS)
        took = alternating_medians({
            "score": lambda a=planner, b=problem, c=plans: a.score(b, c),
            "plan": lambda a=planner, b=problem, c=expected: a.best(b, c, 50.0, None),
            "reach": _reach(problem),
        })  # fmt: skip
        share = np.isfinite(planner.score(problem, plans)[:, 1]).mean()
        print(
            f"  {name:18s}{_PATHS} paths over {len(problem.nodes)} squares scored in "
            f"{took['score']:6.1f} ms ({share:.2f} within the limits), "
            f"{took['score'] / took['reach']:.2f} times a survey of 10,000 sites; a complete plan "
            f"{took['plan']:6.1f} ms, target 100 ms"
        )
