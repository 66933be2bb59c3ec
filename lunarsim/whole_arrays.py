"""Files of arrays that are there whole or not at all.

Apart from `whole_files`, which the command line's `--help` loads: that waits for no NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.whole_files import write_whole


def write_arrays_whole(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write a compressed ``.npz`` of arrays by name whole."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez_compressed(file, **arrays)

    write_whole(path, write)
