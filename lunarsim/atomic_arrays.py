"""Write files of arrays atomically.

This module is separate from `atomic_files`, because `--help` imports `atomic_files` and must not
load NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.atomic_files import atomic_write


def atomic_write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write named arrays as a compressed ``.npz`` file atomically: complete or absent."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez_compressed(file, **arrays)

    atomic_write(path, write)
