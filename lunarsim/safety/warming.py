"""Compiles the kernels of the safety tests: `python -m lunarsim.safety.warming --help`.

They are kept on disk for every process of the machine; see `lunarsim.cli_waiting`.
"""

from __future__ import annotations

import os
import threading
import time

import click
import numpy as np

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety.bounded import bounded_safety
from lunarsim.safety.exact import exact_safety
from lunarsim.safety.planes import plane_stochastic_safety


def warm(exact: bool) -> None:
    """Judge a level map by the tests that a LiDAR map takes, and by the exact one if asked to."""
    lander = Lander()
    grid = Grid.centred((0.0, 0.0), 10.0, 0.5)
    level = np.zeros(grid.shape, np.float32)
    plane_stochastic_safety(level, level, grid, lander)
    bounded_safety(level, grid, lander)
    if exact:
        exact_safety(level, grid, lander)


def end_with(parent: int) -> None:
    """End this process once its parent is not that one: whoever waited for it is gone."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)


@click.command()
@click.option("--exact", is_flag=True, help="Those of the exact map too.")
@click.option("--parent", type=int, default=None, help="Process to end with; left out: none.")
def main(exact: bool, parent: int | None) -> None:
    """Compile the kernels of the safety tests, for every process of the machine."""
    if parent is not None:
        # It is told which: who asks for its parent too late is told another.
        threading.Thread(target=end_with, args=(parent,), daemon=True).start()
    warm(exact)


if __name__ == "__main__":
    main()
