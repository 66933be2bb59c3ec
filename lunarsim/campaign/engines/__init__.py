"""Engines that execute flights: this process, local processes, a Ray cluster.

All engines give the same rows.
"""

from __future__ import annotations

from lunarsim.campaign.engines.contract import Engine


def make_engine(name: str, jobs: int, address: str | None, time_limit: float | None) -> Engine:
    """Create the engine that runs the flights of a campaign: "local" or "ray".

    `jobs` is the number of processes or cores, `address` that of a Ray cluster, and `time_limit`
    the wall-clock limit of a flight, s.
    """
    if name == "ray":
        from lunarsim.campaign.engines.ray_cluster import RayEngine  # noqa: PLC0415

        return RayEngine(address, jobs, time_limit)
    from lunarsim.campaign.engines.local import LocalEngine  # noqa: PLC0415

    return LocalEngine(jobs, time_limit)
