"""A flight that costs nothing, for tests of what flies and keeps flights."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.campaign.plan import Group, Plan, Work
from lunarsim.rng import flight_seed

COLUMNS = {"safe": "bool", "x": "float", "steps": "int", "name": "text"}


def fly(study: dict[str, Any], group: Group, arm: int, memory: dict[Any, Any]) -> dict[str, Any]:
    """Draw a row from the seed alone; fail where the study says so."""
    here = f"{group.flight}-{arm}"
    time.sleep(study.get("sleep", 0.0))
    if here in study.get("raises", ()):
        raise ValueError(f"no flight {here}")
    if here in study.get("exits", ()):
        raise SystemExit(3)
    if here in study.get("hangs", ()):
        while True:  # holds the interpreter, unlike a sleep
            sum(range(1000))
    if here in study.get("kills", ()):
        os.kill(os.getpid(), signal.SIGKILL)
    if here in study.get("kills_once", ()):
        mark = Path(study["folder"]) / f"killed-{here}"
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if "circles" in study:
        circle = [np.ones(study["circles"] // 8)]
        circle.append(circle)  # type: ignore[arg-type]  # nobody but the collector finds it
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return {"safe": True, "x": pages * 4096 / 1e6, "steps": 0, "name": ""}
    if "folder" in study:
        with (Path(study["folder"]) / "flown.txt").open("a") as file:
            file.write(here + "\n")
    rng = np.random.default_rng(flight_seed(study["seed"], group.flight))
    x = float(rng.normal()) + group.draws["wind"]
    memory["flown"] = memory.get("flown", 0) + 1
    return {
        "safe": bool(rng.random() < 0.5 + 0.2 * arm),
        "x": x if group.flight % 7 else float("nan"),
        "steps": int(rng.integers(100)),
        "name": f"ünïcode, {arm}",
    }


def plan(flights: int = 40, arms: int = 2, seed: int = 1, **study: Any) -> Plan:
    """Return a plan of surrogate flights."""

    def draws(flight: int) -> dict[str, float]:
        return {"wind": float(np.random.default_rng([seed, flight]).random())}

    return Plan(
        name="surrogate",
        seed=seed,
        flights=flights,
        arms=[(f"arm {i}", {"level": 0.5 * i}) for i in range(arms)],
        groups=[tuple(range(arms))],
        draws=draws,
        columns=COLUMNS,
        inputs={"level": "float", "wind": "float"},
        work=Work("tests.campaign.surrogate:fly", {"seed": seed, **study}),
        identity={"seed": seed, "arms": arms},
    )
