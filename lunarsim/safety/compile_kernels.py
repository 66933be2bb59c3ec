"""Compile the kernels of the safety tests (run with `python -m`).

The compiled kernels are cached on disk for every process of the machine.
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
from lunarsim.safety.exact import safe_sites
from lunarsim.safety.planes import plane_stochastic_safety


def compile_safety_kernels(exact: bool) -> None:
    """Compile the safety kernels by running the tests of a LiDAR map on flat terrain.

    With `exact`, the exact safety test is also compiled.
    """
    lander = Lander()
    grid = Grid.centred((0.0, 0.0), 10.0, 0.5)
    level = np.zeros(grid.shape, np.float32)
    plane_stochastic_safety(level, level, grid, lander)
    bounded_safety(level, grid, lander)
    if exact:
        safe_sites(level, grid, lander)


def exit_with_parent(parent: int) -> None:
    """Exit this process when its parent process ends; `parent` is the parent's id."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)


@click.command()
@click.option("--exact", is_flag=True, help="Also compile the exact safety test.")
@click.option(
    "--parent",
    type=int,
    default=None,
    help="Process id; stop when this process ends. Default: never.",
)
def main(exact: bool, parent: int | None) -> None:
    """Compile the kernels of the safety tests for all processes."""
    if parent is not None:
        # The caller passes its id, because it may already be gone when this process asks for it.
        threading.Thread(target=exit_with_parent, args=(parent,), daemon=True).start()
    compile_safety_kernels(exact)


if __name__ == "__main__":
    main()
