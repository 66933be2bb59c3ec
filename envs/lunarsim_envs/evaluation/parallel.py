"""Fly episodes of agents in parallel; results do not depend on the process count."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import gymnasium

from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.campaign.plan import MAX_FLIGHTS
from lunarsim.errors import InputError
from lunarsim_envs.agents.registry import agent_of, check, label
from lunarsim_envs.evaluation.episodes import EvaluationStudy, fly_episodes

# Number of episodes per task: small enough for a smooth progress bar.
_CHUNK = 10

Rows = list[dict[str, Any]]


class WorkersDieError(RuntimeError):
    """Error: a worker process of a parallel evaluation died."""


def check_request(study: EvaluationStudy, agents: Sequence[str], episodes: int) -> None:
    """Check the number of episodes, and that agents exist and can fly the environment.

    Raises
    ------
    InputError
        If there are too many episodes, no agents or equal names, or an agent fails a check.
    """
    if episodes > MAX_FLIGHTS:
        raise InputError("--episodes", episodes, f"must be at most {MAX_FLIGHTS:,}")
    if not agents:
        raise InputError("--agent", None, "must be given at least once", show_value=False)
    for agent in agents:
        check(agent, trust_pickle=study.trust_pickle)
    names = [label(agent) for agent in agents]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                "--agent",
                name,
                "must have a different name for each agent",
                "Give each agent only once. If two files have the same name, rename one.",
            )
    env = study.make()
    try:
        for agent in agents:
            agent_of(agent, env, trust_pickle=study.trust_pickle)
    finally:
        env.close()


def _fly_chunk(study: EvaluationStudy, agent: str, episodes: range) -> Rows:
    """Fly a range of episodes with one agent in a worker process; return their rows."""
    return list(fly_episodes(study, agent, episodes))


def fly(
    study: EvaluationStudy, agents: Sequence[str], episodes: int, jobs: int,
    progress: Callable[[int], None] | None = None,
) -> Rows:  # fmt: skip
    """Fly the same episodes with every agent, in parallel processes.

    Parameters
    ----------
    study, agents
        Definition of the evaluation, and agents.
    episodes, jobs
        Number of episodes per agent, and number of processes.
    progress
        Function called with the number of episodes finished since the last call.

    Returns
    -------
    list of dict
        Results of each episode from `fly_episodes`, ordered by agent and episode.

    Raises
    ------
    InputError
        If worker processes cannot load the environment or an agent.
    """
    report = progress or (lambda n: None)
    work = [
        (agent, range(first, min(first + _CHUNK, episodes)))
        for agent in agents
        for first in range(0, episodes, _CHUNK)
    ]
    if jobs == 1:
        rows: Rows = []
        for agent in agents:
            for row in fly_episodes(study, agent, range(episodes)):
                rows.append(row)
                report(1)
        return rows
    return _fly_in_workers(study, work, jobs, report)


def _fly_in_workers(
    study: EvaluationStudy, tasks: list[tuple[str, range]], jobs: int, report: Callable[[int], None]
) -> Rows:
    """Fly tasks (agent, episodes) in worker processes; return rows in task order.

    `report` gets the number of episodes finished since the last call. Workers are spawned, because
    a fork of a process that has flown or rendered may hang.
    """
    check_picklable("study", study)
    # Agents and environments are sent by name, so classes defined in a notebook fail here.
    entry = gymnasium.spec(study.env.rpartition(":")[2]).entry_point
    if callable(entry):
        name = getattr(entry, "__qualname__", type(entry).__qualname__)
        check_picklable("env", f"{entry.__module__}:{name}")
    for agent, _ in tasks:
        check_picklable("--agent", agent)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=context) as pool:
        futures: list[Future[Rows]] = [pool.submit(_fly_chunk, study, *chunk) for chunk in tasks]
        waiting = set(futures)
        try:
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                report(sum(len(future.result()) for future in done))
        except BrokenProcessPool:
            raise WorkersDieError(
                "A worker process died. Use --jobs 1 to fly the episodes in the main process."
            ) from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [row for future in futures for row in future.result()]
