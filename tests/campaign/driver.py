"""A campaign of surrogate flights in a process of its own, which tests kill.

Workers load this module too: what only the driver needs is loaded late.

python -m tests.campaign.driver FOLDER JSON
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

# Rows of a part, so that a short campaign has several.
PART_ROWS = 20


def die_at(when: str, name: str, count: int) -> None:
    """Kill this process before or after the rename of a file to `name`, the `count`-th time."""
    rename = Path.replace
    seen = 0

    def replace(self: Path, target: Any) -> Path:
        nonlocal seen
        hit = str(target).endswith(name)
        seen += hit
        if hit and seen == count and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        done = rename(self, target)
        if hit and seen == count and when == "after":
            os.kill(os.getpid(), signal.SIGKILL)
        return done

    Path.replace = replace  # type: ignore[method-assign]


def _plan(options: dict[str, Any]) -> Any:
    from tests.campaign.surrogate import plan

    return plan(**options)


def _chains(subset: str) -> Any:
    # Brings statistics along, which take longer to load than all of a short campaign.
    from tests.campaign.subset_surrogate import planned

    return planned(subset)


def drive(folder: Path, options: dict[str, Any]) -> None:
    """Fly."""
    from lunarsim.campaign import store
    from lunarsim.campaign.engines.inline import InlineEngine
    from lunarsim.campaign.engines.local import LocalEngine
    from lunarsim.campaign.run import run

    options = dict(options)
    store.PART_ROWS = options.pop("part_rows", PART_ROWS)
    if "die" in options:
        die_at(*options.pop("die"))
    if "most_bytes" in options:
        most = options.pop("most_bytes")
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    jobs = options.pop("jobs", 2)
    engine = LocalEngine(jobs) if jobs else InlineEngine()
    subset = options.pop("subset", None)
    ran = run(_plan(options) if subset is None else _chains(subset), engine, folder)
    print(ran.state, ran.flown, ran.before, ran.failed)


if __name__ == "__main__":
    drive(Path(sys.argv[1]), json.loads(sys.argv[2]))
