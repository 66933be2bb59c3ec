"""Episodes of several agents, spread over processes; results do not depend on how many."""

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
from lunarsim_envs.evaluation.episodes import Study, fly_episodes

# Episodes that a process takes at a time: few enough that a bar moves.
_CHUNK = 10

Rows = list[dict[str, Any]]


class WorkersDieError(RuntimeError):
    """A process that flew episodes has died."""


def check_agents(study: Study, agents: Sequence[str]) -> None:
    """Refuse agents that are none, come twice or cannot fly the environment.

    Raises
    ------
    InputError
        Naming ``--agent``.
    """
    if not agents:
        raise InputError("--agent", "", "at least one")
    for agent in agents:
        check(agent, trust_pickle=study.trust_pickle)
    names = [label(agent) for agent in agents]
    if len(set(names)) < len(names):
        raise InputError("--agent", ", ".join(names), "each name once")
    env = study.make()
    try:
        for agent in agents:
            agent_of(agent, env, trust_pickle=study.trust_pickle)
    finally:
        env.close()


def _chunk(study: Study, agent: str, episodes: range) -> Rows:
    return list(fly_episodes(study, agent, episodes))


def fly(
    study: Study, agents: Sequence[str], episodes: int, jobs: int,
    progress: Callable[[int], None] | None = None,
) -> Rows:  # fmt: skip
    """Fly the same episodes with every agent.

    Parameters
    ----------
    study, agents
        What is flown, and by whom.
    episodes, jobs
        Episodes an agent; processes.
    progress
        Is called with the number of episodes finished since the last call.

    Returns
    -------
    list of dict
        By agent, then episode.

    Raises
    ------
    InputError
        If there are too many episodes, or worker processes cannot load the environment or an agent.
    """
    if episodes > MAX_FLIGHTS:
        raise InputError("--episodes", episodes, f"at most {MAX_FLIGHTS}")
    tell = progress or (lambda n: None)
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
                tell(1)
        return rows
    return _spread(study, work, jobs, tell)


def _spread(
    study: Study, work: list[tuple[str, range]], jobs: int, tell: Callable[[int], None]
) -> Rows:
    """Fly chunks in processes of their own.

    They are spawned: a fork of a process that has flown or rendered may hang.
    """
    check_picklable("study", study)
    # Agents and environments are sent by name: classes of a notebook show only here.
    entry = gymnasium.spec(study.env.rpartition(":")[2]).entry_point
    if callable(entry):
        name = getattr(entry, "__qualname__", type(entry).__qualname__)
        check_picklable("env", f"{entry.__module__}:{name}")
    for agent, _ in work:
        check_picklable("--agent", agent)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(work)), mp_context=context) as pool:
        futures: list[Future[Rows]] = [pool.submit(_chunk, study, *chunk) for chunk in work]
        waiting = set(futures)
        try:
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                tell(sum(len(future.result()) for future in done))
        except BrokenProcessPool:
            raise WorkersDieError(
                "a process that flew episodes died; --jobs 1 flies them in this one"
            ) from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [row for future in futures for row in future.result()]
